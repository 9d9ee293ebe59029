"""Time goes forward: from masks and a map to the pose of the vehicle (room: localization; host).

In: Sequence, SemanticMap, masks. Out: LocalizationResult.
"""

from semloc_jax.localization.mask_source import MaskSource, mask_source
from semloc_jax.localization.priors import PosePrior, prior_source
from semloc_jax.localization.result import LocalizationResult, Mode
from semloc_jax.localization.run import FrameLocalizer, LocalizeConfig, iterate_frames, localize_frames

__all__ = [
    "FrameLocalizer",
    "LocalizationResult",
    "LocalizeConfig",
    "MaskSource",
    "Mode",
    "PosePrior",
    "iterate_frames",
    "localize_frames",
    "mask_source",
    "prior_source",
]
