"""The lesson for marking points: what is drawn, what is asked, what is told of it; the whole verb on a tiny lesson."""

import csv
import json

import jax.numpy as jnp
import numpy as np
import pytest

from semloc_jax.cli.main import main
from semloc_jax.learning.marking_drives import on_paint
from semloc_jax.learning.marking_lesson import SlotLearningConfig, shown, threshold_of
from semloc_jax.learning.marking_points import (
    NOTHING,
    PointScore,
    TopViewPool,
    batch_of,
    marking_loss,
    moved,
    score,
)
from semloc_jax.perception.networks.marking_net import (
    METRES_PER_PX,
    SHIPPED,
    MarkingNet,
    MarkingPoints,
    decoded,
    levelled_view,
)
from semloc_jax.perception.networks.weights import read_card
from semloc_jax.reports.marking_points import _lessons
from semloc_jax.simulation.top_views.drawn_out import own_car, wedge
from semloc_jax.simulation.top_views.picture import _asked, top_view_sample
from semloc_jax.simulation.top_views.slot_layout import DividerBack, MarkingPoint, random_layout

SIZE_PX = 128


@pytest.fixture(scope="module")
def samples():
    return TopViewPool(12, SIZE_PX, seed=5).samples


def perfect(batch):
    """What a network would say that knows everything, [b i j 6]."""
    logit = np.where(batch.heat == 1.0, 12.0, -12.0)
    told = np.asarray(batch.told).copy()
    told[..., 4] = np.where(told[..., 4] > 0.5, 12.0, -12.0)
    return np.concatenate([logit[..., None], told], axis=-1)


def test_what_is_told_of_cells_gives_the_points_back(samples):
    """In all eight positions: cells, offsets and directions turn with the picture."""
    num = 0
    for sample in samples:
        for quarters in range(4):
            turned = moved(sample, quarters, quarters % 2 == 1)
            found = decoded(perfect(batch_of([turned]))[0], 0.5)
            truth = shown(turned)
            own = score(found, truth.uv_m, truth.yaw_rad, METRES_PER_PX, truth.unasked)
            assert own.num_right == own.num_found == len(found.uv)
            # Two points of one cell or nearer than dividers are cannot be told apart.
            assert own.num_right >= own.num_true - 2
            assert not own.off_m or (max(own.off_m) < 1e-3 and max(own.off_rad) < 1e-3)
            num += own.num_right
    assert num > 40


def test_a_network_that_is_as_sure_as_it_can_be_says_zero_and_one():
    """Far from any paint a logit may be below -700, where a float has no exponential any more."""
    said = np.full((4, 4, 6), -2000.0, np.float32)
    said[1, 2] = [2000.0, 0.0, 0.0, 1.0, 0.0, -5.0]
    found = decoded(said, 0.0)
    assert found.confidence.max() == 1.0 and (found.above(0.5).confidence == 1.0).all()
    assert len(decoded(said, 0.5).uv) == 1


def test_turned_pictures_show_the_same_under_their_points(samples):
    for sample in samples:
        for quarters, is_mirrored in ((1, False), (2, True), (3, True)):
            turned = moved(sample, quarters, is_mirrored)
            for one, other in zip(sample.points, turned.points, strict=True):
                a, b = (np.floor(p.uv_m / METRES_PER_PX).astype(int) for p in (one, other))
                np.testing.assert_array_equal(sample.picture[a[1], a[0]], turned.picture[b[1], b[0]])


@pytest.mark.parametrize("is_told", [True, False])
def test_the_back_of_a_divider_is_asked_for_where_its_mouth_tells_it(is_told):
    """Where paint differs and the mouth is in view, the network has to say that the back is none."""
    mouth, back = np.array([2.0, 1.0]), np.array([2.0, 5.0])
    alpha, picture = np.ones((256, 256), np.float32), np.zeros((128, 128, 3), np.uint8)
    backs = [DividerBack(back, mouth if is_told else None)]
    point = MarkingPoint(mouth, 0.5 * np.pi, False)
    for points, is_shown in (([point], True), ([], False)):
        sample = _asked(picture, points, backs, np.zeros((256, 256), np.uint8), alpha, 6.4, 40.0)
        u, v = np.rint(back / METRES_PER_PX).astype(int)
        assert sample.unasked[v, u] == (not (is_told and is_shown))


def test_both_ends_of_a_divider_are_alike_only_where_the_same_paint_crosses_them():
    """Of 200 rows; a line runs across the backs of some, the entrance of boxes is one, too."""
    seen = set()
    for seed in range(200):
        layout = random_layout(np.random.default_rng(seed), 6.4)
        seen |= {back.mouth_m is None for back in layout.backs}
        for back in layout.backs:
            if back.mouth_m is not None:
                assert 1.8 < np.linalg.norm(back.uv_m - back.mouth_m) < 10.0
    assert seen == {True, False}


def test_points_lie_on_paint_and_point_into_slots():
    for seed in range(20):
        layout = random_layout(np.random.default_rng(seed), 6.4)
        for point in layout.points:
            into = np.array([np.cos(point.yaw_rad), np.sin(point.yaw_rad)])
            assert any(_inside(quad, point.uv_m) for quad in layout.quads)
            depths = [np.linalg.norm(slot[2:] - point.uv_m, axis=1).min() for slot in layout.slots]
            slot = layout.slots[
                int(np.argmin([np.linalg.norm(s[:2] - point.uv_m, axis=1).min() for s in layout.slots]))
            ]
            assert (slot.mean(axis=0) - slot[:2].mean(axis=0)) @ into > 0.8
            assert min(depths) > 1.5


def test_what_stands_up_is_drawn_out_away_from_a_camera():
    for seed in range(20):
        rng = np.random.default_rng(seed)
        car = own_car(rng, 9.6)
        a, b, c, d = wedge(rng, car, 9.6, 0.2, 2.0)
        foot, end = 0.5 * (a + b), 0.5 * (c + d)
        cameras = car.middle_m + 0.5 * np.array([[1, 0], [-1, 0], [0, 1], [0, -1]]) * car.size_m
        camera = cameras[np.linalg.norm(cameras - foot, axis=1).argmin()]
        sight = (foot - camera) / np.linalg.norm(foot - camera)
        assert (end - foot) @ sight > 2.0 - 1e-9  # m: along the line of sight
        assert np.linalg.norm(c - d) > np.linalg.norm(a - b)


def test_marking_points_are_the_middles_of_paint_where_a_map_has_its_edge():
    mouths, inward = np.array([[0.0, 3.1], [2.5, 3.1], [5.0, 3.1]]), np.tile([0.0, 1.0], (3, 1))
    bar, divider = np.array([[-0.7, 3.16], [0.7, 3.16]]), np.array([[2.5, 3.1], [2.5, 8.3]])
    moved_to = on_paint(mouths, inward, [bar, divider])
    np.testing.assert_allclose(moved_to, [[0.0, 3.16], [2.5, 3.1], [5.0, 3.1]])  # dividers alone end where they end


def _inside(quad, place):
    sides, offset = np.roll(quad, -1, axis=0) - quad, place - quad
    turn = sides[:, 0] * offset[:, 1] - sides[:, 1] * offset[:, 0]
    return (turn > -1e-9).all() or (turn < 1e-9).all()


def test_a_sample_is_drawn_by_its_seed_alone():
    one, again = (top_view_sample(np.random.default_rng((3, 4)), 64, METRES_PER_PX) for _ in range(2))
    np.testing.assert_array_equal(one.picture, again.picture)
    assert one.picture.shape == (64, 64, 3) and one.unasked.shape == (64, 64)


def test_the_loss_is_least_where_everything_is_right(samples):
    batch = batch_of(samples[:4])
    best = perfect(batch)

    def loss(said):
        return float(marking_loss(lambda picture: picture, batch._replace(picture=jnp.asarray(said))))

    assert loss(best) < 0.01
    for column, by in ((0, -24.0 * (batch.heat == 1.0)), (1, 0.3), (3, 1.0), (0, 24.0 * (batch.heat < 0.1))):
        worse = best.copy()
        worse[..., column] += by
        assert loss(worse) > loss(best) + 0.05
    # Nothing is asked where nothing may be told.
    hidden = best.copy()
    hidden[..., 0] = np.where(batch.asked == 0.0, 12.0, hidden[..., 0])
    assert loss(hidden) == pytest.approx(loss(best), abs=1e-6)


def test_the_ground_drops_out_of_a_levelled_picture():
    sample = top_view_sample(np.random.default_rng(7), 64, METRES_PER_PX)
    dark = np.round(sample.picture * 0.5).astype(np.uint8)
    assert np.abs(levelled_view(sample.picture) - levelled_view(dark)).mean() < 0.1
    assert np.abs(levelled_view(np.full((64, 64, 3), 90, np.uint8))).max() < 1e-3


def test_scores_count_misses_inventions_and_wrong_directions():
    found = MarkingPoints(
        np.array([[20.0, 20.0], [60.0, 60.0], [90.0, 90.0]]), np.array([0.0, 0.0, 0.0]), np.zeros(3, bool), np.ones(3)
    )
    truth = (np.array([[20.5, 20.5], [60.5, 60.5], [40.0, 100.0]]) + 1.0) * METRES_PER_PX
    own = score(found, truth, np.array([0.1, np.pi, 0.0]), METRES_PER_PX, np.zeros((128, 128), bool))
    assert (own.num_true, own.num_found, own.num_right) == (3, 3, 1)
    assert own.off_m[0] == pytest.approx(0.0707, abs=1e-3) and own.off_rad[0] == pytest.approx(0.1)
    open_there = np.zeros((128, 128), bool)
    open_there[80:100, 80:100] = True
    assert score(found, truth, np.array([0.1, np.pi, 0.0]), METRES_PER_PX, open_there).num_found == 2
    good, bad = PointScore(10, 8, 8, (), ()), PointScore(10, 20, 9, (), ())
    assert threshold_of({0.2: bad, 0.5: good, 0.7: good}, 0.85) == 0.5
    assert threshold_of({0.2: NOTHING, 0.5: bad}, 0.85) == 0.5


@pytest.mark.usefixtures("single_precision")
def test_a_tiny_lesson_writes_everything(tmp_path, capsys):
    words = ["--num-pictures", "4", "--size-px", "64", "--batch", "2", "--num-judged", "3", "--judged-px", "64"]
    words += ["--training.num-steps", "3", "--out", str(tmp_path)]
    assert main(["learn", "slots", *words]) == 0
    assert "186678 parameters" in capsys.readouterr().out
    assert {"slots.weights", "slots.onnx", "scores.csv", "loss.csv", "random.png"} <= {
        p.name for p in tmp_path.iterdir()
    }
    keys = {m["key"] for m in json.loads((tmp_path / "metrics.json").read_text())["metrics"]}
    assert {"random.recall", "random.precision", "random.points"} <= keys
    assert len(list(csv.DictReader((tmp_path / "scores.csv").open()))) == 11
    # A picture at another scale gives its own pixels back.
    net = MarkingNet.load(tmp_path / "slots.weights")
    found = net(np.zeros((150, 200, 3), np.uint8), 0.02, threshold=0.0)
    assert len(found.uv) and (found.uv < [200.0, 150.0]).all()
    # A lesson that goes on begins where that one ended, its card has both; cards of one lesson had its values apart.
    again = [*words[:-1], str(tmp_path / "again"), "--training.rate", "1e-9", "--training.seed", "1"]
    assert main(["learn", "slots", "--begin-with", str(tmp_path / "slots.weights"), *again]) == 0
    later = tmp_path / "again" / "slots.weights"
    np.testing.assert_allclose(MarkingNet.load(later).network.head.bias, net.network.head.bias, atol=1e-6)
    assert [lesson["seed"] for lesson in read_card(later)["lessons"]] == [0, 1]
    assert _lessons({"steps": 10000, "batch": 16, "seed": 0}) == [{"steps": 10000, "batch": 16, "seed": 0}]
    assert [lesson["steps"] for lesson in _lessons(read_card(SHIPPED))] == [10000, 5000, 7000, 7000]
    capsys.readouterr()
    assert main(["learn", "slots", "--size-px", "60"]) == 1
    assert "multiples of" in capsys.readouterr().err


def test_a_lesson_without_sense_is_refused():
    with pytest.raises(ValueError, match="multiples of"):
        SlotLearningConfig(judged_px=100)
