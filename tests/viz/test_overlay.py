"""Overlays: the map lands on the pixels where the projection formula puts it, in the colour of its class."""

import numpy as np
import pytest

from semloc_jax import viz
from semloc_jax.cameras import PinholeCamera
from semloc_jax.maps.elements import MapElement
from semloc_jax.maps.sampling import sample
from semloc_jax.maps.semantic_map import SemanticMap
from semloc_jax.perception.class_table import load_class_table
from semloc_jax.structs import ElementClass
from semloc_jax.viz.overlay import Panel, before_after
from semloc_jax.viz.style import COLOURS, rgb

CAMERA = PinholeCamera(fx=400.0, fy=400.0, cx=319.5, cy=239.5, width=640.0, height=480.0)
HEIGHT_M = 1.5
# Camera above the rear axle, looking ahead.
T_BASE_CAM = np.array([[0.0, 0.0, 1.0, 0.0], [-1.0, 0.0, 0.0, 0.0], [0.0, -1.0, 0.0, HEIGHT_M], [0.0, 0.0, 0.0, 1.0]])
PLACE = np.array([1000.0, 2000.0, 30.0])


def _scene() -> SemanticMap:
    """A line of paint to the left, a pole to the right ahead; the vehicle at PLACE looks east."""
    line = np.array([[4.0, 2.0, 0.0], [30.0, 2.0, 0.0]]) + PLACE
    pole = np.array([[10.0, -3.0, 0.0], [10.0, -3.0, 4.0]]) + PLACE
    return SemanticMap(
        (
            MapElement("line", ElementClass.LANE_MARKING, line, width_m=0.2),
            MapElement("pole", ElementClass.POLE, pole, radius_m=0.1, radius_top_m=0.1),
        )
    )


def _pose(offset=(0.0, 0.0, 0.0)) -> np.ndarray:
    T = np.eye(4)
    T[:3, 3] = PLACE + offset
    return T


@pytest.fixture(scope="module")
def contours():
    local = _scene().query(PLACE, 50.0)
    return viz.project_contours(sample(local, 0.25), local.frame, _pose(), CAMERA, T_BASE_CAM)


def test_contours_lie_where_the_pinhole_formula_puts_them(contours):
    uv = contours.uv[contours.label == ElementClass.LANE_MARKING].reshape(-1, 2)
    # A ground point (x, y) is seen at u = cx - f y / x, v = cy + f h / x: both edges lie at y = 2 -+ 0.1.
    x = 400.0 * HEIGHT_M / (uv[:, 1] - 239.5)
    y = (319.5 - uv[:, 0]) * x / 400.0
    on_edge = np.minimum(np.abs(y - 1.9), np.abs(y - 2.1)) < 1e-3
    on_cap = np.minimum(np.abs(x - 4.0), np.abs(x - 30.0)) < 0.15
    assert np.all(on_edge | on_cap)
    assert on_edge.mean() > 0.9


def test_pole_shows_its_silhouette(contours):
    uv = contours.uv[contours.label == ElementClass.POLE].reshape(-1, 2)
    distance = np.hypot(10.0, 3.0)
    # The two sides lie a radius to either side of the axis, across the line of sight.
    for sign in (-1.0, 1.0):
        x, y = np.array([10.0, -3.0]) + sign * 0.1 * np.array([3.0, 10.0]) / distance
        assert np.min(np.abs(uv[:, 0] - (319.5 - 400.0 * y / x))) < 0.2


def test_drawn_pixels_have_the_colour_of_their_class(contours):
    picture = viz.draw_contours(np.zeros((480, 640, 3), np.uint8), contours, thickness_px=3)
    for label in (ElementClass.LANE_MARKING, ElementClass.POLE):
        middle = contours.uv[contours.label == label].mean(axis=1).round().astype(int)
        inside = middle[(middle[:, 0] > 2) & (middle[:, 0] < 637) & (middle[:, 1] > 2) & (middle[:, 1] < 477)]
        near = inside[np.argmax(inside[:, 1])]
        assert np.abs(picture[near[1], near[0]].astype(int) - rgb(COLOURS[label])).max() < 30
    assert not picture[:200, :200].any(), "nothing is drawn in the empty sky"


def test_the_image_itself_is_not_drawn_on(contours):
    image = np.zeros((480, 640, 3), np.uint8)
    viz.draw_contours(image, contours)
    assert not image.any()


def test_a_small_image_is_enlarged_with_its_contours():
    """A bright pixel and the contour on it lie at the same place of the larger image."""
    image = np.zeros((30, 100, 3), np.uint8)
    image[12, 70] = 255
    ends = np.array([[[70.0, 12.0], [70.0, 12.0]]])
    large, moved = viz.at_width(image, viz.Contours(ends, np.zeros(1, int)), 960)
    assert large.shape == (288, 960, 3)
    v, u = np.nonzero(large[..., 0] > 100)
    assert moved.uv[0, 0] == pytest.approx([u.mean(), v.mean()], abs=0.6)
    nothing = viz.at_width(image, viz.Contours.none(), 50)[1]
    assert nothing.classes == () and viz.draw_contours(large, nothing).shape == large.shape


def test_a_move_to_the_left_shifts_the_map_to_the_right(contours):
    local = _scene().query(PLACE, 50.0)
    moved = viz.project_contours(sample(local, 0.25), local.frame, _pose((0.0, 0.5, 0.0)), CAMERA, T_BASE_CAM)
    pole = moved.uv[moved.label == ElementClass.POLE][..., 0].mean()
    assert pole - contours.uv[contours.label == ElementClass.POLE][..., 0].mean() == pytest.approx(20.0, abs=0.5)


def test_nothing_behind_the_camera_is_drawn():
    local = _scene().query(PLACE, 50.0)
    turned = _pose() @ np.diag([-1.0, -1.0, 1.0, 1.0])
    seen = viz.project_contours(sample(local, 0.25), local.frame, turned, CAMERA, T_BASE_CAM)
    assert len(seen.uv) == 0


def test_mask_picture_colours_channels_and_hides_what_is_unusable():
    table = load_class_table("drive")
    mask = np.array([[10, 20, 7, 1]], np.uint8)
    lane, pole, vehicle, road = viz.mask_picture(mask, table)[0].astype(int)
    for pixel, label in ((lane, ElementClass.LANE_MARKING), (pole, ElementClass.POLE)):
        assert np.abs(pixel - 0.55 * np.array(rgb(COLOURS[label]))).max() <= 1
    assert vehicle[0] > 2 * vehicle[1]
    assert road[0] == road[1] == road[2]


def test_before_after_shows_both_columns_and_the_verdict(contours):
    empty = viz.Contours(np.zeros((0, 2, 2)), np.zeros(0, np.int32))
    image = np.full((480, 640, 3), 40, np.uint8)
    figure = before_after([Panel("front", image, empty, contours)], "prior", "localized: cost 0.08")
    texts = [axes.get_title(loc="left") for axes in figure.axes]
    assert texts == ["prior", "localized: cost 0.08"]
    labels = [text.get_text() for legend in figure.legends for text in legend.get_texts()]
    assert labels == ["lane marking", "pole"]
    picture = viz.to_image(figure).astype(int)
    cyan = (np.abs(picture - rgb(COLOURS[ElementClass.LANE_MARKING])).max(axis=2) < 60)[:-40]
    half = picture.shape[1] // 2
    assert cyan[:, :half].sum() == 0
    assert cyan[:, half:].sum() > 200
