"""Which map elements hold the pose of a frame, and how far it moves where one of them is wrong (room: analysis; host).

In: a FrameLocalizer, the result of a frame, its masks and prior. Out: Explanation, one Holder for each element in view
and for each part of the prior, strongest first, and for each class together.
Three answers, of different reach: `by_shift`, the exact derivative of the optimum; `shifted` and `removed`, what the
solver itself answers from the same view when the element is moved or left out, all elements in one compiled call;
`analysis.explain_check` runs the whole localization in a map that was changed.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from semloc_jax.alignment.frame_localizer import FrameLocalizer, sample_within
from semloc_jax.alignment.implicit import smooth_scene
from semloc_jax.alignment.level_choice import holds
from semloc_jax.alignment.pose import AlignConfig, Evidence, Prior
from semloc_jax.alignment.pose_prior import PosePrior
from semloc_jax.alignment.result import LocalizationResult
from semloc_jax.alignment.single_frame import frame_input
from semloc_jax.analysis.changed_view import Group, cast, resolve
from semloc_jax.analysis.expected import TANGENT_OF_DIRECTION
from semloc_jax.analysis.explanation import Explanation, Holder
from semloc_jax.analysis.influence import PRIOR_PARTS, Balance, balance, influence, unsettled
from semloc_jax.cameras import Rig
from semloc_jax.errors import SemlocError
from semloc_jax.geometry import rigid
from semloc_jax.maps import LocalMap
from semloc_jax.perception.cost_maps import cost_maps
from semloc_jax.residuals.alignment import Usable, camera_views
from semloc_jax.residuals.view import view
from semloc_jax.structs import CostMaps, ElementClass

LETS_GO = 5**-0.5
"""Share of the reach of the loss at which it pulls most: from there on it pulls the less the farther a boundary is."""


@dataclass(frozen=True)
class ExplainConfig:
    """How elements are changed. All values are our choice."""

    shift_m: float = 0.10
    """How far an element is taken to be wrong."""
    max_drift_m: float = 0.30
    """An optimum farther than this from the pose of the frame is another one: the next coarser level explains it."""


def explain_frame(
    localizer: FrameLocalizer,
    result: LocalizationResult,
    masks: Sequence[np.ndarray],
    prior: PosePrior,
    rig: Rig,
    config: ExplainConfig | None = None,
) -> Explanation:
    """What holds the pose of a frame that was localized.

    Args:
        localizer: What localized it.
        result: Its pose.
        masks: Its masks.
        prior: The prior that it had.
        rig: Cameras of the masks.
        config: None for the defaults.

    Raises:
        SemlocError: there is no pose, or nothing of the map is seen from it.
    """
    config = config or ExplainConfig()
    if not np.isfinite(result.T_map_base).all():
        raise SemlocError(f"frame {result.frame.id}: has no pose to explain ({'; '.join(result.reasons) or 'lost'})")
    look = SeenFrame.of(localizer, result, masks, prior, rig)
    found, level = look.optimum(config.max_drift_m)
    sigma, holders = look.holders(found, level, config, look.elements_alone())
    _, classes = look.holders(found, level, config, look.classes_together())
    T = look.local_map.frame.to_map(found.T_local_base)
    offset = rigid.log(rigid.inverse(result.T_map_base) @ T)[TANGENT_OF_DIRECTION]
    classes = [holder for holder in classes if holder.is_element]
    ranked = (tuple(sorted(some, key=lambda holder: -holder.strength)) for some in (holders, classes))
    return Explanation(T, offset, found.is_exact, look.maps.ramp_px[level], sigma, config.shift_m, *ranked)


_view = jax.jit(view, static_argnames="config")
_MIN_CAPACITY = 32


@dataclass(frozen=True)
class SeenFrame:
    """One frame as it is seen from its pose; poses are relative to the local origin.

    Attributes:
        ids: of the elements in view.
        labels: their classes.
        middles: where they are, in the map frame.
        holder: number of the element of each sample of each view, -1 for padding.
    """

    T_found: np.ndarray
    prior: Prior
    local_map: LocalMap
    maps: CostMaps
    evidence: Evidence
    align: AlignConfig
    ids: tuple[str, ...]
    labels: tuple[ElementClass, ...]
    middles: np.ndarray
    holder: tuple[Int[Array, "cam p"], ...]

    @classmethod
    def of(
        cls,
        localizer: FrameLocalizer,
        result: LocalizationResult,
        masks: Sequence[np.ndarray],
        prior: PosePrior,
        rig: Rig,
    ) -> "SeenFrame":
        settings, T_prior = localizer.config, result.T_map_prior
        heading = float(np.arctan2(T_prior[1, 0], T_prior[0, 0])) if len(rig) == 1 else None
        local_map = localizer.map.query(T_prior[:3, 3], settings.search_radius_m, heading)
        samples = sample_within(local_map, settings.sample_spacing_m, settings.sample_capacity)
        maps = cost_maps(masks, localizer.shown, settings.cost_maps)
        inputs = frame_input(samples, maps, rig, localizer.channel_of_label)
        T_found = local_map.frame.from_map(result.T_map_base, np.float64)
        to_dtype = partial(cast, dtype=jnp.zeros(()).dtype)
        near = jnp.asarray(T_found, jnp.float32)
        seen = _view(samples, near, rig, inputs.channel_of_label, settings.frame.polish_view)
        views = camera_views(rig, jax.tree.map(to_dtype, seen))
        usable = Usable(inputs.usable.mask, inputs.usable.stride)
        evidence = Evidence(views, inputs.textures, usable)
        spread = localizer.map.road_spread(T_prior)
        solver_prior = jax.tree.map(to_dtype, prior.to_solver(T_prior, local_map.frame, settings.road, spread))
        rows = np.asarray(seen.element)
        shown = np.unique(rows[(rows >= 0) & (np.asarray(seen.weight) > 0)])
        # A line that was cut at the search radius is one element in several parts.
        ids = tuple(dict.fromkeys(local_map.elements[row].id for row in shown))
        if not ids:
            raise SemlocError(f"frame {result.frame.id}: nothing of map {localizer.map.name} is in view of its pose")
        number = np.full(len(local_map.elements) + 1, -1)
        number[shown] = [ids.index(local_map.elements[row].id) for row in shown]
        parts = {local_map.elements[row].id: local_map.elements[row] for row in reversed(shown)}
        return cls(
            T_found,
            solver_prior,
            local_map,
            maps,
            evidence,
            settings.frame.polish_align,
            ids,
            tuple(parts[key].label for key in ids),
            np.array([parts[key].points.mean(axis=0) for key in ids]),
            tuple(jnp.asarray(number[rows[np.asarray(part.index)]]) for part in views),
        )

    @property
    def capacity(self) -> int:
        """Number of elements that programs are compiled for."""
        return max(_MIN_CAPACITY, 1 << (len(self.ids) - 1).bit_length())

    def optimum(self, max_drift_m: float) -> tuple[Balance, int]:
        """The optimum on the finest level that holds the pose, as `alignment.pose.align_one` chooses it; and the level.

        Where there is none near the pose, the pose itself on the coarsest level, with Gauss-Newton's curvature.
        """
        coarsest = self.align.levels[0]
        for level in reversed(self.align.levels):
            scene = smooth_scene(self.evidence, self.maps, self.align, level)
            found = balance(self.T_found, scene, self.prior, self.holder, self.capacity)
            drift_m = np.hypot(*(found.T_local_base - self.T_found)[:2, 3])
            inlier_ratio = found.terms.inlier.sum() / max(found.terms.weight.sum(), 1e-9)
            is_held = holds(inlier_ratio, self.align.min_inlier_ratio) or level == coarsest
            if found.is_exact and drift_m <= max_drift_m and is_held:
                return found, level
        return unsettled(self.T_found, scene, self.prior, self.holder, self.capacity), coarsest

    def elements_alone(self) -> "list[Group]":
        """Every element, and both parts of the prior."""
        num = len(self.ids)
        groups = [Group(self.ids[k], self.labels[k], self.middles[k], (k,)) for k in range(num)]
        here = self.local_map.frame.to_map(self.T_found[:3, 3])
        return groups + [Group(name, None, here, (num + k,)) for k, name in enumerate(PRIOR_PARTS)]

    def classes_together(self) -> "list[Group]":
        """All elements of each class, and both parts of the prior."""
        groups = []
        for label in sorted(set(self.labels)):
            rows = tuple(k for k, own in enumerate(self.labels) if own == label)
            groups.append(Group(label.name.lower(), label, self.middles[list(rows)].mean(axis=0), rows))
        return groups + self.elements_alone()[len(self.ids) :]

    def holders(
        self, found: Balance, level: int, config: ExplainConfig, groups: "list[Group]"
    ) -> tuple[np.ndarray, list[Holder]]:
        """Standard deviation of each direction, and one Holder for each group."""
        num = len(self.ids)
        used = [*range(num), *range(self.capacity, self.capacity + len(PRIOR_PARTS))]
        terms = jax.tree.map(lambda leaf: leaf[used], found.terms)
        terms = jax.tree.map(lambda leaf: np.stack([leaf[list(g.rows)].sum(axis=0) for g in groups]), terms)
        ramp_px = self.maps.ramp_px[level]
        noise_px = self.align.noise.floor_px(ramp_px)
        scatter_px = np.sqrt(terms.square_px2.sum() / max(terms.pulling.sum(), 1e-9))
        told = influence(
            terms, np.asarray(self.prior.sigma, np.float64), self.align.noise.excess(float(scatter_px), ramp_px)
        )
        R = found.T_local_base[:3, :3]
        rows = TANGENT_OF_DIRECTION
        by_shift = told.motion[:, rows, :3] @ R.T
        worst = np.stack([_worst(by_shift[k], group) for k, group in enumerate(groups)])
        given = (self.T_found, self.evidence, self.prior, self.holder, self.align)
        way, shifted, removed = resolve(*given, groups, self.capacity, config.shift_m * worst)
        worst = way * worst
        holders = []
        for k, group in enumerate(groups):
            seen, pulling = terms.weight[k], max(terms.pulling[k], 1e-9)
            along = R.T @ worst[k]
            px_per_m = noise_px * np.sqrt(max(along @ terms.information[k, :3, :3] @ along, 1e-12) / pulling)
            away = self.local_map.frame.to_map(found.T_local_base[:3, 3]) - group.middle_map
            turn = np.concatenate([R.T @ np.cross([0.0, 0.0, 1.0], away), R.T @ [0.0, 0.0, 1.0]])
            holders.append(
                Holder(
                    id=group.id,
                    label=group.label,
                    middle_map=group.middle_map,
                    num_samples=int(terms.num_samples[k]),
                    observations=float(seen),
                    pull=float(terms.pulling[k] / max(seen, 1e-9)) if group.is_element else 1.0,
                    residual_px=float(terms.absolute_px[k] / pulling),
                    share=told.share[k, rows],
                    sigma_without=told.sigma_without[k, rows],
                    by_shift=by_shift[k],
                    by_turn=told.motion[k, rows] @ turn,
                    worst_map=worst[k],
                    linear_to_m=float(LETS_GO * ramp_px / px_per_m) if group.is_element else np.inf,
                    linear=config.shift_m * by_shift[k] @ worst[k],
                    shifted=shifted[k],
                    removed=removed[k],
                )
            )
        return told.sigma[rows], holders


def _worst(by_shift: Float[np.ndarray, "3 3"], group: Group) -> Float[np.ndarray, "3"]:
    """Unit direction of the map along which a shift moves the vehicle farthest; horizontal but for the road's."""
    if not group.is_element and group.id == PRIOR_PARTS[1]:
        return np.array([0.0, 0.0, 1.0])
    _, _, Vt = np.linalg.svd(by_shift[:2, :2])
    return np.append(Vt[0], 0.0)
