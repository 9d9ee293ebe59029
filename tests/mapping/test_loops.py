"""Loops: where they are looked for, when they are accepted, their file, and twins of a rendered garage and road."""

from dataclasses import replace
from itertools import accumulate

import numpy as np
import pytest
from scipy.special import chdtri

from semloc_jax.alignment.result import Mode
from semloc_jax.datasets import read_drive
from semloc_jax.geometry import rigid
from semloc_jax.inputs.mask_source import mask_source
from semloc_jax.mapping.chain import drive_chain
from semloc_jax.mapping.chain_graph import Loops, Start, solve_chain
from semloc_jax.mapping.found_loops import COLUMNS, FoundLoop, loops_of, write_loops
from semloc_jax.mapping.loops import LoopConfig, LoopSearch, against, weighed_by_way
from semloc_jax.mapping.place_search import Place, lead_nats, place_of_stretch, views_of
from semloc_jax.mapping.revisits import Revisit, RevisitConfig, groups, revisits
from semloc_jax.maps import SemanticMap, read_map
from semloc_jax.perception import load_class_table
from tests.mapping.test_chain_graph import LAP, NUM, SCALE, made_chain

CONFIG = LoopConfig()


def test_groups_are_spread_over_the_way_and_none_is_of_a_standing_vehicle():
    way_m = np.concatenate([np.arange(0.0, 50.0, 1.0), np.full(100, 50.0), np.arange(50.0, 101.0, 1.0)])
    config = RevisitConfig(every_m=20.0, span_m=12.0, num_frames=4)
    found = groups(way_m, config)
    assert all(len(set(group)) == 4 for group in found)
    middles = [way_m[list(group)].mean() for group in found]
    np.testing.assert_allclose(np.diff(middles), 20.0, atol=1.0)
    assert max(np.ptp(way_m[list(group)]) for group in found) <= 13.0


def test_revisits_are_earlier_passes_within_what_the_way_may_be_off():
    """On rounds of 20 m the pass before last and the last one lie under the third; what was just passed does not."""
    chain, poses = made_chain(scale=1.0)
    solution = solve_chain(chain)
    config = RevisitConfig(min_way_m=10.0, reach_m=1.0)
    frames = (24, 25, 26, 27)
    found = revisits(solution, chain.way_m, frames, config)
    assert [revisit.b for revisit in found] == [26] * len(found)
    assert sorted(revisit.a for revisit in found) == sorted({26 - LAP, 26 - 2 * LAP})
    said = found[0].covariance
    np.testing.assert_allclose(said, solution.relative_covariance([found[0].a], [26])[0], atol=1e-12)
    assert found[0].sigma_xy_m == pytest.approx(np.sqrt(np.linalg.eigvalsh(said[:2, :2])[-1]))
    assert revisits(solution, chain.way_m, frames, replace(config, min_way_m=60.0)) == []
    assert revisits(solution, chain.way_m, frames, replace(config, max_sigma_m=1e-4)) == []
    assert NUM > frames[-1] and len(poses) == NUM


def test_frames_agree_as_well_as_the_motion_between_them_is_known():
    """An odometer that is 2 % off before anything tells: frames that each lie right to 1 cm do not disagree for it."""
    chain, poses = made_chain(scale=SCALE)
    # But for the scale the chain is right.
    steps = rigid.inverse(poses[:-1]) @ poses[1:]
    steps[:, :3, 3] /= SCALE
    way = np.array(list(accumulate(steps, np.matmul, initial=poses[0])))
    chain = chain._replace(Ts_odom_base=way)
    way, frames, middle = solve_chain(chain, start=Start(poses[0], np.diag([1e-6] * 6))), (8, 10, 12, 14), 12
    views = views_of(lambda _: ([], None), frames, middle, way)
    assert np.abs(views[2].T_middle_base - np.eye(4)).max() < 1e-9
    np.testing.assert_allclose(np.sqrt(np.diag(way.calibration_covariance)), chain.calibration_sigma, rtol=0.05)
    for view in views:
        far_m = np.linalg.norm(view.T_middle_base[:3, 3])
        along = view.T_middle_base[:3, :3].T @ view.T_middle_base[:3, 3]
        sigma2 = along @ view.covariance[:3, :3] @ along
        assert np.sqrt(sigma2) == pytest.approx(chain.calibration_sigma[0] * far_m**2, rel=0.05)
        assert np.linalg.eigvalsh(view.covariance).min() > -1e-12
    # Where the drive lies is open by a kilometre: no variance of the motion within it is lost in rounding for that.
    lost = solve_chain(chain, start=Start(poses[0], np.diag([1e6] * 3 + [1e-2] * 3)))
    for view, known in zip(views_of(lambda _: ([], None), frames, middle, lost), views, strict=True):
        np.testing.assert_allclose(view.covariance, known.covariance, atol=1e-4)
    covariance = np.diag(np.array([0.01, 0.01, 0.01, 0.001, 0.001, 0.001]) ** 2)
    modes = [(Mode(1.0, poses[k], covariance, 10.0, 0.1, 1.0, 0.8, np.eye(6)[0]),) for k in frames]

    def chi_square(views):
        return place_of_stretch(views, modes, poses[middle], 100.0).chi_square

    most = chdtri(3 * (len(frames) - 1), 1.0 - CONFIG.probability)
    assert chi_square(views) < most
    assert chi_square([view._replace(covariance=np.zeros((6, 6))) for view in views]) > 2.0 * most


def place(nats, T=None, seen=(True,) * 4, explained=0.5, chi_square=5.0):
    covariance = np.diag(np.array([0.02, 0.01, 0.02, 0.003, 0.003, 0.001]) ** 2)
    return Place(np.eye(4) if T is None else T, covariance, nats, np.array(seen), explained, chi_square)


def reasons(best, lead, off_m=0.1):
    covariance = best.covariance + np.diag(np.repeat([0.25, 1e-4], 3))
    return list(against(best, lead, np.array([off_m, 0.0, 0.0, 0.0, 0.0, 0.0]), covariance, CONFIG))


def test_the_lead_is_over_another_place_not_over_the_slope_of_the_same():
    near, twin = rigid.planar_pose(0.6, 0.0), rigid.planar_pose(2.5, 0.0)
    assert lead_nats([place(300.0), place(295.0, near), place(270.0, twin)]) == pytest.approx(30.0)
    assert lead_nats([place(300.0), place(-40.0, twin)]) == pytest.approx(300.0)


def test_a_loop_needs_uniqueness_agreement_and_the_way():
    assert reasons(place(300.0), 60.0) == []
    assert reasons(place(300.0), 12.0) == ["12.0 nats over the second place"]
    assert reasons(place(300.0, seen=(True, True, False, False)), 60.0) == ["2 of 4 frames see it"]
    assert reasons(place(300.0, seen=(False,) * 4), 60.0) == ["0 of 4 frames see it"]
    assert reasons(place(300.0, explained=0.1), 60.0) == ["10% of the map in view on borders of the masks"]
    assert reasons(place(300.0, chi_square=60.0), 60.0) == ["frames disagree: chi-square 60 of 9"]
    assert reasons(place(300.0), 60.0, off_m=2.6) == ["2.6 m from where the way ends: chi-square 27 of 3"]


def test_an_open_place_is_no_loop():
    """A loop that says 0.27 m was 0.64 m off: half a metre is another place."""
    wide = place(300.0)._replace(covariance=np.diag([0.27**2, 0.01, 0.04, 1e-5, 1e-5, 1e-5]))
    assert reasons(wide, 60.0) == ["the place is open by 0.27 m"]
    assert reasons(wide._replace(covariance=np.diag([0.15**2, 0.01, 0.04, 1e-5, 1e-5, 1e-5])), 60.0) == []


def test_the_way_tells_twins_apart_that_look_alike():
    """A dash period on, the masks even prefer the twin by 3 nats: 3.8 m against 0.5 m are 29 nats."""
    T_way, twin = rigid.planar_pose(10.0, 5.0, 0.4), rigid.planar_pose(3.8, 0.0)
    places = [place(300.0, T_way @ twin), place(297.0, T_way @ rigid.planar_pose(0.1, 0.0))]
    best, second = weighed_by_way(places, T_way, 0.5, 0.01)
    np.testing.assert_allclose(best.T_map_middle, places[1].T_map_middle)
    assert lead_nats([best, second]) == pytest.approx(0.5 * (3.8**2 - 0.1**2) / 0.5**2 - 3.0)


def never(frame):
    raise AssertionError("nothing to look for")


def told(chain, poses, second_look, off_m=0.0):
    """A search whose every other group sees twins at first sight; and the revisits that were searched."""
    seen = []

    def once(revisit, _):
        seen.append(revisit)
        T = rigid.inverse(poses[revisit.a]) @ poses[revisit.b]
        covariance = np.diag(np.array([0.05, 0.03, 0.05, 0.005, 0.005, 0.003]) ** 2)
        if revisit.is_second_look:
            return FoundLoop(revisit.a, revisit.b, T @ rigid.planar_pose(off_m, 0.0), covariance, 40.0, second_look)
        return FoundLoop(revisit.a, revisit.b, T, covariance, 40.0, ("twins",) if len(seen) % 2 else ())

    config = LoopConfig(RevisitConfig(every_m=6.0, span_m=6.0, min_way_m=10.0, reach_m=1.0), max_passes=1)
    solve = lambda loops: solve_chain(chain, loops)  # noqa: E731
    table = load_class_table("drive")
    found, solution = LoopSearch(chain, never, never, table, solve, config, once).run()
    return seen, found, solution


def test_groups_that_saw_twins_are_looked_at_again_by_the_way_of_the_others():
    chain, poses = made_chain()
    seen, found, solution = told(chain, poses, ())
    again = [revisit for revisit in seen if revisit.is_second_look]
    first = {revisit.b: revisit for revisit in seen if not revisit.is_second_look}
    assert len(again) >= 2 and len(found) == len(first)
    assert all(loop.is_accepted for loop in found)
    # Only what comes later can tell more than at the first look, and the last group has none.
    assert all(revisit.sigma_xy_m < 0.9 * first[revisit.b].sigma_xy_m for revisit in again[:-1])
    error_m = np.linalg.norm((solution.Ts_map_base - poses)[:, :2, 3], axis=1)
    _, only_first, without = told(chain, poses, ("twins",))
    assert sum(loop.is_accepted for loop in only_first) == len(found) - len(again)
    assert error_m.max() < np.linalg.norm((without.Ts_map_base - poses)[:, :2, 3], axis=1).max() + 0.02


def test_a_loop_that_the_others_speak_against_is_not_accepted():
    chain, poses = made_chain()
    seen, found, solution = told(chain, poses, (), off_m=3.0)
    wrong = {revisit.b for revisit in seen if revisit.is_second_look}
    for loop in found:
        assert loop.reasons == (("the other loops speak against it",) if loop.b in wrong else ())
    assert np.linalg.norm((solution.Ts_map_base - poses)[:, :2, 3], axis=1).max() < 0.3


def test_the_file_has_a_row_for_every_revisit_that_was_searched(tmp_path):
    T = rigid.planar_pose(1.0, -2.0, np.pi / 2)
    covariance = np.diag(np.array([0.04, 0.03, 0.05, 0.01, 0.01, 0.01]) ** 2)
    found = [
        FoundLoop(3, 40, T, covariance, 88.125, ()),
        FoundLoop(4, 44, np.eye(4), covariance, 3.0, ("twins", "9 m off")),
    ]
    write_loops(tmp_path / "loops.csv", found, 0.2 * np.arange(50))
    header, first, second = (tmp_path / "loops.csv").read_text().splitlines()
    assert header == COLUMNS
    assert first.endswith(",1,")
    row = dict(zip(header.split(",")[:-1], map(float, first.split(",")[:-1]), strict=True))
    assert (row["t_a"], row["t_b"], row["accepted"]) == (pytest.approx(0.6), pytest.approx(8.0), 1.0)
    assert [row[key] for key in ("x", "y", "qz", "qw")] == pytest.approx([1.0, -2.0, 0.5**0.5, 0.5**0.5], abs=1e-6)
    assert (row["sigma_lateral_m"], row["sigma_longitudinal_m"]) == (0.03, 0.04)
    assert second.endswith(",3.00,0,twins; 9 m off")
    np.testing.assert_array_equal(loops_of(found).b, [40])


def test_a_stretch_without_a_map_gives_no_loop_and_leaves_the_way(tmp_path):
    chain, _ = made_chain(scale=1.0)
    config = LoopConfig(RevisitConfig(every_m=5.0, span_m=6.0, min_way_m=10.0, reach_m=1.0))
    asked = []

    def nothing(frames):
        asked.append(frames)
        return SemanticMap(()) if len(asked) % 2 else None

    table = load_class_table("drive")
    search = LoopSearch(chain, never, nothing, table, lambda loops: solve_chain(chain, loops), config)
    found, solution = search.run()
    assert found == [] and len(asked) > 3
    assert all(frames.max() < NUM for frames in asked)
    np.testing.assert_allclose(solution.Ts_map_base, chain.Ts_odom_base, atol=1e-6)
    write_loops(tmp_path / "loops.csv", found, chain.times_s)
    assert (tmp_path / "loops.csv").read_text() == COLUMNS + "\n"


class AsMade:
    """The exact map of what a stretch passes, moved by the drift of the chain: what a perfect mapper has."""

    def __init__(self, semantic_map, Ts_true, Ts_odom, reach_m=25.0):
        self.elements, self.true, self.reach_m = semantic_map.elements, Ts_true[:, :2, 3], reach_m
        self.drift = Ts_odom @ rigid.inverse(Ts_true)

    def __call__(self, frames):
        found = []
        for element in self.elements:
            away_m = np.linalg.norm(element.points[:, None, :2] - self.true[frames], axis=2)
            if away_m.min() <= self.reach_m:
                drift = self.drift[frames[away_m.argmin(axis=1)]]
                points = (drift @ np.column_stack([element.points, np.ones(len(element.points))])[..., None])[:, :3, 0]
                normal = None if element.normal is None else drift[0, :3, :3] @ element.normal
                found.append(replace(element, points=points, normal=normal))
        return SemanticMap(tuple(found))


class Scene:
    """A rendered drive with its chain and truth."""

    def __init__(self, folder):
        self.drive = read_drive(folder)
        self.chain = drive_chain(self.drive)
        self.true = self.drive.truth.interpolate(self.chain.times_s)
        self.source = mask_source("sem_net", self.drive)
        self.map_of = AsMade(read_map(self.drive.map_path), self.true, self.chain.Ts_odom_base)

    def look(self, frame):
        frame = self.drive.frames[frame]
        return self.source.masks(frame), self.source.seen_by(frame.rig)

    def search(self, map_of=None, config=CONFIG):
        start = Start(self.true[0], np.diag(np.repeat([0.01, 0.002], 3) ** 2))
        known = lambda loops: solve_chain(self.chain, loops, start=start)  # noqa: E731
        return LoopSearch(self.chain, self.look, map_of or self.map_of, self.source.table, known, config)

    def off_m(self, loop):
        true = rigid.inverse(self.true[loop.a]) @ self.true[loop.b]
        return float(np.hypot(*rigid.log(rigid.inverse(true) @ loop.T_a_b)[:2]))

    def at(self, way_m):
        return int(np.searchsorted(self.chain.way_m, way_m))


@pytest.fixture(scope="module")
def garage(data_dir):
    if not (data_dir / "garage2_seed2").is_dir():
        pytest.skip(f"no drive garage2_seed2 in {data_dir}")
    return Scene(data_dir / "garage2_seed2")


@pytest.mark.slow
def test_a_garage_closes_its_rounds_to_centimetres(garage):
    """Every other group: the same aisle again, the other way round, and across."""
    found, solution = garage.search(config=LoopConfig(RevisitConfig(every_m=40.0))).run()
    accepted = [loop for loop in found if loop.is_accepted]
    assert len(found) >= 5 and len(accepted) >= 0.9 * len(found)
    assert max(garage.off_m(loop) for loop in accepted) < 0.1
    assert solution.is_kept.all()
    assert isinstance(loops_of(accepted), Loops)
    error = np.linalg.norm((solution.Ts_map_base - garage.true)[:, :2, 3], axis=1)
    assert error.mean() < 0.2


@pytest.mark.slow
@pytest.mark.parametrize("bays", [1, -2])
def test_a_group_that_is_told_to_be_bays_further_finds_its_own_bay(garage, bays):
    """Bays of 2.5 m are twins of each other: pillars, arrows and the ends of rows tell them apart."""
    chain = garage.chain
    for way_a, way_b in ((24.0, 280.0), (160.0, 338.0)):
        a, frames = garage.at(way_a), tuple(garage.at(way_b + step) for step in (-6.0, -2.0, 2.0, 6.0))
        moved = chain.Ts_odom_base.copy()
        T_b = moved[frames[2]]
        moved[list(frames)] = T_b @ rigid.planar_pose(2.5 * bays, 0.0) @ rigid.inverse(T_b) @ moved[list(frames)]
        told = replace(solve_chain(chain), Ts_map_base=moved)
        sigma = np.array([2.5, 2.5, 0.1, 0.01, 0.01, 0.03])
        loop = garage.search().searched(Revisit(a, frames[2], frames, np.diag(sigma**2)), told)
        assert loop.is_accepted, loop.reasons
        assert garage.off_m(loop) < 0.1
        assert loop.nats_over_second > 100.0
