"""The configuration of the tracker (room: localization; host).

In: nothing. Out: TrackConfig, the scene and everything that decides how a drive is followed.
"""

from dataclasses import dataclass, field
from typing import ClassVar, Literal

from semloc_jax.alignment.scene import SceneConfig
from semloc_jax.localization.acquisition import AcquisitionConfig
from semloc_jax.localization.following import FollowConfig
from semloc_jax.localization.frame_alignment import AlignmentConfig
from semloc_jax.localization.health import HealthConfig
from semloc_jax.localization.map_faults import TrustConfig
from semloc_jax.localization.watch_config import WatchConfig

Association = Literal["contours", "explicit"]


@dataclass(frozen=True)
class TrackConfig:
    """Everything that decides how a drive is followed. All values are ours."""

    SECTION: ClassVar[str] = "track"
    """Where a configuration file holds all of this but the scene."""
    scene: SceneConfig = field(default_factory=SceneConfig)
    association: Association = "contours"
    """How masks and map are brought together. contours: ours, all borders of the masks at once; explicit: the way of
    the literature, lanes, signs and lamp posts as shapes, each associated with a landmark of the map."""
    alignment: AlignmentConfig = field(default_factory=AlignmentConfig)
    acquisition: AcquisitionConfig = field(default_factory=AcquisitionConfig)
    health: HealthConfig = field(default_factory=HealthConfig)
    trust: TrustConfig = field(default_factory=TrustConfig)
    follow: FollowConfig = field(default_factory=FollowConfig)
    watch: WatchConfig = field(default_factory=WatchConfig)
    confirm_frames: float = 4.0
    """Frames that must agree with a track before it is confirmed."""
    win_nats: float = 5.0
    """Tracks that are this much worse than the best one are given up."""
    drop_refused: float = 6.0
    """A track that this many frames in a row contradict is given up while others are left."""
