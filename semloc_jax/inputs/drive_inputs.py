"""What the verbs that work on a drive have in common: the drive, its map, masks, cameras and prior (room: inputs).

In: options. Out: Inputs, everything opened and resolved.
"""

import logging
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from semloc_jax.inputs import sweeps
from semloc_jax.inputs.choices import parse_names
from semloc_jax.inputs.paths import pinned_options

if TYPE_CHECKING:
    import numpy as np

    from semloc_jax.alignment.pose_prior import PriorSource
    from semloc_jax.datasets import Drive, Frame
    from semloc_jax.inputs.mask_source import MaskSource
    from semloc_jax.maps import SemanticMap

_LOG = logging.getLogger(__name__)
_FAR_M = 300.0
"""Fixes farther outside of a map than this belong to another place; our choice."""


@dataclass(frozen=True)
class InputOptions:
    """What a job on a drive starts from."""

    drive: Path
    """The drive: a folder or a bag (.bag, .db3, .mcap), its type is guessed."""
    calib: Path | None = None
    """Calibration file; default: the drive's own."""
    map: str | None = None
    """Map file (.osm, .xodr, .geojson, .gpkg ...), or the name of a map of the drive, or sweeps:START:STOP:STEP to make
    it of labelled lidar sweeps (PandaSet); default: the drive's own, else sweeps:::2."""
    masks: str | None = None
    """Mask folder of the drive (sem, sem_net ...), any folder CAMERA/FRAME.png, or a segmenter that runs on the images
    (net and, for fisheyes in garages, net:garage, which ship; classical; FILE.weights; FILE.onnx with its preset
    FILE.yaml beside it, or the preset itself; see semloc segment); ipm: before it (ipm:sem) makes one top view of all
    cameras; default: the drive's best masks."""
    class_table: str | None = None
    """What the ids in the masks mean: a preset or a YAML file; default: the drive's own."""
    cameras: str | None = None
    """Names of cameras, separated by commas: front,left; default: all."""
    prior: str | None = None
    """gnss, truth (plus seeded noise) or a trajectory file; default: gnss where the drive has fixes."""
    prior_sigma_xy_m: float | None = None
    """Standard deviation of the prior's position; default: that of its source, else 1."""
    prior_sigma_yaw_deg: float | None = None
    """Standard deviation of the prior's heading; default: that of its source, else 3."""
    seed: int = 0
    """Seed of the noise of --prior truth and of the random hypotheses."""


@dataclass(frozen=True)
class Inputs:
    """What the options name, opened."""

    drive: "Drive"
    map: "SemanticMap"
    masks: "MaskSource"
    prior: "PriorSource"
    is_map_made: bool = False
    """Whether the map was made of the drive itself, in no file yet."""

    def frame(self, index: int) -> "Frame":
        """The frame of an index; negative ones count from the end.

        Raises:
            SemlocError: there is none.
        """
        from semloc_jax.errors import SemlocError

        if not -len(self.drive) <= index < len(self.drive):
            raise SemlocError(f"drive {self.drive.name}: no frame {index}; it has {len(self.drive)} frames")
        return self.drive.frames[index]


def open_inputs(options: InputOptions) -> Inputs:
    """Open the drive and the map and resolve what the options leave to them.

    Raises:
        SemlocError: something is missing or cannot be read.
    """
    from semloc_jax.datasets import open_drive
    from semloc_jax.errors import SemlocError
    from semloc_jax.inputs.mask_files import CLASSICAL
    from semloc_jax.inputs.mask_source import is_network, mask_source
    from semloc_jax.inputs.priors import other_priors, prior_source
    from semloc_jax.maps import read_map

    options = pinned_options(options)
    drive = open_drive(options.drive, options.calib)
    map_path = drive.maps.get(options.map or "", options.map or drive.map_path)
    if map_path is None and sweeps.has_sweeps(drive):
        map_path = sweeps.DEFAULT
    is_map_made = str(map_path).startswith(sweeps.SWEEPS)
    if map_path is None:
        raise SemlocError(
            f"drive {drive.name}: has no map of its own; give --map FILE (.osm, .xodr, .geojson, .gpkg ...)"
        )
    kind = options.prior or ("gnss" if drive.gnss is not None else None)
    if kind is None:
        raise SemlocError(f"drive {drive.name}: has no satellite fixes; give {other_priors(drive)}")
    if is_map_made:
        drive, semantic_map = sweeps.from_sweeps(drive, map_path)
    else:
        semantic_map = read_map(map_path)
        drive = _fixes_in_map(drive, semantic_map, kind)
    _report_overlap(drive, kind)
    prior = prior_source(kind, drive, options.prior_sigma_xy_m, options.prior_sigma_yaw_deg, options.seed)
    # The images of PandaSet show more paint than the masks that come with it, and only its front camera is calibrated.
    masks = options.masks or (drive.mask_sources[0] if drive.mask_sources and not is_map_made else CLASSICAL)
    cameras = parse_names(options.cameras) or (drive.rig.names[:1] if is_map_made else None)
    source = mask_source(masks, drive, cameras, options.class_table)
    if is_network(masks):
        _report_visibility(source, drive, semantic_map)
    return Inputs(drive, semantic_map, source, prior, is_map_made)


def _fixes_in_map(drive: "Drive", semantic_map: "SemanticMap", prior: str) -> "Drive":
    """The drive with its fixes in the frame of the map; without them where they are neither needed nor convertible.

    Raises:
        SemlocError: the fixes are to give the prior, and the map does not say where it is or is somewhere else.
    """
    from dataclasses import replace

    from semloc_jax.errors import SemlocError

    if drive.gnss is None:
        return drive
    if prior != "gnss" and drive.gnss.origin is not None and semantic_map.origin is None:
        _LOG.warning("the fixes are not used: the map does not say where on the earth its frame is")
        return replace(drive, gnss=None)
    drive = drive.in_map_of(semantic_map.origin)
    away_m = _distance_m(drive.gnss.p_enu[:, :2], semantic_map.extent[:, :2])
    if away_m > _FAR_M:
        text = (
            f"drive {drive.name}: its fixes are {away_m / 1e3:.3g} km outside of map {semantic_map.name}; expected the "
            "same place: another map, another datum or grid, or latitude and longitude exchanged"
        )
        if prior == "gnss":
            raise SemlocError(text)
        _LOG.warning("%s", text)
    return drive


def _distance_m(xy: "np.ndarray", box: "np.ndarray") -> float:
    """Smallest distance of points [n 2] to a box [2 2] of minimum and maximum [m]."""
    import numpy as np

    outside = np.maximum(np.maximum(box[0] - xy, xy - box[1]), 0.0)
    return float(np.hypot(*outside.T).min())


def _report_visibility(source: "MaskSource", drive: "Drive", semantic_map: "SemanticMap") -> None:
    """Log which classes of the map the masks of a network show."""
    from semloc_jax.inputs.mask_source import looked_at
    from semloc_jax.perception.visibility import mask_problems, visibility

    masks = [source.segment(frame, camera) for frame in looked_at(drive.frames) for camera in source.cameras]
    for problem in mask_problems(source.table, masks):
        _LOG.warning("masks '%s': %s", source.name, problem)
    rows = [row for row in visibility(source.table, masks) if row.label in semantic_map.labels]
    shown = [f"{row.label.name.lower()} ({100.0 * row.share:.2g} % of the pixels)" for row in rows if row.is_seen]
    unseen = [row.label.name.lower() for row in rows if not row.is_seen]
    _LOG.info("masks '%s' show of the map: %s", source.name, ", ".join(shown) or "nothing")
    if unseen:
        _LOG.info("masks '%s' do not show: %s", source.name, ", ".join(unseen))


def _report_overlap(drive: "Drive", prior: str) -> None:
    """Log the streams of the drive and what looks wrong with their times.

    Raises:
        SemlocError: the stream that is to give the prior has no time in common with the frames.
    """
    from semloc_jax.datasets import overlap_report
    from semloc_jax.errors import SemlocError

    report = overlap_report(drive)
    _LOG.info("%s", report.to_text())
    for problem in report.problems:
        _LOG.warning("times: %s", problem)
    if report.apart({"gnss": "fixes"}.get(prior, prior)):
        raise SemlocError(f"drive {drive.name}: {report.problems[0]}; check the times, or give another --prior")
