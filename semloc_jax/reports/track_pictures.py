"""Pictures of a tracked drive (room: reports).

In: the table of a run, the drive, the map. Out: tracking.png, stanford.png, track.mp4, overlays/*.png.
"""

from pathlib import Path

import numpy as np

from semloc_jax import viz
from semloc_jax.datasets import Drive, Frame
from semloc_jax.errors import SemlocError
from semloc_jax.evaluation.metrics import ALERT_LIMITS
from semloc_jax.inputs.mask_source import MaskSource
from semloc_jax.localization.map_window import MapWindows
from semloc_jax.maps import SemanticMap
from semloc_jax.reports.film import Film
from semloc_jax.reports.tables import PROTECTION, SIGMAS
from semloc_jax.reports.track_log import TrackTable
from semloc_jax.storage import output_path
from semloc_jax.viz.insets import FrameErrors, with_inset
from semloc_jax.viz.overlay import dim
from semloc_jax.viz.tracking import IntegrityErrors, stanford_diagram, status_banner, tracking_over_time

VIDEO_WIDTH_PX = 960
_PLAN = ("lateral", "longitudinal")
NAMES = ("lateral [m]", "longitudinal [m]", "heading [deg]")


def write_timeline(folder: Path, table: TrackTable) -> Path:
    """Draw errors, protection levels and status over time."""
    limit = ALERT_LIMITS[0]
    limits = dict(zip(NAMES, (limit.lateral_m, limit.longitudinal_m, limit.heading_deg), strict=True))
    errors = dict(zip(NAMES, table.errors(np.ones(len(table), dtype=bool)).values(), strict=True))
    levels = {name: table.columns[key] for name, key in zip(NAMES, PROTECTION, strict=True)}
    figure = tracking_over_time(table.columns["time_s"], table.status, errors, levels, limits)
    return viz.save(figure, folder / "tracking.png")


def write_stanford(folder: Path, table: TrackTable) -> Path | None:
    """Draw errors against protection levels where the drive has a truth; only frames called TRACKING have a level."""
    limit = ALERT_LIMITS[0]
    limits = (limit.lateral_m, limit.longitudinal_m, limit.heading_deg)
    errors = table.errors(np.ones(len(table), dtype=bool)).values()
    if not any(np.isfinite(error).any() for error in errors):
        return None
    directions = {}
    for name, error, key, bound in zip(NAMES, errors, PROTECTION, limits, strict=True):
        word, unit = name.rstrip("]").split(" [")
        level = np.where(table.is_tracking, table.columns[key], np.inf)
        directions[word] = IntegrityErrors(error, level, bound, unit)
    return viz.save(stanford_diagram(directions), folder / "stanford.png")


class Overlay:
    """Draws the map into the images of a drive as seen from the poses of a run."""

    def __init__(self, semantic_map: SemanticMap, source: MaskSource, table: TrackTable):
        """Prepare the map; pictures are of the first camera."""
        self.windows, self.source, self.table = MapWindows(semantic_map, 62.0, 0.25, 8192), source, table
        self._row = {frame: row for row, frame in enumerate(table.frames)}
        rows = np.flatnonzero(table.has_pose)
        self._pose = dict(zip(rows, table.trajectory().T_map_base, strict=True))

    def row(self, frame: Frame) -> int:
        """Line of the table of a frame."""
        return self._row[frame.id]

    def pose(self, row: int) -> np.ndarray | None:
        """Pose T_map_base of a line; None where it has none."""
        return self._pose.get(row)

    def picture(self, frame: Frame, width_px: int = VIDEO_WIDTH_PX) -> np.ndarray:
        """Image or mask of a frame with the contours of the map and a bar with its status; red green blue."""
        row = self._row[frame.id]
        name = self.source.cameras[0]
        rig = frame.rig.select(self.source.cameras)
        if frame.has("rgb", name):
            image, camera = dim(frame.image(name)[..., ::-1], 0.75), rig.cameras[0]
        else:
            mask = self.source.segment(frame, name)
            image, camera = viz.mask_picture(mask, self.source.table), self.source.segment_rig(rig).cameras[0]
        contours = viz.Contours.none()
        if row in self._pose:
            T = self._pose[row]
            window = self.windows.around(T[:3, 3])
            local = window.local_map.frame
            contours = viz.project_contours(window.samples, local, T, camera, rig.T_base_cam[0])
        image = viz.draw_contours(*viz.at_width(image, contours, width_px))
        if row in self._pose:
            image = with_inset(image, self._errors(row))
        why = self.table.reasons[row].split("; ")[0]
        return status_banner(image, self.table.status[row], self._text(frame, row), why)

    def _errors(self, row: int) -> FrameErrors:
        """Lateral and longitudinal errors of a line with what is stated of them."""
        limit = ALERT_LIMITS[0]

        def pair(kind: str) -> tuple[float, float]:
            lateral_m, along_m = (float(self.table.columns[f"{kind}_{name}_m"][row]) for name in _PLAN)
            return lateral_m, along_m

        return FrameErrors(pair("error"), pair("sigma"), pair("protection"), (limit.lateral_m, limit.longitudinal_m))

    def _text(self, frame: Frame, row: int) -> str:
        text = f"{frame.id}  {self.table.status[row].name}"
        if row not in self._pose:
            return text
        known = self._errors(row)
        sigma_cm, error_cm = (100.0 * np.array(pair) for pair in (known.sigma_m, known.error_m))
        text += f"   sigma {sigma_cm[0]:.1f} / {sigma_cm[1]:.1f} cm"
        return text + (f"   error {error_cm[0]:+.1f} / {error_cm[1]:+.1f} cm" if np.isfinite(error_cm).all() else "")


def write_video(path: Path, overlay: Overlay, frames: list[Frame], rate_hz: float) -> Path:
    """Write all frames as a film, which takes its place when it is whole.

    Raises:
        SemlocError: no frame, or this OpenCV cannot write films.
    """
    if not frames:
        raise SemlocError(f"video {path}: no frame to show; leave out --video")
    with Film(path, rate_hz) as film:
        for frame in frames:
            film.add(overlay.picture(frame))
    return path


def write_strip(folder: Path, overlay: Overlay, frames: list[Frame], count: int) -> list[Path]:
    """Write `count` pictures, spread over the drive."""
    if count < 1 or not frames:
        return []
    chosen = np.unique(np.linspace(0, len(frames) - 1, count).astype(int))
    shown = [frames[k] for k in chosen]
    return [viz.save(overlay.picture(f), output_path(folder, "overlays", f.id, suffix=".png")) for f in shown]


def write_rrd(path: Path, semantic_map: SemanticMap, drive: Drive, overlay: Overlay, frames: list[Frame]) -> Path:
    """Write the run as a recording for Rerun."""
    from semloc_jax.viz.recording import Moment, write_recording

    table = overlay.table

    def moment(frame: Frame) -> Moment:
        row = overlay.row(frame)
        numbers = {name: float(table.columns[name][row]) for name in (*SIGMAS, *PROTECTION, "cost", "chi2")}
        has_truth = drive.truth is not None and drive.truth.time_s[0] <= frame.time_s <= drive.truth.time_s[-1]
        truth = drive.truth_at(frame) if has_truth else None
        status = f"{table.status[row].name} {table.reasons[row]}".strip()
        return Moment(frame.time_s, overlay.pose(row), truth, status, numbers, overlay.picture(frame, 640))

    return write_recording(path, semantic_map, (moment(frame) for frame in frames))
