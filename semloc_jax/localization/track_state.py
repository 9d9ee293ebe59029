"""What a localizer knows between two frames, and what it says about each (room: localization; host).

In: nothing. Out: TrackStatus, Track, TrackerState, FrameFeatures, TrackResult. The state is a tuple of arrays: it can
be written to a file and read back bit for bit.
"""

import enum
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float, Int, Num, UInt32

from semloc_jax.alignment.explicit.frame import SeenShapes
from semloc_jax.alignment.pose_prior import PosePrior
from semloc_jax.alignment.single_frame import ImageInput
from semloc_jax.cameras import Rig
from semloc_jax.fusion.clock import ClockOffset
from semloc_jax.fusion.measurements import FusedPose, GnssMeasurement, PoseMeasurement
from semloc_jax.fusion.noise_scale import NoiseScale
from semloc_jax.localization.innovations import Innovations
from semloc_jax.localization.moved_elements import NOTHING_MOVED, Moved
from semloc_jax.localization.watch_sums import WatchState
from semloc_jax.residuals.pose_terms import Terms


class TrackStatus(enum.IntEnum):
    """How far a pose may be trusted."""

    INITIALIZING = 0
    """No pose yet, or several that have not been told apart."""
    TRACKING = 1
    """The pose is within the alert limits, at the stated risk."""
    DEGRADED = 2
    """The pose is the best guess; it may be outside of the alert limits."""
    LOST = 3
    """The pose is dead reckoning from the last good one."""


class Track(NamedTuple):
    """One answer to where the vehicle is."""

    fusion: Any
    """State of the Fusion."""
    penalty: Float[np.ndarray, ""]
    """Cost summed over frames, less that of the best track [nats]; forgets with time."""
    num_accepted: Int[np.ndarray, ""]
    """Frames that the track agreed with since it began."""
    num_refused: Float[np.ndarray, ""]
    """Frames that contradicted it, less those that agreeing frames cancelled."""
    along_sigma_m: Float[np.ndarray, ""]
    """Longitudinal standard deviation by the masks of the last frame alone [m]."""


class Fixes(NamedTuple):
    """The last satellite fixes, oldest first; unused rows have the time -inf."""

    time_s: Float[np.ndarray, " n"]
    p_map: Float[np.ndarray, "n 3"]
    sigma_m: Float[np.ndarray, "n 3"]


class ElementTrust(NamedTuple):
    """What all frames so far say about the elements of the map that were in view, by their rows in the map."""

    rows: Num[np.ndarray, " element"]
    """Place of each in the map, ascending; what is not named was never in view."""
    seen_px: Float[np.ndarray, " element"]
    """Contour that was looked at, forgetting [px of weight]."""
    missed_px: Float[np.ndarray, " element"]
    """Share of it that lay on no boundary, as robust cost [px]."""
    num_frames: Float[np.ndarray, " element"]
    """Frames in which it was in view."""
    num_in_map: Int[np.ndarray, ""]
    """Elements of the whole map."""


class Counters(NamedTuple):
    """Numbers behind the rules for lost."""

    failures: Float[np.ndarray, ""]
    """Failed alignments, counted down by good ones."""
    occluded: Int[np.ndarray, ""]
    """Frames in a row without usable view of the map."""
    conflicts: Int[np.ndarray, ""]
    """Satellite fixes in a row that contradict the pose."""
    off_map: Int[np.ndarray, ""]
    """Frames in a row outside of the map."""


class Elsewhere(NamedTuple):
    """What the last look at other places said, where satellites contradict the pose."""

    nats: Float[np.ndarray, ""] = np.float64(0.0)
    """By how much every other place is less probable."""
    time_s: Float[np.ndarray, ""] = np.float64(-np.inf)


class TrackerState(NamedTuple):
    """Everything that a localizer carries from one frame to the next."""

    time_s: Float[np.ndarray, ""]
    status: Int[np.ndarray, ""]
    """A TrackStatus."""
    tracks: tuple[Track, ...]
    """Best first; several only while it is not clear which one is right."""
    coasting: tuple[Any, ...]
    """State of the Fusion that continues by dead reckoning while lost, if any."""
    searched_s: Float[np.ndarray, ""]
    """When the vehicle was last searched for."""
    fixes: Fixes
    trust: ElementTrust
    counters: Counters
    stance: Float[np.ndarray, "3"]
    """How the vehicle stands on the road of the map: height [m], roll, pitch [rad]; load, and cameras that are off."""
    digest: UInt32[np.ndarray, ""]
    """Checksum of the masks of the last frame."""
    driven_m: Float[np.ndarray, ""]
    """Way driven since the masks last changed [m]."""
    noise: NoiseScale
    """How large the errors of measured poses are."""
    clock: ClockOffset
    """Time of the motion sensors less that of the cameras."""
    grain: Float[np.ndarray, ""] = np.ones((), np.float32)
    """Of the masks so far, see `NoiseModel.grain`."""
    watch: WatchState = WatchState()
    """What the last frames say of calibration and map."""
    elsewhere: Elsewhere = Elsewhere()
    innovations: Innovations = Innovations()
    """How measured poses fitted the motion of late."""
    doubted: Float[np.ndarray, "2 3"] = np.zeros((2, 3))
    """Where the right pose might be of late as seen from the one that was told: least and most of left [m], ahead [m],
    heading [deg]."""
    matched: Int[np.ndarray, " match"] = np.zeros(0, np.int64)
    """Elements of the map that shapes of the last frame were associated with (`--association explicit`)."""

    def at_another_place(self) -> "TrackerState":
        """The state where the best track is another one: what was seen from the one before says nothing there."""
        fresh = {"watch": WatchState(), "elsewhere": Elsewhere(), "innovations": Innovations()}
        return self._replace(**fresh, doubted=np.zeros((2, 3)))


class FrameFeatures(NamedTuple):
    """One frame without the map: what the feature stage hands to the localization stage."""

    frame_id: str
    time_s: float
    rig: Rig
    image: ImageInput
    fixes: tuple[GnssMeasurement, ...] = ()
    """Satellite fixes that came in since the frame before."""
    usable_share: float = 1.0
    """Share of the pixels that are no moving object, own vehicle or unknown; 0 where masks are of one class only."""
    digest: int = 0
    """Checksum of the masks: the same twice while the vehicle moves is a camera that stands still."""
    guess: PosePrior | None = None
    """First guess of the pose, where something else than satellites knows it."""
    terms: Terms = ()
    """Other measurements of the pose at the time of the frame, in the map frame; see `pose_term`."""
    shapes: SeenShapes | None = None
    """Explicit shapes of all cameras, where they are associated."""


@dataclass(frozen=True)
class TrackResult:
    """What a localizer says about a frame.

    Attributes:
        frame_id: name of the frame.
        time_s: time of the pose [s].
        status: how far the pose may be trusted.
        reasons: one sentence for each thing that speaks against it.
        fused: the pose with its covariance and what was estimated with it; None before there is any.
        protection: bounds of the lateral [m], longitudinal [m] and heading [deg] error.
        measured: the pose from this frame's masks alone; None where there was none.
        accepted: whether the measured pose was taken.
        chi2: its squared distance to the prediction.
        cost: robust cost of the masks, 0 .. 1.
        coverage: share of the map in view on usable pixels.
        inlier_ratio: share of the visible map within reach of its class.
        num_tracks: answers that are followed.
        clock_offset_s: time of the motion sensors less that of the cameras [s].
        times_ms: time spent by stage [ms].
        held: which of across, along and heading are within their limits, though the pose as a whole may not be.
        misleading: probability that an error is beyond its alert limit, whatever fault is suspected.
        moved: elements of one kind that, taken alone, fit elsewhere.
    """

    frame_id: str
    time_s: float
    status: TrackStatus
    reasons: tuple[str, ...] = ()
    fused: FusedPose | None = None
    protection: tuple[float, float, float] = (np.inf, np.inf, np.inf)
    measured: PoseMeasurement | None = None
    accepted: bool = False
    chi2: float = np.nan
    cost: float = np.nan
    coverage: float = np.nan
    inlier_ratio: float = np.nan
    num_tracks: int = 0
    clock_offset_s: float = 0.0
    times_ms: dict[str, float] = field(default_factory=dict)
    held: tuple[str, ...] = ()
    misleading: float = 1.0
    moved: Moved = NOTHING_MOVED

    @property
    def T_map_base(self) -> np.ndarray | None:
        """The pose [4 4] under the name that a LocalizationResult gives it, of any status; None before there is any."""
        return None if self.fused is None else self.fused.T_map_base

    @property
    def covariance(self) -> np.ndarray | None:
        """Its covariance [6 6] by xi = (v, omega); None before there is any."""
        return None if self.fused is None else self.fused.covariance
