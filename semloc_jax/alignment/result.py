"""The result of localizing one frame (room: alignment; host).

In: Modes of the solver in local float32 coordinates. Out: LocalizationResult in the map frame, float64.
"""

from dataclasses import dataclass, field

import numpy as np

from semloc_jax.alignment.fault_modes import FaultMode
from semloc_jax.datasets import Frame
from semloc_jax.structs import SolveStatus


@dataclass(frozen=True)
class ModeEvidence:
    """What the masks hold for a pose against seeing the map elsewhere.

    Attributes:
        nats: evidence of all pieces of map in view.
        nats_per_piece: the same for one full piece.
        explained: share of the pieces that lie on borders of their class.
        left_over: share of the borders of the classes of the map on which no contour of it lies.
        border_offset_px: how far the map lies outside of the borders of its masks, in the class seen most; in pixels of
            an image of usual size. Masks that are thinner than the paint show it, and a pose between two lines.
        log_prior: log density of the prior there, up to a constant of the frame [nats].
        status: how its last solve ended.
        kinds_chi2, kinds_ahead_m, kinds_left_m: how far kinds of elements of the map contradict each other; see
            `agreement.KindsApart`. Measured for the best mode, 0 for others.
        lens_nats, lens, lens_left_nats: by how much the frame fits better through another lens, through which, and what
            the evidence leaves for any; see `lens_doubt.LensDoubt`. Measured for the best mode.
    """

    nats: float
    nats_per_piece: float
    explained: float
    left_over: float
    border_offset_px: float
    log_prior: float
    status: SolveStatus
    kinds_chi2: float = 0.0
    kinds_ahead_m: float = 0.0
    kinds_left_m: float = 0.0
    lens_nats: float = 0.0
    lens: str = ""
    lens_left_nats: float = 0.0


@dataclass(frozen=True)
class Mode:
    """One pose that explains the masks.

    Attributes:
        weight: share of the posterior, all modes sum to 1.
        T_map_base: vehicle pose in the map frame.
        covariance: of its right tangent (x, y, z [m], roll, pitch, yaw [rad]).
        score: cost of evidence and prior [nats].
        cost: visibility-normalised robust cost, 0 .. 1.
        coverage: share of the map contour in view that falls on usable pixels.
        inlier_ratio: share of the visible contour within reach of a boundary of its class.
        weak_direction: direction of the tangent that the evidence holds least.
        evidence: what the masks hold for it; None where nobody asked.
    """

    weight: float
    T_map_base: np.ndarray
    covariance: np.ndarray
    score: float
    cost: float
    coverage: float
    inlier_ratio: float
    weak_direction: np.ndarray
    evidence: ModeEvidence | None = None

    @property
    def sigma_longitudinal_m(self) -> float:
        """Standard deviation along x of the vehicle [m]."""
        return float(np.sqrt(max(self.covariance[0, 0], 0.0)))

    @property
    def sigma_lateral_m(self) -> float:
        """Standard deviation along y of the vehicle [m]."""
        return float(np.sqrt(max(self.covariance[1, 1], 0.0)))

    @property
    def sigma_heading_deg(self) -> float:
        """Standard deviation of the heading [deg]."""
        return float(np.degrees(np.sqrt(max(self.covariance[5, 5], 0.0))))


@dataclass(frozen=True)
class FoundModes:
    """The places that explain a frame.

    Attributes:
        modes: distinct poses in the map frame, best first.
        status: how the solve of the best one ended.
        confirmed: number of other starts whose solves ended at the best one; None where none was tried.
        sound: covariance of the best one had nothing been wrong: forward [m], left [m], heading [rad]; None where
            nobody asked, and it is that of the mode.
        faults: what may be wrong with the best one.
        margin_nats: by how much the best one is more probable than the next of all places that were looked at, those
            that were solved to the end and those that were not [nats]; infinite where there was no other.
    """

    modes: tuple[Mode, ...]
    status: SolveStatus
    confirmed: int | None = 0
    sound: np.ndarray | None = None
    faults: tuple[FaultMode, ...] = ()
    margin_nats: float = np.inf


@dataclass(frozen=True)
class LocalizationResult:
    """The pose of one frame, or why there is none.

    Attributes:
        frame: the frame; None where masks came as arrays.
        T_map_base: best pose in the map frame; the prior where there is none.
        T_map_prior: the pose that the search started around.
        status: how the solve ended.
        localized: whether the pose may be used.
        reasons: one sentence for each thing that speaks against the pose.
        modes: distinct poses, best first.
        times: seconds spent by stage.
        held: which of across, along and heading the masks hold, though the pose as a whole may not be used.
        protection: bounds of the lateral [m], longitudinal [m] and heading [deg] error, whatever of calibration, map
            and place may be wrong; infinite where nobody asked.
        misleading: probability that an error is beyond its alert limit.
    """

    frame: Frame | None
    T_map_base: np.ndarray
    T_map_prior: np.ndarray
    status: SolveStatus
    localized: bool
    reasons: tuple[str, ...] = ()
    modes: tuple[Mode, ...] = ()
    times: dict[str, float] = field(default_factory=dict)
    held: tuple[str, ...] = ()
    protection: tuple[float, float, float] = (np.inf, np.inf, np.inf)
    misleading: float = 1.0

    @property
    def covariance(self) -> np.ndarray:
        """Covariance `[6 6]` of the right tangent of the best pose (x, y, z [m], roll, pitch, yaw [rad]); else NaN."""
        return self.modes[0].covariance if self.modes else np.full((6, 6), np.nan)
