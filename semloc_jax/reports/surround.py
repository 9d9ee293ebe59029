"""The top view of a drive or of a few pictures: what `semloc surround` writes (room: reports; host).

In: a drive, or pictures and a calibration. Out: a picture for each frame, a film, metrics.json, text.
"""

import logging
import time
from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from tqdm import tqdm

from semloc_jax.cameras import Rig
from semloc_jax.errors import SemlocError
from semloc_jax.evaluation import Metric, format_metrics, write_metrics
from semloc_jax.inputs.mask_source import mask_source
from semloc_jax.inputs.surround_inputs import SurroundPictures, own_bodies, surround_pictures
from semloc_jax.maps import MapElement, read_map
from semloc_jax.perception.bowl import BowlView
from semloc_jax.perception.camera_order import belonging, named_order
from semloc_jax.perception.colour_balance import ColourBalance
from semloc_jax.perception.surround import SurroundView
from semloc_jax.perception.surround_quality import inner_neighbours, neighbours, overlap_matches, seam_step
from semloc_jax.perception.surveyed_paint import CornerError, corner_errors
from semloc_jax.perception.view_tables import Blend, Car
from semloc_jax.reports.film import Film
from semloc_jax.reports.folder import make_folder, write_record
from semloc_jax.storage import output_path, writing

_LOG = logging.getLogger(__name__)
_TOP, _BOWL = "top_view", "bowl"
_FILMS = {_TOP: "surround.mp4", _BOWL: "bowl.mp4"}
_NEAR_M = 3.0
_CHECKED = 5
_SHARE_OF_NEW_GAINS = 0.2
"""Gains follow the light within some five frames: faster they flicker. Ours."""


@dataclass(frozen=True)
class SurroundSettings:
    """How the top view is made.

    Args:
        blend: how pictures meet at the seams: normal distribution over the distance to the seam, a ramp, or a cut.
        size_m: side of the square around the car.
        metres_per_px: size of a pixel.
        height_aware: where two cameras contradict each other, since something stands up, show one of them alone.
        bowl_from_deg: also the surroundings on a bowl, seen from behind (0), the right (90), ahead (180) or the left
            (270); None: only from above.
    """

    blend: Blend = "gaussian"
    size_m: float = 12.0
    metres_per_px: float = 0.012
    height_aware: bool = False
    bowl_from_deg: float | None = None

    def __post_init__(self) -> None:
        if not (1.0 <= self.size_m <= 100.0 and 0.001 <= self.metres_per_px <= 1.0):
            raise SemlocError(
                f"top view: {self.size_m:g} m at {self.metres_per_px:g} m a pixel; expected 1 to 100 m and 0.001 to 1 m"
            )
        if not 16 <= self.size_m / self.metres_per_px <= 8000:
            raise SemlocError(
                f"top view: {self.size_m / self.metres_per_px:.0f} pixels a side; expected 16 to 8000; change --size-m "
                "or --metres-per-px"
            )


def report_surround(
    path: Path,
    calib: Path | None = None,
    settings: SurroundSettings | None = None,
    frames: slice = slice(None),
    cameras: tuple[str, ...] | None = None,
    masks: str | None = None,
    own_car_m: Car | None = None,
    video: bool = False,
    check: bool = True,
    out: Path | None = None,
) -> str:
    """Write the top view of every frame and say how well it fits together; returns the text for people.

    Args:
        path: a drive of any kind, or a folder with one picture for each camera.
        calib: calibration file, where the drive has none of its own.
        frames: which frames of the drive.
        cameras: names; None for all.
        masks: masks of the drive that are laid out as well; None for none.
        own_car_m: rear, front, right and left end of the car [m]; None takes the rectangle of the cameras.
        video: write a film too.
        check: refuse pictures that contradict the calibration.

    Raises:
        SemlocError: pictures are missing, black, of another size, in another order, or of another car.
    """
    settings = settings or SurroundSettings()
    pictures = surround_pictures(path, calib, cameras, frames)
    bodies = own_bodies(pictures)
    view = SurroundView.around(pictures.rig, settings.size_m, settings.metres_per_px, settings.blend, bodies, own_car_m)
    if not view.seen.any():
        raise SemlocError(
            f"{path}: no camera sees the road within {0.5 * settings.size_m:g} m; check T_base_cam (semloc check-calib)"
        )
    warnings = _refuse_what_does_not_fit(view, pictures) if check else []
    bowl = None
    if settings.bowl_from_deg is not None:
        bowl = BowlView.around(pictures.rig, settings.bowl_from_deg, own_body=bodies, own_car_m=own_car_m)
    folder = make_folder(out)
    run = _Run(view, bowl, pictures, settings)
    with ExitStack() as stack:
        kinds = (_TOP,) if bowl is None else (_TOP, _BOWL)
        films = {kind: stack.enter_context(Film(folder / _FILMS[kind], pictures.rate_hz)) for kind in kinds if video}
        for index in tqdm(range(len(pictures)), unit="frame", desc="top views", disable=None):
            for kind, picture in run.next(index).items():
                _write(output_path(folder, kind, pictures.names[index], suffix=".png"), picture)
                if kind in films:
                    films[kind].add(picture[..., ::-1])
    if masks is not None:
        _write_masks(folder, masks, pictures, settings, own_car_m)
    write_metrics(run.metrics(), folder / "metrics.json")
    write_record(folder, settings, {})
    width, height = view.bev.resolution
    text = [f"{len(pictures)} top view{'s' if len(pictures) != 1 else ''} of {width} x {height} px, "]
    text[0] += f"{1e3 * settings.metres_per_px:g} mm a pixel, cameras {', '.join(pictures.rig.names)}"
    return "\n".join([*text, format_metrics(run.metrics()), *warnings, f"results: {folder}"])


class _Run:
    """The frames of a run, one after the other, with what was measured in them."""

    def __init__(
        self, view: SurroundView, bowl: BowlView | None, pictures: SurroundPictures, settings: SurroundSettings
    ):
        self.view, self.bowl, self.pictures, self.settings = view, bowl, pictures, settings
        self.bands, self.inner = neighbours(view), inner_neighbours(view)
        self.balance: ColourBalance | None = None
        self.apart: list[np.ndarray] = []
        self.steps: list[tuple[float, float]] = []
        self.corners: list[CornerError] = []
        self.stitch_ms: list[float] = []
        self.elements = _surveyed(pictures)
        view.pictures  # noqa: B018 - tables are made once, before the clock runs

    def next(self, index: int) -> dict[str, np.ndarray]:
        """The views of a frame, blue green red."""
        images = self.pictures.images(index)
        started = time.perf_counter()
        now = self.view.balance(images)
        self.balance = now if self.balance is None else self.balance.towards(now, _SHARE_OF_NEW_GAINS)
        top = self.view.stitch(images, balance=self.balance, height_aware=self.settings.height_aware)
        self.stitch_ms.append(1e3 * (time.perf_counter() - started))
        self.apart.append(overlap_matches(self.view, images, self.bands).apart_m)
        self.steps.append(seam_step(self.view, top, self.inner))
        T_map_base = self.pictures.truth(index)
        if self.elements and T_map_base is not None:
            self.corners += corner_errors(top, self.view, self.elements, T_map_base)
        return {_TOP: top} if self.bowl is None else {_TOP: top, _BOWL: self.bowl.stitch(images, self.balance)}

    def metrics(self) -> list[Metric]:
        """Surveyed corners, disagreement and seams, apart from each other."""
        apart_mm = 1e3 * np.concatenate(self.apart)
        steps = np.array(self.steps)[np.isfinite(self.steps).all(axis=1)]
        found = [Metric("stitch.median", float(np.median(self.stitch_ms)), "ms", "report")]
        if self.elements:
            mounts = np.asarray(self.pictures.rig.T_base_cam)[:, :2, 3]
            away = np.array([np.linalg.norm(c.p_base - mounts, axis=1).min() for c in self.corners])
            off_mm = np.array([1e3 * np.linalg.norm(c.off_m) for c in self.corners])
            for name, chosen in (("near", away <= _NEAR_M), ("all", away <= np.inf)):
                found += _spread(f"corners.{name}", off_mm[chosen] if len(off_mm) else off_mm, "mm")
        found += _spread("overlap", apart_mm, "mm")
        if len(steps):
            found.append(Metric("seam.step", float(steps[:, 0].mean()), "levels"))
            found.append(Metric("seam.step_beside", float(steps[:, 1].mean()), "levels", "report"))
        return found


def _spread(name: str, values: np.ndarray, unit: str) -> list[Metric]:
    found = [Metric(f"{name}.num", float(len(values)), "spots", "report")]
    if len(values):
        found += [
            Metric(f"{name}.median", float(np.median(values)), unit),
            Metric(f"{name}.mean", float(values.mean()), unit),
            Metric(f"{name}.p90", float(np.percentile(values, 90)), unit),
        ]
    return found


def _surveyed(pictures: SurroundPictures) -> Sequence[MapElement]:
    """Paint and slots of the true map, where the drive has a truth for its poses."""
    drive = pictures.drive
    if drive is None or drive.truth is None or drive.map_path is None:
        return ()
    return read_map(drive.map_path).elements


def _refuse_what_does_not_fit(view: SurroundView, pictures: SurroundPictures) -> list[str]:
    """Warnings about pictures and calibration.

    Raises:
        SemlocError: they contradict each other.
    """
    if len(pictures.rig) < 2:
        return []
    chosen = np.unique(np.linspace(0, len(pictures) - 1, _CHECKED).astype(int))
    found = belonging(view, [pictures.images(int(k)) for k in chosen])
    if found.better_order is not None:
        raise SemlocError(
            f"{pictures.where}: the pictures are in another order than the cameras: "
            f"{named_order(pictures.rig.names, found.better_order)}; rename the folders, or give --no-check to go on"
        )
    if found.contradicts:
        raise SemlocError(
            f"{pictures.where}: neighbouring cameras do not show the same road: {100 * found.found:.0f} % of "
            f"{found.num_tried} spots are found again (expected 40 % and more); the calibration is of another car, or "
            "give --no-check to go on"
        )
    if found.is_far_apart:
        return [
            f"warning: neighbouring cameras show {100 * found.found:.0f} % of {found.num_tried} spots both, "
            f"{1e3 * found.apart_m:.0f} mm apart: the calibration is of another car, a mount has moved, or the road is "
            "not flat (semloc calibrate)"
        ]
    return []


def _write(path: Path, picture: np.ndarray) -> None:
    with writing(path) as partial:
        if not cv2.imwrite(str(partial), picture):
            raise SemlocError(f"picture {path}: cannot be written; check the disk")


def _write_masks(
    folder: Path, name: str, pictures: SurroundPictures, settings: SurroundSettings, own_car_m: Car | None
) -> None:
    """Class ids from above, 255 where nothing is known."""
    if pictures.drive is None:
        raise SemlocError(f"--masks {name}: {pictures.where} has pictures only; leave it out, or give a drive")
    source = mask_source(name, pictures.drive, pictures.rig.names)
    rig: Rig = source.camera_rig(pictures.rig)
    view = SurroundView.around(rig, settings.size_m, settings.metres_per_px, own_car_m=own_car_m)
    for frame in pictures.frames:
        top = view.stitch(source.masks(frame), source.table.unusable_ids)
        _write(output_path(folder, f"masks_{name}", frame.id, suffix=".png"), top)
