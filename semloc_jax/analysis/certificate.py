"""A proof that a region around a pose holds no second minimum, where it can be given (room: analysis; JAX and host).

In: evidence of one frame, a level of its cost maps, a pose. Out: Certificate: half widths of inner and outer boxes.

What is certified is the evidence cost C of one level, as the solver samples it, with the samples and weights that are
seen from the minimum, over longitudinal and lateral offset and heading; height, roll and pitch are held. Two claims:
`falls`: from every point of the outer box that is not in the inner box, C falls along the straight line to the middle.
So there is no minimum, saddle or lower cost between the boxes.
`higher`: C is higher at every such point than in the middle. A shallower minimum may be there, an equal one not.
`falls` could never be given on real masks: over a small box the slope of a ramp, with its stairs, corners and the
middle of thin lines, varies by as much as itself, so that boxes must be 1/30 as wide as they lie off the minimum, which
are 100,000 for each doubling of the region. Linear bounds, in which samples cancel before they are bounded, need as
many: the slope is what is loose, not loss or camera. `higher` takes seconds, and reaches metres in rich scenes.
How: the outer box is cut into small boxes. Over each, interval arithmetic bounds where every sample can fall in the
image, the ramp and its slope there, and so C or its derivative along the line from below. A box whose bound is not
positive is cut further, until a budget is spent. Rounding is covered by margins ten times its size.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import Literal, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from semloc_jax.alignment.pose import AlignConfig, Evidence, Prior, solve_level, visible_views
from semloc_jax.analysis.intervals import Interval, bounds
from semloc_jax.analysis.ramp_bounds import RampBounds, ramp_bounds
from semloc_jax.errors import SemlocError
from semloc_jax.geometry import lie
from semloc_jax.residuals.alignment import CameraViews
from semloc_jax.residuals.robust import LOSSES
from semloc_jax.residuals.texture import RampTexture, lookup

Claim = Literal["falls", "higher"]
CLAIMS: tuple[Claim, ...] = ("falls", "higher")


@dataclass(frozen=True)
class CertificateConfig:
    """How a certificate is computed. All values are our choice."""

    level: int = 0
    """Level of the cost maps: the coarsest has the widest region."""
    inner_rise: tuple[float, ...] = (0.5, 1.0, 2.0, 4.0, 8.0)
    """The inner box reaches to where the cost has about risen by this share of what it is in the middle: the first for
    which anything can be proven."""
    growth: float = 1.25
    """Each outer box that is tried is so much larger than the last."""
    most: float = 10.0
    """No outer box is larger than so many inner ones."""
    budget: int = 20_000
    """Small boxes that may be looked at for each claim."""
    finest: float = 1 / 64
    """Small boxes are not cut below this share of the inner box."""
    batch: int = 64


@dataclass(frozen=True)
class Region:
    """An inner and an outer box about one middle: half widths longitudinal, lateral [m], heading [deg]."""

    inner: tuple[float, ...]
    outer: tuple[float, ...]

    def __str__(self) -> str:
        """Both boxes as text."""
        inner, outer = ("±{:.2f} m along, ±{:.2f} m across, ±{:.2f}°".format(*box) for box in (self.inner, self.outer))
        return f"{outer} but for {inner}"


@dataclass(frozen=True)
class Certificate:
    """What is proven around a pose, and what it took.

    Attributes:
        T_local_base: the minimum, relative to the local origin.
        pivot: the point of the vehicle [m] whose place is meant and about which it is turned.
        falls: where the cost is proven to fall towards the middle; None where that is not proven anywhere.
        higher: where it is proven higher than in the middle; None where that is not proven anywhere.
        num_boxes: small boxes that were looked at.
        level: of the cost maps.
    """

    T_local_base: Float[np.ndarray, "4 4"]
    pivot: Float[np.ndarray, "3"]
    falls: Region | None
    higher: Region | None
    num_boxes: int
    level: int

    def __str__(self) -> str:
        """Both claims as text."""
        falls, higher = ("not proven" if region is None else str(region) for region in (self.falls, self.higher))
        return f"no second minimum: {falls}; no pose as good: {higher}"


class PlaneProblem(NamedTuple):
    """The cost of one level over the plane around its minimum, and the tables that bound it."""

    T_local_base: Float[Array, "4 4"]
    views: tuple[CameraViews, ...]
    texture: RampTexture
    tables: RampBounds
    pivot: Float[Array, "3"]
    """Point of the vehicle [m] about which it is turned and whose place is meant: where a turn moves nothing else."""
    unit: Float[Array, "3"]
    """Longitudinal, lateral [m] and heading [rad] step that raises the quadratic model of the cost by 1/2."""


def certify(
    T_start: Float[Array, "4 4"],
    evidence: Evidence,
    align: AlignConfig,
    config: CertificateConfig | None = None,
    claims: Sequence[Claim] = CLAIMS,
) -> Certificate:
    """The certificate of the minimum that the level has near a pose.

    Args:
        T_start: Pose relative to the local origin, from which the minimum is sought.
        evidence: Views, textures and usable pixels of the frame.
        align: Robust loss and border; the loss must be `tukey`.
        config: None for the defaults.
        claims: What to prove.

    Raises:
        SemlocError: another loss.
    """
    config = config or CertificateConfig()
    if align.loss != "tukey":
        raise SemlocError(f"certificate: loss '{align.loss}' has no bounds here; expected 'tukey'")
    problem = plane_problem(T_start, evidence, align, config.level)
    in_middle = float(plane_cost(jnp.zeros(3, problem.unit.dtype), problem))
    found: dict[str, Region | None] = dict.fromkeys(CLAIMS)
    num_boxes = 0
    for claim in claims:
        used = 0
        for rise in config.inner_rise:
            half = np.asarray(problem.unit, np.float64) * np.sqrt(2 * rise * in_middle)
            proven, used = _grown(problem, claim, half, config, used)
            if proven > 1:
                found[claim] = Region(_in_degrees(half), _in_degrees(proven * half))
                break
        num_boxes += used
    T_local_base, pivot = np.asarray(problem.T_local_base, np.float64), np.asarray(problem.pivot, np.float64)
    return Certificate(T_local_base, pivot, found["falls"], found["higher"], num_boxes, config.level)


def _grown(
    problem: PlaneProblem, claim: Claim, half: np.ndarray, config: CertificateConfig, used: int
) -> tuple[float, int]:
    """How many times larger than the inner box the outer one can be proven, and the boxes looked at by then."""
    proven = 1.0
    while proven * config.growth <= config.most and used < config.budget:
        shell = proven * half, proven * config.growth * half
        is_proven, more = _prove_shell(problem, claim, shell, half, config, config.budget - used)
        used += more
        if not is_proven:
            break
        proven *= config.growth
    return proven, used


def _in_degrees(half: np.ndarray) -> tuple[float, ...]:
    return float(half[0]), float(half[1]), float(np.rad2deg(half[2]))


def plane_problem(T_start: Float[Array, "4 4"], evidence: Evidence, align: AlignConfig, level: int) -> PlaneProblem:
    """The problem around the minimum that a level has near a pose, with what is seen from there."""
    T_best = _plane_minimum(T_start, evidence, align, level)
    views = visible_views(T_best, evidence, align.border_px, align.path)
    texture = evidence.textures.level(level)
    tables = ramp_bounds(texture, sum(len(view.index) for view in views))
    zero, one = jnp.zeros(3, T_best.dtype), jnp.ones(3, T_best.dtype)
    H = _plane_hessian(PlaneProblem(T_best, views, texture, tables, zero, one))
    # Lateral and heading, seen from the axle, are nearly one direction; about this point they are two.
    pivot = zero.at[0].set(H[1, 2] / H[1, 1]).at[1].set(-H[0, 2] / H[0, 0])
    problem = PlaneProblem(T_best, views, texture, tables, pivot, one)
    return problem._replace(unit=jax.lax.rsqrt(jnp.diagonal(_plane_hessian(problem))))


@jax.jit
def _plane_hessian(problem: PlaneProblem) -> Float[Array, "3 3"]:
    """Gauss-Newton Hessian of the cost at the minimum."""
    loss, zero = LOSSES["tukey"], jnp.zeros(3, problem.T_local_base.dtype)
    value, weight = plane_residual(zero, problem)
    J = jax.jacfwd(lambda q: plane_residual(q, problem)[0])(zero)
    return jnp.einsum("pi,p,pj->ij", J, weight * loss.weight(value), J) + 1e-6 * jnp.eye(3, dtype=J.dtype)


def _plane_minimum(T_start: Array, evidence: Evidence, align: AlignConfig, level: int) -> Array:
    """The minimum over position and heading with height, roll and pitch held."""
    sigma = jnp.array([100.0, 100.0, 0.0, 0.0, 0.0, 10.0], T_start.dtype)
    T = T_start
    for _ in range(3):  # what is seen is settled anew from where the last solve ended
        T, *_ = _solve(T, level, evidence, Prior(T, sigma), align)
    return T


_solve = partial(jax.jit, static_argnames="config")(
    lambda T, level, evidence, prior, config: solve_level(T, level, evidence, prior, config)
)


def _prove_shell(
    problem: PlaneProblem,
    claim: Claim,
    shell: tuple[np.ndarray, np.ndarray],
    unit: np.ndarray,
    config: CertificateConfig,
    budget: int,
) -> tuple[bool, int]:
    """Whether a claim holds all over a box without a smaller box, and the small boxes that were looked at."""
    queue, used = _slabs(*shell), 0
    while len(queue):
        now, queue = queue[-config.batch :], queue[: -config.batch]
        padded = np.concatenate([now, np.repeat(now[:1], config.batch - len(now), axis=0)])
        low, middle = (np.asarray(part)[: len(now)] for part in _lower_bounds(jnp.asarray(padded), problem, claim))
        used += len(now)
        is_open = ~(low > 0)
        size = 0.5 * (now[is_open, 1] - now[is_open, 0]) / unit
        if (middle <= 0).any() or used >= budget or (np.max(size, axis=1, initial=0.0) < config.finest).any():
            return False, used
        queue = np.concatenate([queue, _halved(now[is_open], size)])
    return True, used


def _slabs(inside: np.ndarray, outside: np.ndarray) -> Float[np.ndarray, "6 2 3"]:
    """Six boxes that fill a box without a smaller box about the same middle."""
    found = []
    for axis in range(3):
        low, high = -outside.copy(), outside.copy()
        low[:axis], high[:axis] = -inside[:axis], inside[:axis]
        for end in (-1, 1):
            part = np.stack([low, high])
            part[:, axis] = sorted((end * inside[axis], end * outside[axis]))
            found.append(part)
    return np.stack(found)


def _halved(boxes: np.ndarray, size: np.ndarray) -> np.ndarray:
    """Every box cut in two across its longest side."""
    row, axis = np.arange(len(boxes)), np.argmax(size, axis=1)
    middle = boxes.mean(axis=1)[row, axis]
    first, second = boxes.copy(), boxes.copy()
    first[row, 1, axis] = second[row, 0, axis] = middle
    return np.concatenate([first, second])


@partial(jax.jit, static_argnames="claim")
def _lower_bounds(
    boxes: Float[Array, "b 2 3"], problem: PlaneProblem, claim: Claim
) -> tuple[Float[Array, " b"], Float[Array, " b"]]:
    """Lower bound over each box of what must be positive for the claim to hold, and its value in the middle."""
    boxes = boxes.astype(problem.T_local_base.dtype)
    at_best = plane_cost(jnp.zeros(3, boxes.dtype), problem)

    def one(box: Array) -> tuple[Array, Array]:
        low, size = jnp.zeros((), box.dtype), jnp.zeros((), box.dtype)
        for view in problem.views:
            term = jax.vmap(lambda v: _bounded(box, problem, v, claim))(view)
            low, size = low + jnp.sum(term.low), size + jnp.sum(jnp.maximum(jnp.abs(term.low), jnp.abs(term.high)))
        middle = 0.5 * (box[0] + box[1])
        cost, slope = jax.jvp(lambda q: plane_cost(q, problem), (middle,), (middle,))
        low = low - _ROUNDING * size
        return (low, slope) if claim == "falls" else (low - (1 + _ROUNDING) * at_best, cost - at_best)

    return jax.lax.map(one, boxes, batch_size=8)


_ROUNDING, _ROUNDING_PX, _ROUNDING_M = 1e-5, 0.005, 5e-5
"""Margins for rounding in float32: share of a sum, pixels, metres."""


def plane_cost(q: Float[Array, "3"], problem: PlaneProblem) -> Float[Array, ""]:
    """The evidence cost at a place of the plane: sum of w rho(r) over the samples of all views.

    Args:
        q: Longitudinal, lateral offset [m] of the pivot and heading [rad] in the frame of the minimum.
        problem: Of one level.
    """
    value, weight = plane_residual(q, problem)
    return jnp.sum(weight * LOSSES["tukey"].rho(value))


def plane_residual(q: Float[Array, "3"], problem: PlaneProblem) -> tuple[Float[Array, " n"], Float[Array, " n"]]:
    """Ramp value and weight of every sample at a place of the plane."""
    texture = problem.texture

    def one(view: CameraViews) -> tuple[Array, Array]:
        _, xyz = _plane_points(q, problem, view)
        u, v, _ = view.camera.project_xyz(*xyz)
        return lookup(texture, texture.image_index(view.index, view.channel), u, v), view.weight

    parts = [jax.vmap(one)(view) for view in problem.views]
    return tuple(jnp.concatenate([part[k].reshape(-1) for part in parts]) for k in range(2))


def _plane_points(q: Float[Array, "3"], problem: PlaneProblem, view: CameraViews) -> tuple[Array, Array]:
    """Points `[3 p]` about the pivot of the unmoved vehicle, and in the camera of the moved one."""
    T_base_local, pivot = lie.inverse(problem.T_local_base), problem.pivot[:, None]
    p = T_base_local[:3, :3] @ view.p_map + T_base_local[:3, 3:] - pivot
    c, s = jnp.cos(q[2]), jnp.sin(q[2])
    dx, dy = p[0] - q[0], p[1] - q[1]
    moved = jnp.stack([c * dx + s * dy, c * dy - s * dx, p[2]]) + pivot
    return p, view.T_cam_base[:3, :3] @ moved + view.T_cam_base[:3, 3:]


def _bounded(box: Float[Array, "2 3"], problem: PlaneProblem, view: CameraViews, claim: Claim) -> Interval:
    """Interval of w rho(r), or of its derivative outwards, of every sample of one camera over a box."""
    p, center = _plane_points(0.5 * (box[0] + box[1]), problem, view)
    points, outward = _moved(p, Interval(box[0], box[1]))
    points = [axis + offset for axis, offset in zip(points, problem.pivot, strict=True)]
    in_camera = [axis.widened(_ROUNDING_M) for axis in _turned(view.T_cam_base, points, True)]
    along = [axis.widened(_ROUNDING_M * jnp.max(jnp.abs(box))) for axis in _turned(view.T_cam_base, outward, False)]
    from_center = [axis - c for axis, c in zip(in_camera, center, strict=True)]

    def pixels(*args: Array) -> tuple:
        return jax.jvp(lambda *xyz: view.camera.project_xyz(*xyz)[:2], args[:3], args[3:])

    (u, v), (du, dv) = bounds(pixels, *in_camera, *along)
    _, (away_u, away_v) = bounds(pixels, *in_camera, *from_center)
    away_u, away_v = away_u.widened(_ROUNDING_PX), away_v.widened(_ROUNDING_PX)
    center_u, center_v, _ = view.camera.project_xyz(*center)
    # Two ways to bound the pixel, and two to bound the ramp there: both hold, so what both allow does.
    u, v = u.widened(_ROUNDING_PX).meet(away_u + center_u), v.widened(_ROUNDING_PX).meet(away_v + center_v)
    value, slope_u, slope_v = problem.tables.over(view.index * problem.texture.num_channels + view.channel, u, v)
    image = problem.texture.image_index(view.index, view.channel)
    reached = slope_u * away_u + slope_v * away_v + lookup(problem.texture, image, center_u, center_v)
    value = value.meet(reached)
    value = Interval(jnp.clip(value.low, -1.0, 1.0), jnp.clip(value.high, -1.0, 1.0))
    term = _tukey(value) if claim == "higher" else _tukey_slope(value) * (slope_u * du + slope_v * dv)
    weighted = [jnp.where(view.weight > 0, view.weight * end, 0.0) for end in term]
    return Interval(*weighted)


def _moved(p: Float[Array, "3 p"], q: Interval) -> tuple[list[Interval], list[Interval]]:
    """Points in the frame of the moved vehicle, and how they move as it goes outwards."""
    x, y, heading = (Interval(q.low[k], q.high[k]) for k in range(3))
    c, s = _cosine(heading), Interval(jnp.sin(heading.low), jnp.sin(heading.high))
    dx, dy = p[0] + -x, p[1] + -y
    ahead, left = c * dx + s * dy, c * dy - s * dx
    flat = Interval.of(jnp.zeros_like(p[2]))
    outward = [heading * left - (c * x + s * y), -(heading * ahead) - (c * y - s * x), flat]
    return [ahead, left, Interval.of(p[2])], outward


def _cosine(angle: Interval) -> Interval:
    """Cosine of angles within a quarter turn."""
    ends = jnp.cos(angle.low), jnp.cos(angle.high)
    top = jnp.where((angle.low <= 0) & (angle.high >= 0), 1.0, jnp.maximum(*ends))
    return Interval(jnp.minimum(*ends), top)


def _turned(T: Float[Array, "4 4"], xyz: Sequence[Interval], is_place: bool) -> list[Interval]:
    rows = []
    for k in range(3):
        row = T[k, 0] * xyz[0] + T[k, 1] * xyz[1] + T[k, 2] * xyz[2]
        rows.append(row + T[k, 3] if is_place else row)
    return rows


def _tukey(r: Interval) -> Interval:
    """rho(r) over r in [-1, 1]; it rises with |r|."""
    rho = LOSSES["tukey"].rho
    ends = [rho(value) for value in r]
    low = jnp.where((r.low <= 0) & (r.high >= 0), 0.0, jnp.minimum(*ends))
    return Interval(low, jnp.maximum(*ends))


def _tukey_slope(r: Interval) -> Interval:
    """rho'(r) = r (1 - r^2)^2 over r in [-1, 1]; it is odd and turns at 1 / sqrt 5."""
    ends = [value * (1 - value * value) ** 2 for value in r]
    turn = 5**-0.5
    top = turn * (1 - turn**2) ** 2
    low, high = jnp.minimum(*ends), jnp.maximum(*ends)
    low = jnp.where((r.low <= -turn) & (r.high >= -turn), -top, low)
    return Interval(low, jnp.where((r.low <= turn) & (r.high >= turn), top, high))
