"""The report of a calibration by targets: what `semloc calibrate --targets` writes (room: reports; host).

In: a folder of target pictures. Out: calib.yaml, corners.csv, metrics.json, targets.png, text.
"""

import csv
import logging
from pathlib import Path

import numpy as np

from semloc_jax import viz
from semloc_jax.calibration.lens_on_boards import LensFit, fit_lens
from semloc_jax.calibration.mounts_on_mats import MatCorners, MountFit, fit_mounts, ground_errors
from semloc_jax.cameras import Camera, Rig
from semloc_jax.cameras.io import read_calibration, write_calibration
from semloc_jax.errors import SemlocError
from semloc_jax.evaluation import Metric, write_metrics
from semloc_jax.perception.target_pictures import Board, find_mat, grey_pictures, read_boards, read_survey
from semloc_jax.reports.folder import make_folder
from semloc_jax.storage import writing
from semloc_jax.viz.self_calibration import target_figure

_LOG = logging.getLogger(__name__)
_NEAR_M = 3.0
_BEYOND_DEG = 2.0


def report_target_calibration(folder: Path, calib: Path | None = None, out: Path | None = None) -> str:
    """Calibrate lenses on views of a board and mounts on surveyed mats, write everything, return the text for people.

    Args:
        folder: targets.yaml, boards/CAMERA/*.png and, for the mounts, mats/CAMERA.png and mats.csv; truth/calib.yaml,
            where it is there, is compared with.
        calib: lenses by data sheet and mounts by drawing; None takes calib.yaml of the folder.

    Raises:
        SemlocError: files are missing, or the views are too few or on one side.
    """
    if not folder.is_dir():
        raise SemlocError(f"targets {folder}: no such folder; expected targets.yaml and boards/CAMERA/*.png in it")
    board, mat = read_boards(folder)
    rough = calib if calib is not None else folder / "calib.yaml"
    if not rough.exists():
        raise SemlocError(
            f"targets {folder}: no calib.yaml; give --calib with the lenses by data sheet and the mounts by drawing"
        )
    drawing = read_calibration(rough)
    lenses = [_lens(folder, board, drawing, index) for index in range(len(drawing))]
    rig = Rig([fit.camera for fit in lenses], drawing.T_base_cam, drawing.names)
    mounts = None
    if mat is not None:
        mounts = fit_mounts(rig, _seen_mats(folder, mat, rig, lenses))
        rig = mounts.rig
    truth_file = folder / "truth" / "calib.yaml"
    truth = read_calibration(truth_file) if truth_file.is_file() else None
    place = make_folder(out)
    write_calibration(rig, place / "calib.yaml")
    metrics = _metrics(rig, lenses, mounts, truth)
    write_metrics(metrics, place / "metrics.json")
    if mounts is not None:
        _write_corners(place, rig, mounts)
    viz.save(target_figure(rig.names, lenses, mounts), place / "targets.png")
    return "\n".join([*_text(rig, lenses, mounts, truth), f"calibration: {place / 'calib.yaml'}", f"results: {place}"])


def _lens(folder: Path, board: Board, drawing: Rig, index: int) -> LensFit:
    name = drawing.names[index]
    pictures = grey_pictures(folder / "boards" / name)
    if not pictures:
        raise SemlocError(f"targets {folder}: no pictures in boards/{name}; expected views of the board of each camera")
    size = drawing.cameras[index].resolution
    views = []
    for file, grey in pictures.items():
        if grey.shape[::-1] != size:
            raise SemlocError(
                f"targets {folder / 'boards' / name / file}: {grey.shape[1]}x{grey.shape[0]} px; the calibration says "
                f"{size[0]}x{size[1]}; take all pictures at that size"
            )
        found = board.find(grey)
        if found is None:
            _LOG.warning("camera %s: no board of %d x %d corners in %s", name, board.columns, board.rows, file)
        else:
            views.append(found)
    return fit_lens(views, drawing.cameras[index], name)


def _seen_mats(folder: Path, mat: Board, rig: Rig, lenses: list[LensFit]) -> list[MatCorners]:
    survey, seen = read_survey(folder, mat), []
    pictures = {Path(name).stem: grey for name, grey in grey_pictures(folder / "mats").items()}
    for index, name in enumerate(rig.names):
        if name not in pictures:
            raise SemlocError(
                f"targets {folder}: no picture mats/{name}.png; expected one of the ground for each camera"
            )
        for number, places in survey.mats.items():
            uv = find_mat(pictures[name], rig.cameras[index], np.asarray(rig.T_base_cam[index]), mat, places)
            if uv is None:
                continue
            known = np.isfinite(uv).all(axis=-1)
            # Beyond the views of the board the lens is a guess, which would bend the mount.
            known[known] = _angle_deg(rig.cameras[index], uv[known]) <= lenses[index].widest_deg + _BEYOND_DEG
            if not known.any():
                continue
            seen.append(MatCorners(index, number, uv[known], places[known]))
    return seen


def _angle_deg(camera: Camera, uv: np.ndarray) -> np.ndarray:
    """Angle of lines of sight to the axis."""
    return np.rad2deg(np.arccos(np.clip(np.asarray(camera.unproject(uv)[0])[:, 2], -1.0, 1.0)))


def _metrics(rig: Rig, lenses: list[LensFit], mounts: MountFit | None, truth: Rig | None) -> list[Metric]:
    found = [Metric(f"lens.{name}.rms", fit.rms_px, "px") for name, fit in zip(rig.names, lenses, strict=True)]
    if mounts is not None:
        near = _near(rig, mounts)
        for name, values in (("before", mounts.before_m), ("after", mounts.after_m), ("held_out", mounts.held_out_m)):
            own = values[near & np.isfinite(values)]
            if len(own):
                found.append(Metric(f"corners.{name}", float(1e3 * own.mean()), "mm"))
    if truth is not None:
        errors = np.concatenate(list(ground_errors(rig, truth, _NEAR_M).values()))
        found.append(Metric("ground.mean", float(1e3 * errors.mean()), "mm"))
        found.append(Metric("ground.p95", float(1e3 * np.percentile(errors, 95)), "mm"))
    return found


def _near(rig: Rig, mounts: MountFit) -> np.ndarray:
    places = np.asarray(rig.T_base_cam)[mounts.camera, :2, 3]
    return np.linalg.norm(mounts.p_base - places, axis=1) <= _NEAR_M


def _text(rig: Rig, lenses: list[LensFit], mounts: MountFit | None, truth: Rig | None) -> list[str]:
    lines = []
    for name, fit in zip(rig.names, lenses, strict=True):
        share = fit.covered.mean()
        lines.append(
            f"{name}: {len(fit.used)} views, rms {fit.rms_px:.3f} px, {100 * share:.0f} % of the picture covered, "
            f"to {fit.widest_deg:.0f} deg from the axis, f {float(fit.camera.fx):.2f} {float(fit.camera.fy):.2f} px, "
            f"centre {float(fit.camera.cx):.2f} {float(fit.camera.cy):.2f} px"
        )
    if mounts is None:
        lines.append("mounts: as in the drawing; targets.yaml names no mat")
        return lines
    near = _near(rig, mounts)
    held = mounts.held_out_m[near]
    said = f"surveyed corners within {_NEAR_M:g} m of their camera ({near.sum()}): "
    said += f"{1e3 * mounts.before_m[near].mean():.1f} mm off before, {1e3 * mounts.after_m[near].mean():.1f} mm after"
    if np.isfinite(held).any():
        said += f", {1e3 * np.nanmean(held):.1f} mm where the mat was held out ({np.isfinite(held).sum()})"
    lines.append(said)
    if truth is not None:
        for name, errors in ground_errors(rig, truth, _NEAR_M).items():
            mean, p95 = 1e3 * errors.mean(), 1e3 * np.percentile(errors, 95)
            lines.append(f"{name}: the ground within {_NEAR_M:g} m is {mean:.1f} mm off the truth, p95 {p95:.1f} mm")
    return lines


def _write_corners(folder: Path, rig: Rig, mounts: MountFit) -> None:
    with writing(folder / "corners.csv") as partial, partial.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(("camera", "x_m", "y_m", "before_mm", "after_mm", "held_out_mm"))
        columns = (mounts.before_m, mounts.after_m, mounts.held_out_m)
        for k, camera in enumerate(mounts.camera):
            numbers = [f"{1e3 * column[k]:.2f}" for column in columns]
            writer.writerow((rig.names[camera], *(f"{x:.4f}" for x in mounts.p_base[k]), *numbers))
