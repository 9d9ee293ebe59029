"""What stands under the picture of a frame."""

import numpy as np

from semloc_jax.alignment.result import LocalizationResult
from semloc_jax.reports.pictures import verdict_text
from semloc_jax.structs import SolveStatus


def test_a_frame_without_any_pose_has_a_line_too():
    """A street of kerbs that no mask shows: no hypothesis is left, the pose is that of the prior."""
    nothing = LocalizationResult(None, np.eye(4), np.eye(4), SolveStatus.NO_EVIDENCE, False)
    assert verdict_text(nothing) == "after: not localized: no evidence"
