"""A map takes a drive in: what is missed fades, what is seen stays, what is new comes, two views of one are one."""

import csv
import json
from dataclasses import replace

import numpy as np
import pytest

from semloc_jax.cli.main import OK, main
from semloc_jax.errors import SemlocError
from semloc_jax.evaluation import read_metrics
from semloc_jax.geometry import rigid
from semloc_jax.mapping.base_map import BaseConfig, Countable, aged_logit, taken_in
from semloc_jax.mapping.base_places import find_places, places_of, write_places
from semloc_jax.mapping.chain_graph import Start, solve_chain
from semloc_jax.mapping.existence import ExistenceConfig, existence_logit, raised
from semloc_jax.mapping.found_loops import FoundLoop
from semloc_jax.mapping.loops import LoopConfig
from semloc_jax.mapping.revisits import RevisitConfig
from semloc_jax.maps import Belief, BeliefMap, MapElement, SemanticMap
from semloc_jax.perception import load_class_table
from semloc_jax.reports.map_judgement import base_metrics
from semloc_jax.reports.mapping import write_changes
from tests.mapping.test_chain_graph import made_chain


def pole(name, x, y):
    return MapElement(name, "pole", np.array([[x, y, 0.0], [x, y, 3.0]]), radius_m=0.05)


def dash(name, x, y=0.0, length=3.0):
    points = np.array([[x, y, 0.0], [x + length, y, 0.0]])
    return MapElement(name, "lane_marking", points, width_m=0.15, style="dashed")


def line(name, x, end, y=5.0):
    points = np.stack([np.arange(x, end + 0.5), np.full(round(end - x) + 1, y), np.zeros(round(end - x) + 1)], axis=1)
    return MapElement(name, "lane_marking", points, width_m=0.15, style="solid")


def belief(logit=4.0, sigma=0.1, seen=5, missed=0, who="first"):
    return Belief(sigma, sigma, logit, seen, missed, 1.0, 2.0, who)


def base_of(*elements):
    return BeliefMap(SemanticMap(elements, None, "base"), {e.id: belief() for e in elements})


def test_no_map_is_surer_than_time_allows():
    assert aged_logit(30.0, 0.98) == pytest.approx(np.log(0.98 / 0.02))
    assert aged_logit(0.0, 0.98) == pytest.approx(np.log(0.49 / 0.51))
    aged = [aged_logit(logit, 0.9) for logit in (-3.0, 0.0, 3.0, 10.0)]
    assert aged == sorted(aged)
    assert all(a < b for a, b in zip(aged, (-3.0, 0.0, 3.0, 10.0), strict=True))


def test_a_map_that_somebody_made_gives_an_element_up_after_a_few_visible_misses():
    """mapping.md: detected with 0.9, gone after four visible misses; with 0.7 after six."""
    config = ExistenceConfig()
    for rate, most in ((0.9, 4), (0.7, 6)):
        prior = aged_logit(6.0, 0.98)
        gone = [raised(existence_logit(0, n, rate, 0.02, config), prior, config) < 0.0 for n in range(9)]
        assert 2 <= gone.index(True) <= most
        assert not raised(existence_logit(5, 1, rate, 0.02, config), prior, config) < 0.0


def test_what_a_drive_says_of_a_map():
    base = base_of(pole("kept", 0, 0), pole("gone", 20, 0), pole("unseen", 90, 0), dash("dash", 5))
    told = {"kept": belief(7.0, seen=6), "gone": belief(-3.0, seen=0, missed=5), "dash": belief(6.0, seen=4, missed=1)}
    made = [
        (pole("pole_0", 0.2, 0.0), belief(5.0, 0.1, who="second")),
        (pole("kept", 40.0, 3.0), belief(5.0, 0.05, who="second")),
        (dash("dash_0", 5.1), belief(5.0, 0.1, who="second")),
        (dash("dash_1", 5.1, 3.5), belief(5.0, 0.1, who="second")),
    ]
    joined, changes = taken_in(base, told, made)
    names = [e.id for e in joined.map.elements]
    assert sorted((c.change, c.id) for c in changes) == [("added", "dash_1"), ("added", "kept_2"), ("removed", "gone")]
    assert set(names) == {"kept", "unseen", "dash", "dash_1", "kept_2"}
    by_id = {e.id: e for e in joined.map.elements}
    # Both know the pole equally well: it stands in the middle, and is known better than by either.
    assert by_id["kept"].points[0, 0] == pytest.approx(0.1)
    assert joined.beliefs["kept"].sigma_across_m == pytest.approx(0.1 / np.sqrt(2.0))
    assert by_id["dash"].points[0, 0] == pytest.approx(5.05)
    assert (joined.beliefs["kept"].num_seen, joined.beliefs["kept"].existence_logit) == (11, 7.0)
    assert joined.beliefs["dash"].num_missed == 1
    assert joined.beliefs["unseen"].existence_logit == pytest.approx(aged_logit(4.0, BaseConfig().survival))
    assert joined.beliefs["unseen"].num_seen == 5


def test_a_bar_a_metre_away_was_moved_and_its_neighbours_stay():
    """Bars 1 m apart, each moved 1.1 m along itself: each is its own, and none is there twice."""
    bars = [dash(f"bar_{k}", 0.0, float(k)) for k in range(5)]
    told = {bar.id: belief(5.0) for bar in bars}
    joined, changes = taken_in(base_of(*bars), told, [(dash(f"dash_{k}", 1.1, float(k)), belief()) for k in range(5)])
    assert sorted((c.change, c.id) for c in changes) == [("moved", f"bar_{k}") for k in range(5)]
    assert [round(float(e.points[0, 0]), 3) for e in joined.map.elements] == [1.1] * 5
    # What the drive did not look at cannot have been seen to move.
    _, changes = taken_in(base_of(*bars), {}, [(dash("dash_0", 1.1, 0.0), belief())])
    assert [c.change for c in changes] == ["added"]


def test_what_a_drive_brings_is_off_by_what_the_map_around_it_is_off():
    base = base_of(pole("here", 0, 0), pole("far", 200, 0))
    sigmas = {"here": (0.03, 0.001), "far": (0.08, 0.004)}
    beliefs = {k: replace(b, sigma_place_m=sigmas[k][0], sigma_turn_rad=sigmas[k][1]) for k, b in base.beliefs.items()}
    joined, _ = taken_in(replace(base, beliefs=beliefs), {}, [(pole("new", 3, 0), belief())])
    told = {k: (b.sigma_place_m, b.sigma_turn_rad) for k, b in joined.beliefs.items()}
    assert told == {**sigmas, "new": pytest.approx((np.hypot(0.03, 0.08) / 2**0.5, np.hypot(0.001, 0.004) / 2**0.5))}


def test_only_what_the_map_does_not_hold_of_a_line_is_new():
    base = base_of(line("line", 0, 30))
    joined, changes = taken_in(
        base, {}, [(line("line_0", 10, 50, 5.1), belief()), (dash("dash_0", 10, 5.05), belief())]
    )
    assert [(c.change, c.id) for c in changes] == [("added", "line_0")]
    new = next(e for e in joined.map.elements if e.id == "line_0")
    assert new.points[0, 0] == pytest.approx(30.3, abs=0.3)
    assert new.points[-1, 0] == 50.0
    assert new.true_ends == (False, True)


def test_the_result_opens_as_a_map_and_a_drive_that_says_nothing_changes_nothing_but_age():
    base = base_of(pole("a", 0, 0), line("b", 0, 30))
    joined, changes = taken_in(base, {}, [])
    assert changes == []
    assert dict(BeliefMap.of(joined.as_map()).beliefs) == dict(joined.beliefs)
    assert [e.id for e in joined.map.elements] == ["a", "b"]


def test_what_can_be_seen_of_a_map():
    arm = replace(pole("arm", 5, 5), label="guardrail")
    base = base_of(pole("near", 5, 5), pole("far", 500, 5), dash("dash", 3), arm)
    near = Countable.of(base, np.array([[0.0, 0.0], [10.0, 0.0]]), {dash("d", 0).label}, True)
    assert [e.id for e in near.paint] == ["dash"]
    assert [u.element.id for u in near.uprights] == ["near"]
    assert Countable.of(base, np.zeros((1, 2)), set(), False).uprights == []
    assert Countable.of(None, np.zeros((1, 2)), set(), True).paint == []


def test_places_in_a_map_lay_a_drive_on_it(tmp_path):
    """A guess that is 2 m and 1 deg off comes right by two accepted places; a refused one pulls nothing."""
    chain, poses = made_chain()
    T_map_first = rigid.planar_pose(10.0, 20.0, 0.7)
    true = T_map_first @ rigid.inverse(poses[0]) @ poses
    guess = true[0] @ rigid.planar_pose(1.5, -1.3, 0.02)
    start = Start(guess, np.diag([2.0, 2.0, 0.1, 0.02, 0.02, 0.05]) ** 2)
    covariance = np.diag([0.05, 0.05, 0.05, 0.01, 0.01, 0.002]) ** 2
    found = [FoundLoop(-1, k, true[k], covariance, 50.0, ()) for k in (5, 25)]
    wrong = FoundLoop(-1, 15, true[15] @ rigid.planar_pose(5.0, 0.0), covariance, 3.0, ("twins",))
    solution = solve_chain(chain, start=start, places=places_of([*found, wrong], len(poses)))
    off_m = np.linalg.norm((solution.Ts_map_base - true)[:, :2, 3], axis=1)
    assert off_m[[5, 25]].max() < 0.05
    assert off_m.max() < 0.25
    assert np.linalg.norm((guess - true[0])[:2, 3]) > 1.5
    write_places(tmp_path / "places.csv", [*found, wrong], chain.times_s)
    rows = [row.split(",") for row in (tmp_path / "places.csv").read_text().splitlines()]
    assert [row[-2:] for row in rows[1:]] == [["1", ""], ["1", ""], ["0", "twins"]]
    assert float(rows[1][1]) == pytest.approx(true[5][0, 3], abs=1e-5)


def test_a_group_that_saw_twins_is_looked_at_again_by_the_way_of_the_others():
    chain, poses = made_chain()
    covariance = np.diag([0.05, 0.05, 0.05, 0.01, 0.01, 0.002]) ** 2
    looks = []

    def once(revisit, _):
        looks.append((revisit.b, revisit.is_second_look))
        reasons = () if revisit.is_second_look or len(looks) == 1 else ("twins",)
        return FoundLoop(-1, revisit.b, poses[revisit.b], covariance, 50.0, reasons)

    found, solution = find_places(
        chain,
        lambda index: ([], None),
        SemanticMap((dash("dash", 0),), None, "here"),
        load_class_table("drive"),
        lambda places: solve_chain(chain, start=Start(poses[0], np.eye(6)), places=places),
        LoopConfig(RevisitConfig(every_m=10.0, span_m=6.0)),
        once,
    )
    first = [b for b, again in looks if not again]
    assert len(first) >= 3
    assert [b for b, again in looks if again] == first[1:]
    assert [place.b for place in found] == first
    assert all(place.is_accepted for place in found)
    assert np.linalg.norm((solution.Ts_map_base - poses)[first, :2, 3], axis=1).max() < 0.1


def test_a_map_of_somewhere_else_is_one_sentence():
    chain, _ = made_chain()
    start = Start(np.eye(4), np.diag([2.0, 2.0, 0.1, 0.02, 0.02, 0.05]) ** 2)
    nowhere = FoundLoop(-1, 3, np.eye(4), np.eye(6), 0.0, ("no frame sees the map",))
    base = SemanticMap((dash("dash", 0),), None, "elsewhere")
    with pytest.raises(SemlocError, match="found in it \\(no frame sees the map\\); give --start"):
        find_places(
            chain,
            lambda index: ([], None),
            base,
            load_class_table("drive"),
            lambda places: solve_chain(chain, start=start, places=places),
            LoopConfig(),
            once=lambda revisit, search: nowhere,
        )


def test_the_report_says_what_changed(tmp_path):
    base = base_of(pole("gone", 20, 0), dash("bar", 5))
    told = {"gone": belief(-3.0, seen=0, missed=5), "bar": belief(5.0)}
    _, changes = taken_in(base, told, [(dash("dash_0", 6.1), belief()), (pole("pole_0", 50, 2), belief())])
    write_changes(changes, tmp_path / "changes.csv")
    rows = [row.split(",") for row in (tmp_path / "changes.csv").read_text().splitlines()]
    assert rows[0] == ["id", "change", "class", "x_m", "y_m", "existence"]
    assert [row[:3] for row in rows[1:]] == [
        ["gone", "removed", "pole"],
        ["bar", "moved", "lane_marking"],
        ["pole_0", "added", "pole"],
    ]
    assert (float(rows[1][3]), float(rows[2][3])) == (20.0, 7.6)
    found = [FoundLoop(-1, 3, np.eye(4), np.eye(6), 30.0, reasons) for reasons in ((), ("twins",))]
    told = {metric.key: metric.value for metric in base_metrics(found, changes)}
    assert told == {"base.searched": 2, "base.found": 1, "base.removed": 1, "base.moved": 1, "base.added": 1}


@pytest.mark.slow
def test_a_drive_of_a_later_epoch_tells_what_changed(data_dir, tmp_path):
    """The exact map before the changes, a drive after them: laid on it to 3 cm; nothing that stayed is taken away."""
    drive, before = data_dir / "crowd_seed3" / "e1d8", data_dir / "crowd_seed3" / "e0d0" / "map.geojson"
    if not drive.is_dir():
        pytest.skip(f"no drive {drive}")
    words = ["map", str(drive), "--base", str(before), "--masks", "sem_net", "--overlays", "0", "--out", str(tmp_path)]
    assert main(words) == OK
    metrics = {metric.key: metric.value for metric in read_metrics(tmp_path / "metrics.json")}
    assert metrics["base.found"] == metrics["base.searched"] == 11
    assert metrics["horizontal.max"] < 0.03
    assert metrics["height.max"] < 0.1
    assert metrics["map.pole.recall"] > 0.95
    changes = json.loads((drive / "changes.json").read_text())["since_epoch_0"]
    gone = {entry["id"] for entry in changes if entry["change"] in ("removed", "moved")}
    with (tmp_path / "changes.csv").open() as file:
        told = {row["id"] for row in csv.DictReader(file) if row["change"] in ("removed", "moved")}
    assert len(told & gone) >= 0.9 * len(told)
    assert len(told & gone) >= 8
