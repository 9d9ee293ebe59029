"""Networks taught by the map (room: learning).

In: drives, a map. Out: Eyes whose masks and distances to borders place the drives better than what they began with.
"""

from semloc_jax.learning.eyes.labels import drawn_labels
from semloc_jax.learning.eyes.shapes import seen_surfaces
from semloc_jax.learning.eyes.teach import EyesConfig
from semloc_jax.learning.training import TrainingConfig

__all__ = ["EyesConfig", "TrainingConfig", "drawn_labels", "seen_surfaces"]
