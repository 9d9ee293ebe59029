"""The classifier of marks on the road: a random forest over ESF-640 (room: mapping; host).

In: simulated marks of six classes, a seed. Out: MarkForest, which says what a mark is.
Road-SLAM (IV 2017) learns from labelled images; here the forest learns from marks that are drawn, so that nothing need
be shipped and the same seed gives the same forest. scikit-learn is an optional extra.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from semloc_jax.errors import SemlocError
from semloc_jax.perception.road_marks import MarkConfig, RoadMark
from semloc_jax.simulation.mark_samples import MarkKind, mark_sample


@dataclass(frozen=True)
class ForestConfig:
    """How the forest is grown. All values are ours."""

    num_samples: int = 400
    """Marks of each class."""
    num_trees: int = 200
    num_features: int = 120
    """That each split looks at."""
    seed: int = 0
    marks: MarkConfig = field(default_factory=MarkConfig)


@dataclass(frozen=True)
class MarkForest:
    """What tells marks apart."""

    forest: Any
    config: ForestConfig

    @classmethod
    def grown(cls, config: ForestConfig | None = None) -> "MarkForest":
        """The forest of a seed.

        Raises:
            SemlocError: scikit-learn is not installed.
        """
        config = config or ForestConfig()
        try:
            from sklearn.ensemble import RandomForestClassifier
        except ImportError as error:
            raise SemlocError(
                "Road-SLAM's classifier of marks needs scikit-learn: pip install 'semloc-jax[roadslam]'"
            ) from error
        marks, kinds = simulated_marks(config.num_samples, config.seed)
        forest = RandomForestClassifier(
            config.num_trees, max_features=config.num_features, random_state=config.seed, n_jobs=1
        )
        return cls(forest.fit(_rows(marks, config), kinds), config)

    def kinds(self, marks: Sequence[RoadMark]) -> Int[np.ndarray, " n"]:
        """The `MarkKind` of each mark."""
        if not marks:
            return np.zeros(0, np.int64)
        return np.asarray(self.forest.predict(_rows(marks, self.config)), np.int64)


def simulated_marks(num: int, seed: int) -> tuple[list[RoadMark], Int[np.ndarray, " n"]]:
    """So many simulated marks of each class, and their classes."""
    each = [(kind, k) for kind in MarkKind for k in range(num)]
    marks = [RoadMark.of(mark_sample(kind, np.random.default_rng([seed, int(kind), k]))) for kind, k in each]
    return marks, np.array([int(kind) for kind, _ in each])


def _rows(marks: Sequence[RoadMark], config: ForestConfig) -> Float[np.ndarray, "n 644"]:
    return np.array([mark.features(config.marks.shape) for mark in marks])
