"""Paint drawn from above comes back as strokes, rectangles and outlines, to a fraction of a cell."""

from itertools import pairwise

import cv2
import numpy as np
import pytest

from semloc_jax.mapping.evidence_grid import EvidenceGrid
from semloc_jax.mapping.line_pieces import cut_to, joined
from semloc_jax.mapping.looking import paint_layers
from semloc_jax.mapping.outlines import find_outlines, find_rectangles
from semloc_jax.mapping.road_heights import RoadHeights
from semloc_jax.mapping.stroke_profiles import TraceLimits
from semloc_jax.mapping.strokes import PaintTrace, find_strokes
from semloc_jax.mapping.vectorize import Layer, VectorConfig, elements_of
from semloc_jax.perception import load_class_table
from semloc_jax.structs import ElementClass

CELL_M = 0.025


def painted(polygons, shape=(400, 700), noise=0.0, seed=0):
    """Share of looks that show paint: polygons x, y [cells] drawn eight times finer, then averaged."""
    fine = np.zeros((8 * shape[0], 8 * shape[1]), np.uint8)
    for polygon in polygons:
        # The centre of cell (0, 0) is that of the first 8 x 8 fine pixels.
        corners = np.rint((np.asarray(polygon) + 0.5) * 8 - 0.5).astype(np.int32)
        cv2.fillPoly(fine, [corners], 255)
    share = cv2.resize(fine, shape[::-1], interpolation=cv2.INTER_AREA).astype(np.float32) / 255.0
    share = cv2.GaussianBlur(share, (0, 0), 1.0)
    return np.clip(share + noise * np.random.default_rng(seed).standard_normal(shape), 0, 1).astype(np.float32)


def bar(x, y, length, width, turn_deg=0.0):
    turn = np.deg2rad(turn_deg)
    axes = np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]])
    return np.array([x, y]) + np.array([[0, -0.5], [1, -0.5], [1, 0.5], [0, 0.5]]) * [length, width] @ axes


ALL = np.ones((400, 700), bool)


@pytest.mark.parametrize("turn_deg", [0.0, 17.0, -31.0])
def test_a_dash_is_found_with_its_ends(turn_deg):
    (stroke,) = find_strokes(painted([bar(200, 200, 160, 6, turn_deg)], noise=0.03), ALL)
    direction = np.array([np.cos(np.deg2rad(turn_deg)), np.sin(np.deg2rad(turn_deg))])
    ends = stroke.middle[[0, -1]][np.argsort(stroke.middle[[0, -1]] @ direction)]
    np.testing.assert_allclose(ends[0], [200, 200], atol=0.8)
    np.testing.assert_allclose(ends[1], [200, 200] + 160 * direction, atol=0.8)
    assert stroke.width == pytest.approx(6.0, abs=0.8)
    assert stroke.is_end == (True, True)


def test_a_ragged_band_is_one_stroke():
    """What is left beside a stroke leads back to it: such a curb was drawn 200 times."""
    x = np.arange(60.0, 640.0, 5.0)
    rim = 6.0 + np.random.default_rng(1).choice([0.0, 7.0], len(x), p=(0.8, 0.2))
    share = painted([np.vstack([np.c_[x, 200 - rim], np.c_[x, 200 + rim[::-1]][::-1]])])
    (stroke,) = find_strokes(share, ALL)
    assert np.abs(stroke.middle[:, 1] - 200).max() < 3.0
    assert stroke.length == pytest.approx(575.0, abs=8.0)


def test_a_line_that_runs_into_another_ends_where_it_does():
    """A lane that ends: its line comes in at 6 deg, and their paint is one from there on."""
    share = painted([bar(40, 200, 600, 6), bar(60, 252, 500, 5, -6.0)])
    whole, other = sorted(find_strokes(share, ALL), key=lambda stroke: -stroke.length)
    assert whole.length == pytest.approx(600, abs=3)
    first, last = other.middle[np.argsort(other.middle[[0, -1], 0]) * (len(other.middle) - 1)]
    np.testing.assert_allclose(first, [60, 252], atol=1.0)
    # Where 4 cells of bare road are left between both sides, give or take what one stroke takes of the rims.
    assert last[0] == pytest.approx(60 + (252 - 200 - 9.5) / np.tan(np.deg2rad(6.0)), abs=25)
    assert sum(other.is_end) == 1


def test_a_line_that_crosses_or_meets_another_keeps_its_ends():
    share = painted([bar(40, 200, 600, 6), bar(200, 100, 200, 5, 90.0), bar(400, 202, 150, 5, 90.0)])
    found = find_strokes(share, ALL)
    upright = sorted((s for s in found if np.ptp(s.middle[:, 1]) > 50), key=lambda s: s.middle[0, 0])
    assert len(found) == 3 and len(upright) == 2
    np.testing.assert_allclose(np.sort(upright[0].middle[[0, -1], 1]), [100, 300], atol=1.0)
    low, high = np.sort(upright[1].middle[[0, -1], 1])
    assert 194 < low < 206 and high == pytest.approx(352, abs=1.0)


def test_a_curve_is_followed_and_twins_stay_apart():
    x = np.linspace(20, 680, 200)
    y = 150 + 0.0004 * (x - 350) ** 2
    lines = [np.vstack([np.c_[x, y + o - 2.5], np.c_[x, y + o + 2.5][::-1]]) for o in (0.0, 11.0)]
    strokes = find_strokes(painted(lines), ALL)
    assert len(strokes) == 2
    for stroke, offset in zip(sorted(strokes, key=lambda s: s.middle[:, 1].mean()), (0.0, 11.0), strict=True):
        inner = stroke.middle[2:-2]
        off = inner[:, 1] - (150 + offset + 0.0004 * (inner[:, 0] - 350) ** 2)
        assert np.abs(off).max() < 0.6
        assert stroke.length == pytest.approx(668, abs=6)


def test_the_end_of_what_was_seen_is_no_end_of_paint():
    looked = ALL.copy()
    looked[:, 300:] = False
    share = painted([bar(100, 200, 300, 6)])
    share[:, 300:] = 0.0
    (stroke,) = find_strokes(share, looked)
    assert sorted(stroke.is_end) == [False, True]


def test_noise_is_no_stroke():
    assert find_strokes(painted([bar(100, 100, 7, 4)]), ALL, TraceLimits(smallest=48.0)) == []


def test_a_bar_is_a_rectangle_to_a_third_of_a_cell():
    true = bar(150, 150, 120, 20, 12.0)
    (box,) = find_rectangles(painted([true], noise=0.02), ALL, 48.0)
    away = np.linalg.norm(true[:, None] - box[None], axis=2)
    assert away.min(axis=1).max() < 0.8
    assert set(away.argmin(axis=1)) == {0, 1, 2, 3}


def test_worn_paint_moves_no_side_of_a_bar():
    """Two of three looks show it, and a sixth of it is gone: sums of the paint would make it a third shorter."""
    share = 0.66 * painted([bar(150, 200, 110, 12, 20.0)])
    worn = 0.66 * painted([bar(190, 214.6, 18, 6, 20.0)])
    (corners,) = find_rectangles(share - worn, ALL, 20.0)
    along = np.array([np.cos(np.deg2rad(20.0)), np.sin(np.deg2rad(20.0))])
    across = np.array([-along[1], along[0]])
    places = (corners - [150, 200]) @ np.stack([along, across], axis=1)
    np.testing.assert_allclose([places.min(axis=0), places.max(axis=0)], [[0, -6], [110, 6]], atol=0.5)


def test_an_arrow_keeps_its_corners():
    arrow = np.array([[100, 196], [180, 196], [180, 184], [220, 200], [180, 216], [180, 204], [100, 204]], float)
    (rim,) = find_outlines(painted([arrow]), ALL, 48.0)
    away = np.linalg.norm(arrow[:, None] - rim[None], axis=2).min(axis=1)
    assert away.max() < 3.0


def test_a_patch_that_goes_on_unseen_has_no_outline():
    looked = ALL.copy()
    looked[:, 200:] = False
    assert find_rectangles(painted([bar(150, 150, 120, 20)]), looked, 48.0) == []


def test_the_grid_says_what_share_of_the_looks_shows_paint():
    grid = EvidenceGrid(0.5)
    xy = np.array([[0.1, 0.1], [0.1, 0.2], [-200.0, 300.0], [5.0, 5.0]])
    grid.add(xy, np.array([1.0, 3.0, 2.0, 1.0]), np.array([0, -1, 1, 0]), np.array([True, True, True, False]))
    low, size = np.floor(xy.min(axis=0) / 0.5).astype(int) - 3, np.array([450, 650])

    def at(plane, x, y):
        column, row = np.floor(np.array([x, y]) / 0.5).astype(int) - low
        return plane[row, column]

    assert at(grid.share(0, low, size), 0.1, 0.1) == pytest.approx(0.25)
    assert at(grid.share(1, low, size), -200.0, 300.0) == 1.0
    assert at(grid.plane(0, low, size), 5.0, 5.0) == 0.0
    np.testing.assert_array_equal(grid.seen(xy, 1), [True, True, True, False])
    assert not grid.seen(xy, 2).any()


def test_a_map_comes_out_of_the_grid_in_metres():
    """A dash and two pieces of one solid line in map coordinates; the masks tell broken lines from solid ones."""
    grid = EvidenceGrid(CELL_M)
    shapes = [(0, bar(0, 40, 200, 6)), (0, bar(300, 40, 200, 6)), (1, bar(100, 120, 120, 6))]
    ys, xs = np.mgrid[0:200, 0:560]
    cells = np.stack([xs.ravel(), ys.ravel()], axis=1)
    layer = np.full(len(cells), -1)
    for plane, polygon in shapes:
        low, high = polygon.min(axis=0), polygon.max(axis=0)
        layer[((cells >= low) & (cells <= high)).all(axis=1)] = plane
    for _ in range(3):
        grid.add((cells + 0.5) * CELL_M + [-7.0, 3.0], np.ones(len(cells)), layer, np.ones(len(cells), bool))
    layers = [Layer(ElementClass.LANE_MARKING, (0, 1), (1,), says_style=True)]
    found = elements_of(grid, layers, lambda xy: np.full(len(xy), 2.5), VectorConfig())
    assert [(e.id, e.style) for e in found] == [("dash_0", "dashed"), ("line_1", "solid")]
    dash, line = found
    np.testing.assert_allclose(np.sort(dash.points[[0, -1], 0]), [-7 + 2.5, -7 + 5.525], atol=0.03)
    np.testing.assert_allclose(dash.points[:, 1:], np.tile([3.0 + 3.0125, 2.5], (len(dash.points), 1)), atol=0.02)
    assert line.length_m == pytest.approx(12.5, abs=0.1)


def test_a_curb_is_a_line_and_no_dash():
    """Six metres of a curb of 15 cm: masks of the layout show it, and it is called neither broken nor solid."""
    layers, plane_of_id = paint_layers(load_class_table("drive"))
    (layer,) = [layer for layer in layers if layer.label == ElementClass.CURB]
    assert plane_of_id[26] == layer.planes[0]
    grid = EvidenceGrid(CELL_M)
    ys, xs = np.mgrid[0:120, 0:300]
    cells = np.stack([xs.ravel(), ys.ravel()], axis=1)
    is_curb = (cells[:, 0] >= 20) & (cells[:, 0] < 260) & (cells[:, 1] >= 40) & (cells[:, 1] < 46)
    for _ in range(3):
        planes = np.where(is_curb, layer.planes[0], -1)
        grid.add((cells + 0.5) * CELL_M, np.ones(len(cells)), planes, np.ones(len(cells), bool))
    (curb,) = elements_of(grid, layers, lambda xy: np.zeros(len(xy)), VectorConfig())
    assert (curb.id, curb.label, curb.style) == ("curb_0", ElementClass.CURB, "")
    assert curb.length_m == pytest.approx(6.0, abs=0.1)
    assert curb.width_m == pytest.approx(0.15, abs=0.02)
    np.testing.assert_allclose(curb.points[:, 1], 43.0 * CELL_M, atol=0.01)


def gathered(paint, plane, looked):
    """Three looks at cells of a grid that show paint in some of them."""
    grid = EvidenceGrid(CELL_M)
    cells = np.stack(np.meshgrid(np.arange(paint.shape[1]), np.arange(paint.shape[0])), axis=-1).reshape(-1, 2)
    for _ in range(3):
        planes = np.where(paint.ravel(), plane, -1)
        grid.add((cells + 0.5) * CELL_M, np.ones(len(cells)), planes, looked.ravel())
    return grid


def stop_line_layers():
    layers, _ = paint_layers(load_class_table("drive"))
    (layer,) = [layer for layer in layers if layer.label == ElementClass.STOP_LINE]
    return layers, layer.planes[0]


def test_a_stop_line_with_ragged_sides_gaps_and_a_false_patch_is_one_bar():
    """6 m by 0.4 m, worn through twice, with a patch that masks show beside it: no rectangle fits all of it."""
    layers, plane = stop_line_layers()
    x, y = np.meshgrid(np.arange(340), np.arange(160))
    ragged = np.random.default_rng(4).integers(0, 3, 340)[x]
    paint = (x >= 40) & (x < 280) & (y >= 72 + ragged) & (y < 88 - ragged[:, ::-1])
    paint &= ~((x >= 120) & (x < 128)) & ~((x >= 200) & (x < 206))
    paint |= (x >= 230) & (x < 250) & (y >= 84) & (y < 110)
    found = elements_of(gathered(paint, plane, np.ones_like(paint)), layers, lambda xy: np.zeros(len(xy)))
    (line,) = [element for element in found if element.label == ElementClass.STOP_LINE]
    assert line.closed and len(line.points) == 4
    np.testing.assert_allclose(line.points[:, :2].mean(axis=0), [160.0 * CELL_M, 80.0 * CELL_M], atol=0.05)
    np.testing.assert_allclose(np.ptp(line.points[:, :2], axis=0), [6.0, 0.36], atol=0.08)


def test_a_stop_line_that_goes_on_unseen_is_none_yet():
    layers, plane = stop_line_layers()
    x, y = np.meshgrid(np.arange(340), np.arange(160))
    paint, looked = (x >= 40) & (x < 280) & (y >= 72) & (y < 88), x < 200
    found = elements_of(gathered(paint & looked, plane, looked), layers, lambda xy: np.zeros(len(xy)))
    assert not [element for element in found if element.label == ElementClass.STOP_LINE]


def test_the_road_goes_up_and_down_where_the_vehicle_does():
    """On a road z = 0.001 x^2 with a banked second half, heights in the frame of a pose are those of the road."""
    x = np.arange(0.0, 60.0, 1.0)
    Ts = np.tile(np.eye(4), (60, 1, 1))
    Ts[:, 0, 3], Ts[:, 2, 3] = x, 0.001 * x**2
    slope = np.arctan(0.002 * x)
    Ts[:, 0, 0], Ts[:, 0, 2], Ts[:, 2, 0], Ts[:, 2, 2] = np.cos(slope), -np.sin(slope), np.sin(slope), np.cos(slope)
    heights = RoadHeights.of(Ts, 20, 25.0)
    places = np.array([[0.0, 0.0], [10.0, 0.0], [20.0, 3.0]])
    # In the frame of the pose: 0.001 (x - 20)^2 to first order.
    np.testing.assert_allclose(heights.at(places.astype(np.float32)), [0.0, 0.1, 0.4], atol=0.01)


def test_pieces_of_a_solid_line_are_joined_and_its_neighbour_is_not():
    """Three pieces with gaps of 2 m, the middle one followed the other way, and a parallel line 1 m away."""

    def piece(start, end, y):
        middle = np.stack([np.linspace(start, end, 30), np.full(30, float(y))], axis=1)
        return PaintTrace(middle, 6.0, (True, True))

    pieces = [piece(0, 200, 0), piece(480, 280, 0.5), piece(560, 800, 0), piece(0, 800, 40)]
    found = sorted(joined(pieces, CELL_M, 6.0, 0.12), key=lambda line: line.middle[:, 1].mean())
    assert [round(line.length) for line in found] == [800, 800]
    assert (np.diff(found[0].middle[:, 0]) * np.sign(found[0].middle[-1, 0] - found[0].middle[0, 0]) > 0).all()
    assert len(joined(pieces, CELL_M, 1.0, 0.12)) == 4
    assert joined([], CELL_M, 6.0, 0.12) == []


def test_what_leaves_memory_still_counts(tmp_path):
    """Looks in three parts, two of them stored, sum up to those of one grid; another process takes the parts in."""
    rng = np.random.default_rng(3)
    xy = rng.uniform(-100.0, 100.0, (3, 500, 2))
    weight, layer = rng.uniform(0.5, 1.0, (3, 500)), rng.integers(-1, 2, (3, 500))
    whole, parts, again = EvidenceGrid(0.5), EvidenceGrid(0.5), EvidenceGrid(0.5)
    for k in range(3):
        for grid in (whole, parts):
            grid.add(xy[k], weight[k], layer[k], np.ones(500, bool))
        if k < 2:
            parts.store(tmp_path / f"{k}.npz")
            for grid in (parts, again):
                grid.attach(tmp_path / f"{k}.npz")
    again.add(xy[2], weight[2], layer[2], np.ones(500, bool))
    low, size = np.array([-200, -200]), np.array([400, 400])
    np.testing.assert_array_equal(parts.tiles, whole.tiles)
    for plane in range(4):
        expected = whole.plane(plane, low, size)
        assert expected.any()
        np.testing.assert_allclose(parts.plane(plane, low, size), expected, rtol=1e-6)
        np.testing.assert_array_equal(again.plane(plane, low, size), parts.plane(plane, low, size))
    np.testing.assert_array_equal(parts.seen(xy[0], 1), whole.seen(xy[0], 1))


def test_a_line_that_was_cut_is_one_line_again():
    """A solid line across three blocks, cut at both borders: its pieces meet, and only true ends are ends."""
    x = np.arange(-900.0, 3001.0, 4.0)
    line = PaintTrace(np.stack([x, 100.0 + 1e-5 * (x - 500) ** 2], axis=1), 6.0, (True, True))
    borders = np.array([-1024.0, 0.0, 1024.0, 4096.0])
    cells = [(np.array([a, -50.0]), np.array([b, 2000.0])) for a, b in pairwise(borders)]
    pieces = [piece for low, high in cells for piece in cut_to(line, low, high)]
    assert [piece.is_end for piece in pieces] == [(True, False), (False, False), (False, True)]
    (whole,) = joined(pieces, CELL_M, 0.3, 0.3)
    assert whole.is_end == (True, True)
    assert whole.length == pytest.approx(line.length, abs=1.0)
    assert cut_to(line, np.array([0.0, 500.0]), np.array([100.0, 600.0])) == []


def test_the_map_does_not_depend_on_where_blocks_end():
    """A dash whose middle lies on the border of two blocks and a line across it appear once, wherever they lie."""
    ys, xs = np.mgrid[0:160, 0:560]
    cells = np.stack([xs.ravel(), ys.ravel()], axis=1)
    layer = np.full(len(cells), -1)
    for plane, polygon in [(0, bar(180, 40, 200, 6)), (1, bar(20, 120, 520, 6))]:
        low, high = polygon.min(axis=0), polygon.max(axis=0)
        layer[((cells >= low) & (cells <= high)).all(axis=1)] = plane
    found = []
    for shift in (np.array([-280, -80]), np.array([600, 600])):
        grid = EvidenceGrid(CELL_M)
        for _ in range(3):
            grid.add((cells + shift + 0.5) * CELL_M, np.ones(len(cells)), layer, np.ones(len(cells), bool))
        layers = [Layer(ElementClass.LANE_MARKING, (0, 1), (0,), says_style=True)]
        elements = elements_of(grid, layers, lambda xy: np.zeros(len(xy)))
        assert [e.style for e in elements] == ["dashed", "solid"]
        found.append([np.sort(e.points[[0, -1], :2] - shift * CELL_M, axis=0) for e in elements])
    np.testing.assert_allclose(found[0], found[1], atol=0.01)


def test_a_line_that_leaves_the_window_of_a_block_is_whole():
    """A solid line along a whole block and past its margin, as masks that tell broken lines show it."""
    ys, xs = np.mgrid[0:24, -400:2800]
    cells = np.stack([xs.ravel(), ys.ravel()], axis=1)
    layer = np.where((cells[:, 1] >= 9) & (cells[:, 1] < 15), 0, -1)
    grid = EvidenceGrid(CELL_M)
    for _ in range(3):
        grid.add((cells + 0.5) * CELL_M, np.ones(len(cells)), layer, np.ones(len(cells), bool))
    layers = [Layer(ElementClass.LANE_MARKING, (0, 1), (1,), says_style=True)]
    (line,) = elements_of(grid, layers, lambda xy: np.zeros(len(xy)))
    assert line.length_m == pytest.approx(80.0, abs=0.3)
    np.testing.assert_allclose(line.points[:, 1], 12 * CELL_M, atol=0.01)


def test_a_dash_has_its_ends_though_every_look_misses_cells():
    """Places of a look are not in line with cells: three looks miss a fourth of them each, the last one two thirds."""
    grid, (ys, xs) = EvidenceGrid(CELL_M), np.mgrid[0:80, 0:300]
    cells = np.stack([xs.ravel(), ys.ravel()], axis=1)
    is_paint = (np.abs(cells[:, 0] - 150) <= 60) & (np.abs(cells[:, 1] - 40) <= 3)
    for look in range(4):
        hit = cells[(cells[:, 0] + 2 * cells[:, 1] + look) % 4 != 0] if look < 3 else cells[cells.sum(axis=1) % 3 == 0]
        paint = is_paint[hit[:, 1] * 300 + hit[:, 0]]
        grid.add((hit + 0.5) * CELL_M, np.ones(len(hit)), paint.astype(int) - 1, np.ones(len(hit), bool))
    layers = [Layer(ElementClass.LANE_MARKING, (0, 1), (0,), says_style=True)]
    (dash,) = elements_of(grid, layers, lambda xy: np.zeros(len(xy)), VectorConfig())
    assert dash.style == "dashed" and dash.true_ends == (True, True)
    assert dash.length_m == pytest.approx(121 * CELL_M, abs=0.05)
