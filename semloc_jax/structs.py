"""Containers that cross a room border, on one page (room: structs; pure JAX and standard library).

In: nothing. Out: ElementClass, InertialNoise, Channel, MapSamples, ViewSamples, CostMaps, PoseEstimate, SolveStatus.
Every array container is an equinox module (a JAX pytree) of fixed capacity; padding has `valid` False or weight 0.
"""

import enum

import equinox as eqx
from jaxtyping import Array, Bool, Float, Int, UInt8


class ElementClass(enum.IntEnum):
    """What a map element is; the value is the `label` of its samples."""

    LANE_MARKING = 0
    STOP_LINE = 1
    CROSSWALK = 2
    ROAD_MARK = 3
    SLOT_LINE = 4
    PARKING_SLOT = 5
    SPEED_BUMP = 6
    POLE = 7
    SIGN = 8
    TRAFFIC_LIGHT = 9
    PILLAR = 10
    CONE = 11
    CURB = 12
    GUARDRAIL = 13


STANDING_CLASSES = frozenset(
    {
        ElementClass.POLE,
        ElementClass.SIGN,
        ElementClass.TRAFFIC_LIGHT,
        ElementClass.PILLAR,
        ElementClass.CONE,
        ElementClass.GUARDRAIL,
    }
)
"""What stands on the ground: new paint does not move it."""


class InertialNoise(eqx.Module):
    """Noise of an inertial sensor, as Kalibr and OpenVINS state it; the defaults are ours, of a production car."""

    gyro_density: float = 3e-4
    """White noise [rad/s per root of Hz]."""
    accel_density: float = 6e-3
    """White noise [m/s^2 per root of Hz]."""
    gyro_walk: float = 3e-4
    """Change of the bias [rad/s per root of s]."""
    accel_walk: float = 2e-3
    """Change of the bias [m/s^2 per root of s]."""

    @property
    def bias_walk(self) -> tuple[float, ...]:
        """Change of the six biases, gyroscope first [per root of s]."""
        return (self.gyro_walk,) * 3 + (self.accel_walk,) * 3


class SampleKind(enum.IntEnum):
    """How the visible contour of a sample depends on where it is seen from."""

    FIXED = 0
    """The point itself is on a contour: edge of paint, outline of a sign, curb."""
    ROUND = 1
    """A point on the axis of a round pole; its contour lies `offset_m` to the side of the line of sight."""
    CORNER = 2
    """A point on a vertical edge of a box (pillar); contour only where it is the outermost edge in view."""


class SolveStatus(enum.IntEnum):
    """How a solve ended; `STATUS_TEXT` has a sentence for each."""

    CONVERGED = 0
    MAX_STEPS = 1
    NO_EVIDENCE = 2
    NOT_FINITE = 3
    AMBIGUOUS = 4
    WEAK_DIRECTION = 5
    POOR_FIT = 6
    AT_SEARCH_BORDER = 7
    SINGULAR = 8


STATUS_TEXT = {
    SolveStatus.CONVERGED: "converged: the pose step fell below the tolerance",
    SolveStatus.MAX_STEPS: "the step limit was reached before convergence; raise max_steps or start closer",
    SolveStatus.NO_EVIDENCE: "too few map samples fall on usable pixels; check map coverage, masks and the class table",
    SolveStatus.NOT_FINITE: "the start pose or the input holds NaN or infinity",
    SolveStatus.AMBIGUOUS: "a second pose explains the masks about as well; narrow the prior or add cameras",
    SolveStatus.WEAK_DIRECTION: "one direction of the pose is not held by the evidence; see weak_direction",
    SolveStatus.POOR_FIT: "the best pose explains too little of the map in view; check masks, map and calibration",
    SolveStatus.AT_SEARCH_BORDER: "the best pose lies at the border of the search window; widen the prior",
    SolveStatus.SINGULAR: "the cost is flat in one direction at the pose: derivatives of the pose are damped there",
}


class MapSamples(eqx.Module):
    """Points on the contours of map elements, independent of any camera.

    Positions are in the local frame `LocalMap.frame` (float32 stays exact to well below 1 mm).
    """

    p_map: Float[Array, "n 3"]
    """Sample positions [m]."""
    tangent_map: Float[Array, "n 3"]
    """Unit direction of the contour at the sample."""
    offset_m: Float[Array, " n"]
    """ROUND: signed radius, + is left of the line of sight, - is right. CORNER: the corner is outermost where it lies
    at least this far to the side of center_map. Else 0."""
    length_m: Float[Array, " n"]
    """Length of contour that the sample stands for [m]."""
    label: Int[Array, " n"]
    """ElementClass of the sample."""
    kind: Int[Array, " n"]
    """SampleKind of the sample."""
    element: Int[Array, " n"]
    """Index of the element in `LocalMap.elements`; -1 for padding."""
    center_map: Float[Array, "n 3"]
    """CORNER: a point on the bisector of the corner, on the side of the box; else equal to p_map [m]."""
    height_sigma: Float[Array, "n 3"]
    """How far the height may be off, one standard deviation: near the vehicle [m]; curvature k [1/m] of a road that is
    known there alone, k d^2 / 2 at a distance d; tilt [rad] against the vertical of what stands on it."""
    valid: Bool[Array, " n"]


class ViewSamples(eqx.Module):
    """What is left of the map samples when they are seen from one place: one bucket for each camera of a rig."""

    p_map: Float[Array, "*cam 3 p"]
    """Contour points [m], silhouettes applied, in the map frame relative to the local origin; struct of arrays."""
    tangent_map: Float[Array, "*cam 3 p"]
    channel: Int[Array, "*cam p"]
    """Index of the cost-map channel that may see the point."""
    weight: Float[Array, "*cam p"]
    """Weight of the point; 0 for padding."""
    element: Int[Array, "*cam p"]
    edge: Int[Array, "*cam p"]
    """Number of the straight edge, the end of a dash or one of its sides; neighbours on one edge share it."""


class CostMaps(eqx.Module):
    """Smooth signed ramps around the mask boundaries, coarse to fine, one channel for each class group.

    Level l stores min(max(d / ramp_px[l], -1), 1) with d [px of the full mask] the signed distance to the boundary of
    the channel's mask: negative inside the mask, positive outside, 0 on the border between two pixels.
    Pixel (u, v) of the full mask lies at ((u + 0.5) / stride[l] - 0.5, (v + 0.5) / stride[l] - 0.5) of level l.
    """

    ramps: tuple[Float[Array, "cam channel _h _w"] | UInt8[Array, "cam channel _h _w"], ...]
    """One array for each level, coarsest first, values in [-1, 1], or bytes 0 .. 254 that span it; each level has its
    own size."""
    ramp_px: tuple[float, ...] = eqx.field(static=True)
    stride: tuple[int, ...] = eqx.field(static=True)
    usable: Bool[Array, "cam h w"]
    """False on ego body, dynamic objects and ignored pixels, at `usable_stride`."""
    usable_stride: int = eqx.field(static=True)


class PoseEstimate(eqx.Module):
    """A pose with all that says how far to trust it. Tangent (vx, vy, vz, wx, wy, wz), right perturbation."""

    T_local_base: Float[Array, "*batch 4 4"]
    """Vehicle pose relative to the local origin [m]."""
    covariance: Float[Array, "*batch 6 6"]
    """Covariance of the right tangent [m, rad]."""
    cost: Float[Array, "*batch"]
    """Mask-normalised robust cost in [0, 1]: 0 explains every visible sample, 1 none."""
    coverage: Float[Array, "*batch"]
    """Share of the map contour in view that falls on usable pixels."""
    inlier_ratio: Float[Array, "*batch"]
    """Share of visible weight that lies within the ramp of its class."""
    information_eigenvalues: Float[Array, "*batch 6"]
    """Eigenvalues of the prior-scaled information, ascending."""
    weak_direction: Float[Array, "*batch 6"]
    """Eigenvector of the smallest eigenvalue."""
    num_steps: Int[Array, "*batch"]
    status: Int[Array, "*batch"]
    """SolveStatus."""
