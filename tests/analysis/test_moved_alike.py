"""Faults of the map that nothing sees, since they move all that masks show alike."""

import numpy as np

from semloc_jax.analysis.moved_alike import is_moved_alike
from semloc_jax.maps import MapElement, SemanticMap
from semloc_jax.perception.class_table import load_class_table
from semloc_jax.structs import ElementClass


def street(lines_left_m: tuple[float, float], post_left_m: float = 0.0) -> SemanticMap:
    """Two lines and a post, each so far to the left of its place."""
    lines = [
        MapElement(
            f"line{k}", ElementClass.LANE_MARKING, np.array([[0.0, y_m + 3.0 * k, 0.0], [9.0, y_m + 3.0 * k, 0.0]])
        )
        for k, y_m in enumerate(lines_left_m)
    ]
    post = np.array([[5.0, 6.0 + post_left_m, 0.0], [5.0, 6.0 + post_left_m, 3.0]])
    return SemanticMap((*lines, MapElement("post", ElementClass.POLE, post)))


def test_lines_moved_as_a_whole_are_a_moved_map_to_masks_that_show_lines_alone():
    sound, moved = street((0.0, 0.0)), street((0.5, 0.5))
    lines, posts_too = load_class_table("lane_paint"), load_class_table("classical")
    assert is_moved_alike(sound, moved, lines)
    assert not is_moved_alike(sound, moved, posts_too)
    assert is_moved_alike(sound, street((0.5, 0.5), 0.5), posts_too)


def test_lines_that_part_or_stay_can_be_seen():
    sound, lines = street((0.0, 0.0)), load_class_table("lane_paint")
    assert not is_moved_alike(sound, street((0.5, 0.0)), lines)
    assert not is_moved_alike(sound, sound, lines)
    one = SemanticMap(tuple(e for e in street((0.5, 0.5)).elements if e.id != "line1"))
    assert not is_moved_alike(sound, one, lines)
