"""Mounts, lenses, odometer and satellite offset from a whole drive (room: calibration; pure JAX).

In: views of a map from many frames, motion between them, road, fixes, priors. Out: all poses and one calibration.
One cost: contours against mask boundaries, plus motion of the vehicle, contact with the road, fixes, and priors. Where
it spans more than some metres, use float64.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from semloc_jax.cameras import Camera
from semloc_jax.geometry import lie
from semloc_jax.residuals.alignment import CameraViews, Usable, alignment_residual, visibility
from semloc_jax.residuals.camera_equations import camera_equations, with_fields
from semloc_jax.residuals.motion import cauchy_cost, fix_linearised, odometry_linearised, pose_linearised
from semloc_jax.residuals.noise import is_inlier
from semloc_jax.residuals.pose_terms import Terms
from semloc_jax.residuals.road_contact import road_linearised
from semloc_jax.residuals.robust import LOSSES, robust_root
from semloc_jax.residuals.texture import RampTexture
from semloc_jax.solvers.arrow import ArrowEquations
from semloc_jax.solvers.factors import POSE
from semloc_jax.solvers.front import solve
from semloc_jax.solvers.levenberg_marquardt import SolveConfig
from semloc_jax.solvers.problem import Step

VEHICLE = ("odometer_scale", "gyro_bias", "gnss_east", "gnss_north", "stance_height", "stance_roll", "stance_pitch")
MASKS = ("mask_u", "mask_v")
COMMON = VEHICLE + MASKS
"""Unknowns that belong to no single camera, behind those that do: of the vehicle, and how far all masks lie off the
images, since one network and one resizing made them all."""
MIN_GAIN_NATS = 3e-3
"""A calibration solve ends when a step gains less: it then moved everything by a small share of its sigma."""
_LOSS = LOSSES["tukey"]


class CalibrationState(eqx.Module):
    """Everything that is estimated."""

    T_local_base: Float[Array, "n 4 4"]
    """Vehicle poses of the frames, relative to the local origin."""
    T_base_cam: Float[Array, "c 4 4"]
    intrinsics: Float[Array, "c k"]
    """Change of the unknown fields of each camera model, padded with zeros."""
    common: Float[Array, "9"]
    """`COMMON`: odometer scale, gyroscope bias [rad/s], GNSS-to-map offset [m], stance [m, rad], mask offset [px]."""


class PictureRows(eqx.Module):
    """All pictures of the cameras of one model."""

    views: CameraViews
    """Nominal cameras and what they see; a row for each picture. `T_cam_base` is not used."""
    frame: Int[Array, " row"]
    camera: Int[Array, " row"]
    """Place in the rig."""
    T_frame_then: Float[Array, "row 4 4"]
    """Motion of the vehicle from the time of the frame to that of the picture."""
    names: tuple[str, ...] = eqx.field(static=True)
    """Fields of the model that are unknown."""


class DriveMotion(eqx.Module):
    """From frame i to frame i + 1; the last row has no information."""

    T_from_to: Float[Array, "n 4 4"]
    jacobian: Float[Array, "n 6 2"]
    """Its right tangent by odometer scale and gyroscope bias."""
    sqrt_info: Float[Array, "n 6 6"]


class Anchors(eqx.Module):
    """What else holds each frame; a row with `sqrt_info` 0 is not there."""

    fix_base: Float[Array, "n 3"]
    p_fix: Float[Array, "n 2"]
    fix_sqrt_info: Float[Array, "n 2"]
    road_point: Float[Array, "n 3"]
    road_normal: Float[Array, "n 3"]
    road_sqrt_info: Float[Array, "n 3"]
    T_reference: Float[Array, "n 4 4"]
    """A pose from elsewhere (a surveyed trajectory), else a vague one that only keeps the equations regular."""
    reference_sqrt_info: Float[Array, "n 6 6"]


class CalibrationProblem(eqx.Module):
    """The cost of one level of the cost maps; see `LeastSquaresProblem`."""

    pictures: tuple[PictureRows, ...]
    texture: RampTexture
    gain: Float[Array, ""]
    """Nats for each unit of weight x rho."""
    motion: DriveMotion
    anchors: Anchors
    T_prior: Float[Array, "c 4 4"]
    """Mounts of the calibration to start from."""
    common_prior: Float[Array, "9"]
    sigma: Float[Array, " s"]
    """Of the priors: mounts (6 for each camera, right tangent), intrinsics, `COMMON`; 0 locks."""
    terms: Terms = ()
    """What else was measured of the poses, keyed by frame; see `semloc_jax.residuals.pose_terms`."""
    edge_threshold: float = eqx.field(static=True, default=5.0)
    fix_threshold: float = eqx.field(static=True, default=2.0)
    road_threshold: float = eqx.field(static=True, default=4.0)

    def rows(self, state: CalibrationState, group: PictureRows) -> CameraViews:
        """The views of a group with cameras and poses of a state."""
        T_local_then = lie.compose(state.T_local_base[group.frame], group.T_frame_then)
        T_local_cam = lie.compose(T_local_then, state.T_base_cam[group.camera])
        offset = state.common[-len(MASKS) :]

        def moved_camera(camera: Camera, change: Array) -> Camera:
            return with_fields(with_fields(camera, group.names, change), ("cx", "cy"), offset)

        moved = jax.vmap(moved_camera)(group.views.camera, state.intrinsics[group.camera])
        return eqx.tree_at(lambda v: (v.camera, v.T_cam_base), group.views, (moved, lie.inverse(T_local_cam)))

    def linearise(self, value: CalibrationState, skip: Bool[Array, ""]) -> ArrowEquations:
        """Normal equations at a state; shared unknowns in units of their priors, locked ones as identity."""
        state, total = value, self._priors(value)
        for group in self.pictures:
            total = _added(total, self._pictures(state, group))
        for part in (self._motion(state), *self._anchors(state), *self._terms(state)):
            total = _added(total, part)
        free = self.sigma > 0
        unit = jnp.where(free, self.sigma, 0.0)
        locked = jnp.diag(jnp.where(free, 0.0, 1.0)).astype(unit.dtype)
        return eqx.tree_at(
            lambda e: (e.across, e.shared, e.shared_gradient),
            total,
            (total.across * unit, total.shared * unit[:, None] * unit + locked, total.shared_gradient * unit),
        )

    def step(self, equations: ArrowEquations, damping: Float[Array, ""]) -> Step:
        """The damped step: poses in metres and radians, shared unknowns in units of their priors."""
        units = jnp.asarray(POSE.units, equations.cost.dtype)
        return equations.step(damping, units, jnp.ones_like(equations.shared_gradient))

    def retract(
        self, value: CalibrationState, tangent: tuple[Float[Array, "n 6"], Float[Array, " s"]]
    ) -> CalibrationState:
        """The state after a step in right tangents and in units of the priors."""
        state, (poses, shared) = value, tangent
        x = shared * self.sigma
        num, width = state.intrinsics.shape
        mounts, lenses = x[: 6 * num].reshape(num, 6), x[6 * num : (6 + width) * num].reshape(num, width)
        return CalibrationState(
            lie.compose(state.T_local_base, lie.exp(poses)),
            lie.compose(state.T_base_cam, lie.exp(mounts)),
            state.intrinsics + lenses,
            state.common + x[-len(COMMON) :],
        )

    def residuals(self, state: CalibrationState) -> Float[Array, " m"]:
        """Robust whitened residuals of the pictures and of the priors: what the equations are tested with."""
        parts = []
        for group in self.pictures:
            rows = self.rows(state, group)
            r, weight = alignment_residual(jnp.eye(4, dtype=rows.p_map.dtype), (rows,), self.texture)
            parts.append(jnp.sqrt(self.gain * weight) * robust_root(r, _LOSS))
        for r, threshold in self._factors(state):
            cost = jax.vmap(lambda row, t=threshold: cauchy_cost(row, t)[0])(r) if threshold else 0.5 * r.ravel() ** 2
            parts.append(jnp.sqrt(2 * cost))
        parts += [jnp.sqrt(2 * term.costs({"pose": state.T_local_base})) for term in self.terms]
        return jnp.concatenate([*parts, self._prior_terms(state)[0]])

    def _factors(self, state: CalibrationState) -> list[tuple[Array, float]]:
        """Whitened residuals of motion and anchors with the threshold of their losses; 0 for none."""
        fixes, road, reference = (r for r, *_ in self._anchor_terms(state))
        return [
            (self._motion_terms(state)[0], self.edge_threshold),
            (fixes, self.fix_threshold),
            (road, self.road_threshold),
            (reference, 0.0),
        ]

    def _terms(self, state: CalibrationState) -> list[ArrowEquations]:
        num, size, dtype = len(state.T_local_base), self.sigma.shape[0], self.sigma.dtype
        nothing = jnp.zeros((num, 6, 6), dtype), jnp.zeros((num, 6, size), dtype), jnp.zeros((size, size), dtype)
        parts = []
        for term in self.terms:
            local, (frame,) = term.local({"pose": state.T_local_base}, {"pose": POSE}), term.keys
            hessian = jax.ops.segment_sum(local.hessian, frame, num)
            gradient = jax.ops.segment_sum(local.gradient, frame, num)
            parts.append(ArrowEquations(jnp.sum(local.cost), hessian, *nothing, gradient, jnp.zeros(size, dtype)))
        return parts

    def _pictures(self, state: CalibrationState, group: PictureRows) -> ArrowEquations:
        num_cameras, width = state.intrinsics.shape
        size, dtype = self.sigma.shape[0], self.sigma.dtype
        found = camera_equations(self.rows(state, group), group.names, width, self.texture, _LOSS)
        T_frame_cam = lie.compose(group.T_frame_then, state.T_base_cam[group.camera])
        tangent = lie.adjoint(lie.inverse(T_frame_cam))
        by_pose = jnp.pad(tangent, ((0, 0), (0, width + len(MASKS)), (0, 0)))
        own = jax.nn.one_hot(group.camera, num_cameras, dtype=dtype)
        mounts = jnp.einsum("rc,ij->ricj", own, jnp.eye(6, dtype=dtype)).reshape(len(own), 6, 6 * num_cameras)
        lenses = jnp.einsum("rc,ij->ricj", own, jnp.eye(width, dtype=dtype)).reshape(
            len(own), width, width * num_cameras
        )
        by_shared = jnp.zeros((len(own), 6 + width + len(MASKS), size), dtype)
        by_shared = by_shared.at[:, 6 + width :, -len(MASKS) :].set(jnp.eye(len(MASKS), dtype=dtype))
        by_shared = by_shared.at[:, :6, : 6 * num_cameras].set(mounts)
        by_shared = by_shared.at[:, 6 : 6 + width, 6 * num_cameras : (6 + width) * num_cameras].set(lenses)
        H, g = self.gain * found.hessian, self.gain * found.gradient
        num = state.T_local_base.shape[0]

        def by_frame(values: Array) -> Array:
            return jax.ops.segment_sum(values, group.frame, num)

        return ArrowEquations(
            self.gain * jnp.sum(found.cost),
            by_frame(_product(by_pose, H, by_pose)),
            jnp.zeros((num, 6, 6), dtype),
            by_frame(_product(by_pose, H, by_shared)),
            jnp.sum(_product(by_shared, H, by_shared), axis=0),
            by_frame(jnp.einsum("rki,rk->ri", by_pose, g)),
            jnp.einsum("rki,rk->i", by_shared, g),
        )

    def _motion_terms(self, state: CalibrationState) -> tuple[Array, Array, Array, Array]:
        T = state.T_local_base
        after = jnp.concatenate([T[1:], T[-1:]])
        change = jnp.broadcast_to(state.common[:2] - self.common_prior[:2], (len(T), 2))
        edges = (self.motion.T_from_to, self.motion.jacobian, self.motion.sqrt_info)
        return jax.vmap(odometry_linearised)(T, after, change, *edges)

    def _motion(self, state: CalibrationState) -> ArrowEquations:
        r, J_from, J_to, J_vehicle = self._motion_terms(state)
        cost, root = jax.vmap(cauchy_cost, in_axes=(0, None))(r, self.edge_threshold)
        r, (J_from, J_to, J_vehicle) = r * root[:, None], (J * root[:, None, None] for J in (J_from, J_to, J_vehicle))
        J_shared = self._placed(J_vehicle, 0)
        start, end = _products(J_from, J_shared, r), _products(J_to, J_shared, r)

        def later(values: Array) -> Array:
            """From the row of the edge to the frame where it ends; the last edge ends nowhere."""
            return jnp.roll(values, 1, axis=0).at[0].set(0.0)

        return ArrowEquations(
            jnp.sum(cost[:-1]),
            start.link.at[-1].set(0.0) + later(end.link),
            jnp.einsum("nki,nkj->nij", J_from, J_to).at[-1].set(0.0),
            start.across.at[-1].set(0.0) + later(end.across),
            start.shared,
            start.link_gradient.at[-1].set(0.0) + later(end.link_gradient),
            start.shared_gradient,
        )

    def _anchor_terms(self, state: CalibrationState) -> list[tuple[Array, Array, Array | None]]:
        T, a = state.T_local_base, self.anchors
        fixes = jax.vmap(fix_linearised, in_axes=(0, None, 0, 0, 0))(
            T, state.common[2:4], a.fix_base, a.p_fix, a.fix_sqrt_info
        )
        road = jax.vmap(road_linearised, in_axes=(0, None, 0, 0, 0))(
            T, state.common[4:7], a.road_point, a.road_normal, a.road_sqrt_info
        )
        reference = jax.vmap(pose_linearised)(T, a.T_reference, a.reference_sqrt_info)
        return [fixes, road, (*reference, None)]

    def _anchors(self, state: CalibrationState) -> list[ArrowEquations]:
        parts = []
        thresholds, places = (self.fix_threshold, self.road_threshold, 0.0), (2, 4, 0)
        for (r, J, J_vehicle), threshold, place in zip(self._anchor_terms(state), thresholds, places, strict=True):
            cost, root = 0.5 * jnp.sum(r * r, axis=1), jnp.ones(len(r), r.dtype)
            if threshold:
                cost, root = jax.vmap(cauchy_cost, in_axes=(0, None))(r, threshold)
            if J_vehicle is None:
                J_vehicle = jnp.zeros((*r.shape, 1), r.dtype)
            J, J_shared = J * root[:, None, None], self._placed(J_vehicle * root[:, None, None], place)
            part = _products(J, J_shared, r * root[:, None])
            parts.append(eqx.tree_at(lambda e: e.cost, part, jnp.sum(cost)))
        return parts

    def _placed(self, J: Float[Array, "n k v"], place: int) -> Float[Array, "n k s"]:
        """Derivatives by unknowns of the vehicle, from the given one on, in the columns of all shared unknowns."""
        first = self.sigma.shape[0] - len(COMMON) + place
        return jnp.zeros((*J.shape[:2], self.sigma.shape[0]), J.dtype).at[:, :, first : first + J.shape[2]].set(J)

    def _prior_terms(self, state: CalibrationState) -> tuple[Float[Array, " s"], Float[Array, "s s"]]:
        """Deviations from the priors in sigmas, and their derivatives by the shared unknowns in their own units."""
        free = self.sigma > 0
        inverse = jnp.where(free, 1 / jnp.where(free, self.sigma, 1.0), 0.0)
        eye = jnp.broadcast_to(jnp.eye(6, dtype=inverse.dtype), (state.T_base_cam.shape[0], 6, 6))
        off, J = jax.vmap(pose_linearised)(state.T_base_cam, self.T_prior, eye)
        rest = jnp.concatenate([state.intrinsics.ravel(), state.common - self.common_prior])
        J_mounts = jax.scipy.linalg.block_diag(*J)
        jacobian = jax.scipy.linalg.block_diag(J_mounts, jnp.eye(rest.shape[0], dtype=inverse.dtype))
        return jnp.concatenate([off.ravel(), rest]) * inverse, inverse[:, None] * jacobian

    def _priors(self, state: CalibrationState) -> ArrowEquations:
        r, J = self._prior_terms(state)
        num, size, dtype = state.T_local_base.shape[0], len(r), r.dtype
        blocks = jnp.zeros((num, 6, 6), dtype)
        across, gradient = jnp.zeros((num, 6, size), dtype), jnp.zeros((num, 6), dtype)
        return ArrowEquations(0.5 * jnp.sum(r * r), blocks, blocks, across, J.T @ J, gradient, J.T @ r)


def visible(problem: CalibrationProblem, state: CalibrationState, usable: Usable, border_px: float):
    """The problem with the weight of every sample that cannot be seen from the state set to zero."""

    def seen(group: PictureRows) -> PictureRows:
        rows = problem.rows(state, group)
        shown = visibility(jnp.eye(4, dtype=rows.p_map.dtype), rows, usable, border_px)
        return eqx.tree_at(lambda g: g.views.weight, group, rows.weight * shown)

    return eqx.tree_at(lambda p: p.pictures, problem, tuple(seen(group) for group in problem.pictures))


class CalibrationSolution(eqx.Module):
    """The best state on one level and the quadratic model of the cost there."""

    state: CalibrationState
    equations: ArrowEquations
    inlier_ratio: Float[Array, ""]
    """Share of the visible contour that lies within the ramp."""
    num_steps: Int[Array, ""]
    converged: Bool[Array, ""]


@eqx.filter_jit
def solve_calibration(
    problem: CalibrationProblem,
    start: CalibrationState,
    usable: Usable,
    border_px: float = 2.0,
    tolerance: float = 1e-3,
    max_steps: int = 30,
) -> CalibrationSolution:
    """Poses and calibration that fit one level of the cost maps best, from a start.

    Visibility is frozen at the start: a mask that changes under the solver moves the optimum.
    """
    seen = visible(problem, start, usable, border_px)
    solution = solve(seen, start, SolveConfig(tolerance, max_steps, MIN_GAIN_NATS))
    state = solution.value
    held, everything = jnp.zeros((), seen.sigma.dtype), jnp.zeros((), seen.sigma.dtype)
    for group in seen.pictures:
        rows = seen.rows(state, group)
        r, weight = alignment_residual(jnp.eye(4, dtype=rows.p_map.dtype), (rows,), seen.texture)
        held, everything = held + jnp.sum(weight * is_inlier(r)), everything + jnp.sum(weight)
    inlier_ratio = held / jnp.maximum(everything, 1e-6)
    return CalibrationSolution(state, solution.equations, inlier_ratio, solution.num_steps, solution.converged)


def _added(a: ArrowEquations, b: ArrowEquations) -> ArrowEquations:
    return jax.tree.map(jnp.add, a, b)


def _product(a: Float[Array, "r k i"], H: Float[Array, "r k k"], b: Float[Array, "r k j"]) -> Float[Array, "r i j"]:
    return jnp.einsum("rki,rkl,rlj->rij", a, H, b, precision=jax.lax.Precision.HIGHEST)


def _products(J: Float[Array, "n k 6"], J_shared: Float[Array, "n k s"], r: Float[Array, "n k"]) -> ArrowEquations:
    """Squares of factors of one pose each, without their cost."""
    return ArrowEquations(
        jnp.zeros((), r.dtype),
        jnp.einsum("nki,nkj->nij", J, J),
        jnp.zeros((len(r), 6, 6), r.dtype),
        jnp.einsum("nki,nkj->nij", J, J_shared),
        jnp.einsum("nki,nkj->ij", J_shared, J_shared),
        jnp.einsum("nki,nk->ni", J, r),
        jnp.einsum("nki,nk->i", J_shared, r),
    )
