"""Localize frames of a drive one by one: the main job (room: localization; host).

In: a Drive, a SemanticMap, masks. Out: one LocalizationResult for each frame.
The same functions serve the command line, notebooks and the library.
"""

from collections.abc import Callable, Iterator, Sequence
from typing import Protocol, runtime_checkable

import numpy as np

from semloc_jax.alignment.frame_localizer import FrameLocalizer, LocalizeConfig
from semloc_jax.alignment.pose_prior import PosePrior, PriorSource
from semloc_jax.alignment.result import LocalizationResult
from semloc_jax.cameras import Rig
from semloc_jax.datasets import Drive, Frame
from semloc_jax.errors import SemlocError
from semloc_jax.inputs.mask_source import MaskSource, mask_source
from semloc_jax.inputs.priors import prior_source
from semloc_jax.maps import SemanticMap
from semloc_jax.runtime.allocator import return_large_blocks
from semloc_jax.runtime.effort import effort_for


@runtime_checkable
class SingleFrameLocalizer(Protocol):
    """What places one frame on its map: `FrameLocalizer`, or a way of the literature."""

    def localize(
        self, frame: Frame | None, masks: Sequence[np.ndarray], prior: PosePrior, rig: Rig | None = None
    ) -> LocalizationResult:
        """The pose of one frame; see `FrameLocalizer.localize`."""
        ...


def localize_frames(
    drive: Drive,
    semantic_map: SemanticMap,
    masks: MaskSource | str,
    prior: PriorSource | str = "gnss",
    frames: slice | Sequence[Frame] = slice(None),
    cameras: Sequence[str] | None = None,
    config: LocalizeConfig | None = None,
    on_frame: Callable[[LocalizationResult], None] | None = None,
) -> list[LocalizationResult]:
    """One LocalizationResult for each frame of a drive, each localized on its own; for the rest see `iterate_frames`.

    Args:
        on_frame: Called with each result as soon as it is there.

    Raises:
        SemlocError: as `iterate_frames`.

    >>> results = sj.localize_frames(drive, semantic_map, masks="sem", frames=slice(0, 1))
    >>> results[0].frame.id, results[0].localized
    ('000000', True)
    """
    results = []
    with effort_for(len(drive.frames[frames] if isinstance(frames, slice) else frames)):
        for result in iterate_frames(drive, semantic_map, masks, prior, frames, cameras, config):
            results.append(result)
            if on_frame is not None:
                on_frame(result)
    return results


def iterate_frames(
    drive: Drive,
    semantic_map: SemanticMap,
    masks: MaskSource | str,
    prior: PriorSource | str = "gnss",
    frames: slice | Sequence[Frame] = slice(None),
    cameras: Sequence[str] | None = None,
    config: LocalizeConfig | None = None,
    localizer: SingleFrameLocalizer | None = None,
) -> Iterator[LocalizationResult]:
    """One LocalizationResult after another.

    Args:
        drive: The drive.
        semantic_map: The map.
        masks: Mask folder of the drive, segmenter, or a MaskSource.
        prior: `gnss`, `truth`, a trajectory file or a PriorSource.
        frames: Which frames.
        cameras: Names, where `masks` is a name; None for all that have such masks.
        config: None for the defaults.
        localizer: What places a frame; None for a `FrameLocalizer` with the configuration.

    Raises:
        SemlocError: unknown masks or cameras, no prior, a map without classes that the masks show, no frames.

    >>> for result in sj.iterate_frames(drive, semantic_map, masks="sem", prior="truth", frames=slice(0, 1)):
    ...     print(result.frame.id, result.status.name)
    000000 CONVERGED
    """
    return_large_blocks()
    chosen = drive.frames[frames] if isinstance(frames, slice) else frames
    if not chosen:
        raise SemlocError(f"drive {drive.name}: no frames chosen of {len(drive)}; check --frames")
    source = mask_source(masks, drive, cameras) if isinstance(masks, str) else masks
    give_prior = prior_source(prior, drive) if isinstance(prior, str) else prior
    localizer = localizer or FrameLocalizer(semantic_map, source.table, config)
    for frame in chosen:
        rig = source.seen_by(frame.rig.select(source.cameras))
        yield localizer.localize(frame, source.masks(frame), give_prior(frame), rig)
