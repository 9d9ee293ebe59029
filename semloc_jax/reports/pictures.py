"""Before/after pictures of a run (room: reports).

In: a map, the source of masks, localization results. Out: overlays/*.png.
"""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from semloc_jax import viz
from semloc_jax.alignment.result import LocalizationResult
from semloc_jax.cameras import Rig
from semloc_jax.datasets import Frame
from semloc_jax.inputs.mask_source import MaskSource
from semloc_jax.maps import LocalMap, SemanticMap, sample
from semloc_jax.storage import output_path
from semloc_jax.structs import MapSamples
from semloc_jax.viz.overlay import Contours, Panel, dim

RADIUS_M, SPACING_M = 65.0, 0.25


def write_overlays(
    folder: Path, semantic_map: SemanticMap, source: MaskSource, found: Sequence[LocalizationResult], count: int
) -> list[Path]:
    """Write before/after pictures of `count` frames, spread over the run."""
    shown = [r for r in found if np.isfinite(r.T_map_base).all()]
    if not shown or count < 1:
        return []
    paths = []
    for index in np.unique(np.linspace(0, len(shown) - 1, count).astype(int)):
        result = shown[index]
        figure = viz.before_after(panels(semantic_map, source, result), "before: prior", verdict_text(result))
        paths.append(viz.save(figure, output_path(folder, "overlays", result.frame.id, suffix=".png")))
    return paths


def panels(semantic_map: SemanticMap, source: MaskSource, result: LocalizationResult) -> list[Panel]:
    """One panel for each camera: its image, else its mask, with the map as seen from the prior and from the pose."""
    rig = result.frame.rig.select(source.cameras)
    masks_rig = source.segment_rig(rig)
    contours = []
    for T_map_base in (result.T_map_prior, result.T_map_base):
        local_map = semantic_map.query(T_map_base[:3, 3], RADIUS_M)
        contours.append((sample(local_map, SPACING_M), local_map.frame, T_map_base))
    found = []
    for index, name in enumerate(rig.names):
        if result.frame.has("rgb", name):
            image, camera = dim(result.frame.image(name)[..., ::-1]), rig.cameras[index]
        else:
            image, camera = viz.mask_picture(source.segment(result.frame, name), source.table), masks_rig.cameras[index]
        before, after = (viz.project_contours(*part, camera, rig.T_base_cam[index]) for part in contours)
        found.append(Panel(name, image, before, after))
    return found


def element_panels(
    semantic_map: SemanticMap, source: MaskSource, frame: Frame, T_map_base: np.ndarray
) -> list[tuple[str, np.ndarray, dict[str, Contours]]]:
    """Name of each camera, its image, else its mask, and the contours of each map element in it by the element's id."""
    found, local_map = [], semantic_map.query(T_map_base[:3, 3], RADIUS_M)
    samples = sample(local_map, SPACING_M)
    for index, name in enumerate(source.cameras):
        image, seen, ids = camera_picture(local_map, samples, source, frame, T_map_base, index)
        found.append((name, image, {key: seen.where(ids == key) for key in dict.fromkeys(ids)}))
    return found


def camera_picture(
    local_map: LocalMap,
    samples: MapSamples,
    source: MaskSource,
    frame: Frame,
    T_map_base: np.ndarray,
    index: int = 0,
) -> tuple[np.ndarray, Contours, np.ndarray]:
    """The image of one camera, else its mask, the contours of the map in it, and the id of the element of each."""
    rig, name = frame.rig.select(source.cameras), source.cameras[index]
    if frame.has("rgb", name):
        image, camera = dim(frame.image(name)[..., ::-1]), rig.cameras[index]
    else:
        image, camera = (
            viz.mask_picture(source.segment(frame, name), source.table),
            source.segment_rig(rig).cameras[index],
        )
    seen = viz.project_contours(samples, local_map.frame, T_map_base, camera, rig.T_base_cam[index])
    return image, seen, np.array([local_map.elements[row].id for row in seen.element], dtype=object)


def calibration_panels(
    semantic_map: SemanticMap, source: MaskSource, frame: Frame, T_map_base: np.ndarray, before: Rig, after: Rig
) -> list[Panel]:
    """One panel for each camera: the map as seen from one pose with one calibration and with another."""
    local_map = semantic_map.query(T_map_base[:3, 3], RADIUS_M)
    samples = sample(local_map, SPACING_M)
    found = []
    for name in source.cameras:
        has_image = frame.has("rgb", name)
        image = (
            dim(frame.image(name)[..., ::-1])
            if has_image
            else viz.mask_picture(source.segment(frame, name), source.table)
        )
        contours = []
        for rig in (before.select([name]), after.select([name])):
            camera = (rig if has_image else source.segment_rig(rig)).cameras[0]
            contours.append(
                viz.project_contours(samples, local_map.frame, T_map_base, camera, np.asarray(rig.T_base_cam[0]))
            )
        found.append(Panel(name, image, *contours))
    return found


def verdict_text(result: LocalizationResult) -> str:
    """Status and numbers of a result in one line."""
    state = "localized" if result.localized else f"not localized: {result.status.name.lower().replace('_', ' ')}"
    if not result.modes:  # nothing of the map is seen: the pose is that of the prior
        return f"after: {state}"
    best = result.modes[0]
    sigma = f"sigma {100 * best.sigma_lateral_m:.0f} / {100 * best.sigma_longitudinal_m:.0f} cm"
    return f"after: {state}, cost {best.cost:.2f}, coverage {best.coverage:.0%}, {sigma}"
