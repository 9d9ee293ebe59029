"""Follow the vehicle through a drive, in one call (room: localization; host).

In: a Drive, a SemanticMap, masks. Out: one TrackResult for each frame.
"""

from collections.abc import Iterator, Sequence

from semloc_jax.alignment.pose_prior import PriorSource
from semloc_jax.datasets import Drive, Frame
from semloc_jax.errors import SemlocError
from semloc_jax.fusion.inertial_fusion import InertialFusion
from semloc_jax.fusion.window import SlidingWindow
from semloc_jax.inputs.mask_source import MaskSource, mask_source
from semloc_jax.inputs.priors import prior_source
from semloc_jax.localization.localizer import Localizer, TrackConfig
from semloc_jax.localization.motion_source import MotionChoice, motion_log, resolved
from semloc_jax.localization.pipeline import Pipeline
from semloc_jax.localization.track_state import TrackResult
from semloc_jax.maps import SemanticMap
from semloc_jax.residuals.pose_terms import TermSource, one_of_each


def track_frames(
    drive: Drive,
    semantic_map: SemanticMap,
    masks: MaskSource | str,
    prior: PriorSource | str | None = None,
    frames: slice | Sequence[Frame] = slice(None),
    cameras: Sequence[str] | None = None,
    config: TrackConfig | None = None,
    terms: TermSource | None = None,
    motion: MotionChoice = "auto",
) -> Iterator[TrackResult]:
    """One TrackResult after another: `status`, `reasons`, fused pose with covariance, protection levels.

    Args:
        drive: The drive; its logs say how the vehicle moves between frames.
        semantic_map: The map.
        masks: Mask folder of the drive, segmenter, or a MaskSource.
        prior: Where to start if the satellite fixes do not say it: `truth`, a trajectory file or a PriorSource; None
            for the fixes alone.
        frames: Which frames, in time order.
        cameras: Names, where `masks` is a name; None for all that have such masks.
        config: None for the defaults.
        terms: What else was measured at a frame: a function of the Frame that gives terms; see `pose_term`.
        motion: What says how the vehicle moved: wheels, `vio` (inertial sensor, with cameras where there are images),
            both; auto: wheels where they are, else vio.

    Raises:
        SemlocError: unknown masks or cameras, a map without classes that the masks show, no frames, a drive that lacks
            what the motion needs.

    >>> results = list(sj.track_frames(drive, semantic_map, masks="sem", prior="truth"))
    >>> len(results), results[-1].T_map_base.shape, results[-1].status.name
    (3, (4, 4), 'INITIALIZING')
    """
    chosen = drive.frames[frames] if isinstance(frames, slice) else frames
    if not chosen:
        raise SemlocError(f"drive {drive.name}: no frames chosen of {len(drive)}; check the slice")
    source = mask_source(masks, drive, cameras) if isinstance(masks, str) else masks
    guess = prior_source(prior, drive) if isinstance(prior, str) else prior
    by = resolved(drive, motion)
    kinds = () if terms is None else one_of_each(terms(frame) for frame in chosen)
    fusion = SlidingWindow(terms=kinds) if by == "wheels" else InertialFusion()
    localizer = Localizer(semantic_map, source.table, motion_log(drive, by, source), fusion, config)
    yield from Pipeline(drive, source, localizer, guess=guess, terms=terms).run(chosen)
