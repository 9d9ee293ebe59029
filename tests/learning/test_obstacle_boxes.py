"""The lesson for obstacles: what is drawn, what is asked, what is told of it; the whole verb on a tiny lesson."""

import csv
import json

import cv2
import jax.numpy as jnp
import numpy as np
import pytest

from semloc_jax.cli.main import main
from semloc_jax.learning.obstacle_boxes import (
    LOW_M,
    CylinderPool,
    batch_of,
    cut,
    is_asked,
    look_geometry,
    obstacle_loss,
)
from semloc_jax.learning.obstacle_lesson import ObstacleLearningConfig, shown
from semloc_jax.perception.networks.obstacle_net import (
    FAR,
    HORIZON_V,
    KINDS,
    NEAR,
    PX_PER_RAD,
    SIZE_PX,
    ObstacleNet,
    decoded,
)
from semloc_jax.simulation.cylinder_views.bodies import Bar, Body, Sheet, box, rectangle
from semloc_jax.simulation.cylinder_views.canvas import Canvas
from semloc_jax.simulation.cylinder_views.cars import car
from semloc_jax.simulation.cylinder_views.kept_free import obstacle
from semloc_jax.simulation.cylinder_views.picture import Geometry, cylinder_sample
from semloc_jax.simulation.cylinder_views.placing import _beside, placed

WIDTH = 192


@pytest.fixture(scope="module")
def samples():
    """Five of each look."""
    return [sample for look in (NEAR, FAR) for sample in CylinderPool(look, 5, WIDTH, seed=5).samples]


def perfect(batch):
    """What a network would say that knows everything, [b i j 11]."""
    told = np.asarray(batch.told).copy()
    told[..., 6] = np.where(told[..., 6] > 0.5, 12.0, -12.0)
    return np.concatenate([np.where(batch.heat == 1.0, 12.0, -12.0), told], axis=-1)


def canvas(height_m=1.0, width=400):
    picture = np.zeros((SIZE_PX[1], width, 3), np.float32)
    return Canvas(PX_PER_RAD, (0.5 * (width - 1), HORIZON_V), height_m, np.array([0.0, 0.0, 1.0]), 0.5, picture)


def test_a_box_is_painted_where_its_corners_are_projected():
    """Against the outline of its eight corners, worked out here: u = f atan2(x, y), v = f (h - z) / range."""
    view, middle, size = canvas(), np.array([0.7, 3.0]), (0.4, 0.6)
    part = box(middle, size, 0.4, 0.0, 0.9, np.ones(3))
    Body(middle, middle + rectangle(size, 0.4), 0.9, parts=[part]).paint(view, 7)
    v, u = np.nonzero(view.ids == 7)
    x, y, z = np.concatenate([part.low, part.high]).T
    across = 199.5 + PX_PER_RAD * np.arctan2(x, y)
    down = HORIZON_V + PX_PER_RAD * (1.0 - z) / np.hypot(x, y)
    painted = np.array([u.min(), v.min(), u.max(), v.max()])
    np.testing.assert_allclose(painted, [across.min(), down.min(), across.max(), down.max()], atol=1.0)
    hull = cv2.contourArea(cv2.convexHull(np.column_stack([across, down]).astype(np.float32)))
    assert len(u) == pytest.approx(hull, rel=0.05)  # no side is missing


@pytest.mark.parametrize("kind", KINDS)
def test_things_stand_on_their_footprint(kind):
    for seed in range(12):
        rng, view, middle = np.random.default_rng(seed), canvas(), np.array([0.3, 2.5])
        body = obstacle(rng, kind, middle)
        body.paint(view, 1)
        v, _ = np.nonzero(view.ids == 1)
        foot = view.pixels(np.column_stack([body.footprint, np.zeros(len(body.footprint))]))
        assert abs(v.max() - foot[:, 1].max()) < 6.0  # px: the lowest that is painted is the nearest corner
        top = view.pixels(np.append(middle, body.height_m)[None])[0, 1]
        assert v.min() < max(top, 0.0) + 12.0 and body.kind == kind
        assert np.abs(body.footprint.mean(axis=0) - middle).max() < 0.05


def test_what_is_told_of_cells_gives_boxes_and_feet_back(samples):
    num = 0
    for k, sample in enumerate(samples):
        own = cut(np.random.default_rng(k), sample, (128, 128))
        found, asked = decoded(perfect(batch_of([own]))[0], 0.5), [t for t in own.things if is_asked(t, own.enlarged)]
        assert len(found.box) <= len(asked)
        for kind, found_box, foot, has_foot in zip(found.kind, found.box, found.foot_uv, found.has_foot, strict=True):
            off = [np.abs(thing.box - found_box).max() for thing in asked]
            thing = asked[int(np.argmin(off))]
            assert min(off) < 1e-3 and KINDS[kind] == thing.kind and has_foot == thing.has_foot
            if np.abs(thing.foot_uv - thing.box[2:]).max() < 60.0:
                np.testing.assert_allclose(foot, thing.foot_uv, atol=1e-2)
            num += 1
    assert num > 8


def test_a_mirrored_window_shows_the_same_in_its_boxes(samples):
    for k, sample in enumerate(samples):
        one, seen = cut(np.random.default_rng(k), sample, (WIDTH, len(sample.picture))), sample.picture
        is_mirrored = not np.array_equal(one.picture, seen)
        # What is narrower than a pixel is dropped.
        whole = [thing for thing in sample.things if (thing.box[2:] - thing.box[:2]).min() >= 1.0]
        for before, after in zip(whole, one.things, strict=True):
            a, b = (
                np.concatenate([np.floor(thing.box[:2] + 0.5), np.ceil(thing.box[2:] + 0.5)]).astype(int)
                for thing in (before, after)
            )
            patch = one.picture[b[1] : b[3], b[0] : b[2]]
            np.testing.assert_array_equal(patch[:, ::-1] if is_mirrored else patch, seen[a[1] : a[3], a[0] : a[2]])


def test_a_sample_is_drawn_by_its_seed_alone():
    geometry = Geometry(PX_PER_RAD, 64, SIZE_PX[1], HORIZON_V)
    one, again = (cylinder_sample(np.random.default_rng((3, 4)), geometry) for _ in range(2))
    np.testing.assert_array_equal(one.picture, again.picture)
    assert one.picture.shape == (SIZE_PX[1], 64, 3)


def test_the_loss_is_least_where_everything_is_right(samples):
    batch = batch_of(samples[:5])
    best = perfect(batch)

    def loss(said):
        return float(obstacle_loss(lambda picture: picture, batch._replace(picture=jnp.asarray(said))))

    assert (batch.heat == 1.0).sum() > 3 and loss(best) < 0.01
    hidden = batch.asked[..., None] * (batch.heat.max(axis=-1, keepdims=True) < 0.1)
    for column, by in ((slice(4), -24.0 * (batch.heat == 1.0)), (4, 2.0), (6, 0.5), (slice(4), 24.0 * hidden)):
        worse = best.copy()
        worse[..., column] += by
        assert loss(worse) > loss(best) + 0.02
    # Nothing is asked where nothing may be told.
    unasked = best.copy()
    unasked[..., :4] = np.where(batch.asked[..., None] == 0.0, 12.0, unasked[..., :4])
    assert loss(unasked) == pytest.approx(loss(best), abs=1e-6)


def test_far_things_are_as_common_as_near_ones_and_most_have_a_neighbour():
    """By the logarithm of the range alone one in four is beyond 6 m."""
    scenes = [placed(np.random.default_rng((9, k)), 0.6, None)[0] for k in range(60)]
    things = [(body, [b for b in bodies if b is not body]) for bodies in scenes for body in bodies if body.kind]
    range_m = np.array([np.linalg.norm(body.middle) for body, _ in things])
    assert len(things) > 300 and 0.35 < (range_m > 6.0).mean() < 0.55
    free_m = [min(np.linalg.norm(b.footprint - body.middle, axis=1).min() for b in others) for body, others in things]
    assert np.median(free_m) < 0.8


def test_a_third_of_the_locks_lie_flat_and_most_of_these_are_bare_slabs():
    """What is lowered has no arm; a bare one is its foot alone."""
    locks = [obstacle(np.random.default_rng((2, k)), "ground_lock", np.array([0.0, 3.0])) for k in range(300)]
    flat = [body for body in locks if not any(isinstance(part, Bar) for part in body.parts)]
    assert 0.28 < len(flat) / len(locks) < 0.42 and all(body.height_m < 0.2 for body in flat)
    assert 0.6 < np.mean([len(body.parts) == 1 for body in flat]) < 0.9


def test_boards_are_written_on_or_not_and_some_are_one_piece():
    """Colour of the inside and writing of two boards that lean against each other."""
    bodies = [obstacle(np.random.default_rng((2, k)), "no_parking_sign", np.array([0.0, 3.0])) for k in range(300)]
    boards = [[part for part in body.parts if isinstance(part, Sheet)] for body in bodies]
    frames = [two for two in boards if len(two) == 2]
    assert 0.5 < len(frames) / len(bodies) < 0.7
    assert 0.3 < np.mean([not near.patches for _, near in frames]) < 0.5
    assert 0.4 < np.mean([np.array_equal(far.colour, near.colour) for far, near in frames]) < 0.6


def test_of_what_stands_beside_something_much_hides_a_part_of_it():
    """Within 20 deg of the way from it to the camera: one in nine by chance."""
    body = obstacle(np.random.default_rng(1), "no_parking_sign", np.array([1.0, 4.0]))
    places = np.array([_beside(np.random.default_rng((4, k)), body) for k in range(300)]) - body.middle
    towards = -body.middle / np.linalg.norm(body.middle)
    cosine = places @ towards / np.linalg.norm(places, axis=1)
    assert 0.25 < (cosine > np.cos(np.deg2rad(20.0))).mean() < 0.5


@pytest.mark.parametrize("look", [NEAR, FAR])
def test_in_lessons_what_is_low_stands_where_the_look_tells_it(look):
    """Pillars stand at any range."""
    bodies = [b for k in range(60) for b in placed(np.random.default_rng((9, k)), 0.6, 3.0, LOW_M[look])[0]]
    range_m = {kind: [np.linalg.norm(b.middle) for b in bodies if b.kind == kind] for kind in KINDS}
    low, (first, last) = np.concatenate([own for kind, own in range_m.items() if kind != "pillar"]), LOW_M[look]
    # Some stand beside others, or beside cars, that are farther off.
    assert len(low) > 200 and ((low < first) | (low > last)).mean() < 0.2 and max(range_m["pillar"]) > 11.0


@pytest.mark.parametrize("look", [NEAR, FAR])
def test_random_views_show_things_as_a_look_shows_those_of_a_picture(look):
    """A place of the road, 4 m away and 0.2 rad aside: where it is painted, and where the look has its pixel."""
    place, height_m, geometry = 4.0 * np.array([np.sin(0.2), np.cos(0.2)]), 1.0, look_geometry(look, WIDTH)
    centre = (0.5 * geometry.width - 0.5, geometry.centre_v)
    view = Canvas(geometry.focal_px, centre, height_m, np.array([0.0, 0.0, 1.0]), 0.5, np.zeros((8, 8, 3), np.float32))
    painted = view.pixels(np.append(place, 0.0)[None])[0]
    in_picture = np.array([PX_PER_RAD * 0.2, HORIZON_V + PX_PER_RAD * height_m / 4.0])
    assert painted[0] - centre[0] == pytest.approx(look.scale * in_picture[0])
    assert painted[1] == pytest.approx(look.scale * (in_picture[1] - look.rows[0] + 0.5) - 0.5)
    assert geometry.height == look.height and geometry.enlarged == look.scale


def test_lamps_of_some_cars_reach_around_their_corners():
    """Of four sides, the long ones show their skirt, and the lamps of those that do have their brightness."""
    around = covered = 0
    for seed in range(40):
        hull = car(np.random.default_rng(seed), np.zeros(2), 0.0).parts[0]
        right, front, left, back = hull.patches
        if not front:  # under a cover
            covered += 1
            continue
        assert len(front) == len(back) == 4 and len(right) == len(left)
        if len(right) == 3:
            around += 1
            # The first corner of the right side is at the back, that of the left side at the front.
            np.testing.assert_array_equal(right[1].colour, back[1].colour)
            np.testing.assert_array_equal(left[1].colour, front[1].colour)
    assert 8 < around < 26 and 2 < covered < 16


def test_a_random_view_is_judged_like_a_drive(samples):
    for sample in samples:
        one = shown(sample)
        assert len(one.kinds) == len(one.box) == len(one.range_m) == len(one.is_asked)
        assert (one.box[:, 2:] > one.box[:, :2]).all() and (one.range_m[one.is_asked] <= 10.0).all()


@pytest.mark.usefixtures("single_precision")
@pytest.mark.slow
def test_a_tiny_lesson_writes_everything(tmp_path, capsys):
    words = ["--num-pictures", "3", "--width-px", "96", "--window-px", "64", "--batch", "2", "--num-judged", "2"]
    words += ["--training.num-steps", "2", "--out", str(tmp_path)]
    assert main(["learn", "obstacles", *words]) == 0
    assert "parameters, threshold" in capsys.readouterr().out
    written = {place.name for place in tmp_path.iterdir()}
    assert {"obstacles.weights", "obstacles.onnx", "scores.csv", "loss.csv", "random.png"} <= written
    keys = {m["key"] for m in json.loads((tmp_path / "metrics.json").read_text())["metrics"]}
    assert "random.ap50" in keys
    rows = list(csv.DictReader((tmp_path / "scores.csv").open()))
    assert {row["class"] for row in rows} == set(KINDS) and len(rows) == 16
    net = ObstacleNet.load(tmp_path / "obstacles.weights")
    found = net(np.zeros((SIZE_PX[1], 96, 3), np.uint8), threshold=0.0)
    assert len(found.box) and (found.box[:, 2:] > found.box[:, :2]).all()
    assert main(["learn", "obstacles", "--window-px", "60"]) == 1
    assert "multiple of" in capsys.readouterr().err


def test_a_lesson_without_sense_is_refused():
    with pytest.raises(ValueError, match="at most width_px"):
        ObstacleLearningConfig(window_px=512)
    with pytest.raises(ValueError, match="far_share"):
        ObstacleLearningConfig(far_share=1.0)
