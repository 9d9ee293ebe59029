"""One frame at its true pose, as `explain_frame` takes it; no search, which would take half a minute to compile."""

from pathlib import Path

import numpy as np

from semloc_jax.alignment.frame_localizer import FrameLocalizer
from semloc_jax.alignment.pose_prior import PosePrior
from semloc_jax.alignment.result import LocalizationResult
from semloc_jax.datasets import open_drive
from semloc_jax.inputs.mask_source import mask_source
from semloc_jax.maps import read_map
from semloc_jax.structs import SolveStatus


def frame_to_explain(simulated_road: Path) -> tuple:
    """Localizer, result, masks, prior and cameras of the second frame of a drive with exact masks."""
    drive = open_drive(simulated_road)
    frame, source = drive.frames[1], mask_source("sem", drive)
    localizer = FrameLocalizer(read_map(drive.map_path), source.table)
    T = drive.truth_at(frame)
    prior = PosePrior(T[0, 3], T[1, 3], float(np.arctan2(T[1, 0], T[0, 0])), 0.5, 0.03)
    result = LocalizationResult(frame, T, prior.on_road(localizer.map), SolveStatus.CONVERGED, True)
    return localizer, result, source.masks(frame), prior, source.seen_by(frame.rig.select(source.cameras))
