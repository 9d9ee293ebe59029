"""The map from above: things are where their coordinates say, in the colour of their class."""

import numpy as np
import pytest
import shapely

from semloc_jax import viz
from semloc_jax.maps.elements import MapElement
from semloc_jax.structs import ElementClass
from semloc_jax.viz.bev import VEHICLE_M, map_view
from semloc_jax.viz.style import COLOURS, ESTIMATE, REFERENCE, rgb


def _pixel(figure, xy):
    """Colour of a place in the map."""
    picture = viz.to_image(figure).astype(int)
    column, row = figure.axes[0].transData.transform(xy)
    return picture[picture.shape[0] - 1 - round(row), round(column)]


def _pose(x, y, yaw_deg):
    T = np.eye(4)
    c, s = np.cos(np.deg2rad(yaw_deg)), np.sin(np.deg2rad(yaw_deg))
    T[:2, :2], T[:2, 3] = [[c, -s], [s, c]], [x, y]
    return T


ELEMENTS = (
    MapElement("bar", ElementClass.STOP_LINE, np.array([[0.0, -4.0, 0.0], [0.0, 4.0, 0.0]]), width_m=1.0),
    MapElement("zebra", ElementClass.CROSSWALK, np.array([[6.0, 0, 0], [9, 0, 0], [9, 3, 0], [6, 3, 0]]), closed=True),
    MapElement("idea", ElementClass.LANE_MARKING, np.array([[-9.0, -8, 0], [9.0, -8, 0]]), style="virtual"),
)


def test_paint_is_a_surface_at_its_place():
    figure = map_view(ELEMENTS, center=np.zeros(2), radius_m=12.0)
    for place, label in (((0.3, 2.0), ElementClass.STOP_LINE), ((7.5, 1.5), ElementClass.CROSSWALK)):
        assert _pixel(figure, place) == pytest.approx(rgb(COLOURS[label]), abs=4)
    assert _pixel(figure, (0.9, 2.0)).max() < 60, "beside the bar is asphalt"
    assert _pixel(figure, (1.3, -8.0)).max() < 60, "logical lines are not drawn"


def test_vehicles_stand_at_their_poses_and_point_forward():
    estimate, truth = _pose(-5.0, 0.0, 90.0), _pose(5.0, -5.0, 0.0)
    figure = map_view(ELEMENTS, estimate=estimate, reference=truth, center=np.zeros(2), radius_m=12.0)
    assert _pixel(figure, (-5.0, 1.5)) == pytest.approx(rgb(ESTIMATE), abs=30)
    nose = truth[:2, 3] + [VEHICLE_M[0, 0] - 0.02, 0.0]
    assert _pixel(figure, nose)[1] > 150
    assert _pixel(figure, nose)[1] - _pixel(figure, nose)[0] > 60, "the truth is drawn in green"
    assert rgb(REFERENCE)[1] > rgb(REFERENCE)[0]


def test_the_legend_names_what_is_drawn():
    figure = map_view(ELEMENTS, estimate=np.stack([_pose(0, 0, 0), _pose(1, 0, 0)]), hypotheses=[(1.0, _pose(0, 0, 0))])
    labels = [text.get_text() for text in figure.legends[0].get_texts()]
    assert labels == ["stop line", "crosswalk", "estimate"]


def test_outline_of_the_vehicle_is_a_car():
    assert shapely.Polygon(VEHICLE_M).area == pytest.approx(4.0 * 1.9 + 0.5 * 0.8 * 1.9)
