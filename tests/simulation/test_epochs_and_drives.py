"""One world at several epochs and in several drives: what changes is what is said to change, and nothing else."""

import json
import sys
from dataclasses import replace

import numpy as np
import pytest

from semloc_jax.cameras.io import read_calibration, write_calibration
from semloc_jax.cli.main import FAILED, OK, main
from semloc_jax.datasets import read_drive
from semloc_jax.errors import SemlocError
from semloc_jax.maps import read_map
from semloc_jax.simulation import SimulationConfig, simulate
from semloc_jax.simulation.cameras import front_rig
from semloc_jax.simulation.epochs import at_epoch, changes_between
from semloc_jax.simulation.road import build_road
from semloc_jax.simulation.tours import TourWish, hall_tour, loop_tour, lot_tour

TINY = SimulationConfig(num_frames=1, width_px=64, height_px=40, has_images=False)


@pytest.fixture(scope="module")
def world():
    return build_road(np.random.default_rng([3, 1]), 300.0, 11.0, 0.0)


def applied(elements, changes):
    """Centres by id after the listed changes: the reading of changes.json that a user would write."""
    places = {e.id: np.array(e.attributes.get("center", e.points.mean(axis=0))) for e in elements}
    for change in changes:
        if change["change"] == "removed":
            del places[change["id"]]
        elif change["change"] == "added":
            places[change["id"]] = np.array(change["position"])
        else:
            places[change["id"]] = places[change["id"]] + change["delta"]
    return places


@pytest.mark.parametrize("epoch", [1, 2, 3])
def test_an_epoch_changes_only_what_the_list_says(world, epoch):
    later, changes = at_epoch(world, [3, 1], epoch)
    before, _ = at_epoch(world, [3, 1], epoch - 1)
    for first, kind in ((world, "since_epoch_0"), (before, "since_previous")):
        expected = applied(first.elements, changes[kind])
        found = {e.id: np.array(e.attributes.get("center", e.points.mean(axis=0))) for e in later.elements}
        assert set(found) == set(expected)
        assert max(np.abs(found[name] - expected[name]).max() for name in found) < 2e-3
        named = {change["id"] for change in changes[kind]}
        now = {e.id: e for e in later.elements}
        for element in first.elements:
            if element.id not in named:
                np.testing.assert_array_equal(element.points, now[element.id].points)
    assert {change["change"] for change in changes["since_epoch_0"]} == {"removed", "moved", "added", "repainted"}
    assert 0.02 < len(changes["since_previous"]) / len(world.elements) < 0.2


def test_changes_are_on_the_ground_and_keep_posts_off_the_road(world):
    later, changes = at_epoch(world, [3, 1], 2)
    named = {change["id"] for change in changes["since_epoch_0"]}
    for element in later.elements:
        if element.id in named and (element.is_painted or element.label.name == "POLE"):
            foot = element.points[:1] if element.label.name == "POLE" else element.points
            off = foot[:, 2] - later.surface.height(foot[:, 0], foot[:, 1])
            assert np.abs(off).max() < 1e-6
    moved = [change["distance_m"] for change in changes["since_epoch_0"] if change["change"] == "moved"]
    assert 0.1 < min(moved) and max(moved) < 2.0 * 2.1


def test_epoch_zero_and_the_same_map_have_no_changes(world):
    same, changes = at_epoch(world, [3, 1], 0)
    assert same is world
    assert changes == {"epoch": 0, "since_epoch_0": [], "since_previous": []}
    assert changes_between(world.elements, world.elements) == []


@pytest.fixture(scope="module")
def drives(tmp_path_factory):
    folder = tmp_path_factory.mktemp("drives")
    first = simulate("garage", 5, folder / "first", TINY)
    words = ["--kind", "garage", "--seed", "5", "--drive", "1", "--num-frames", "1", "--masks-only"]
    words += ["--width-px", "64", "--height-px", "40", "--imu-rate-hz", "200", "--imu-offset-s", "0.02"]
    assert main(["simulate", str(folder / "second"), *words, "--gps-bias-m", "2.5"]) == OK
    return first, read_drive(folder / "second")


def test_another_drive_keeps_the_world(drives):
    first, second = (read_map(drive.map_path).elements for drive in drives)
    assert [e.id for e in first] == [e.id for e in second]
    for one, other in zip(first, second, strict=True):
        np.testing.assert_array_equal(one.points, other.points)


def test_another_drive_has_its_own_cars_sensors_mounting_and_masks(drives):
    first, second = drives
    cars = [
        [e.attributes["occupied"] for e in read_map(d.map_path).elements if "occupied" in e.attributes] for d in drives
    ]
    assert 0.2 < np.mean(np.array(cars[0]) != cars[1]) < 0.8
    off = np.linalg.inv(np.asarray(first.rig.T_base_cam)) @ np.asarray(second.rig.T_base_cam)
    turned_deg = np.degrees(np.arccos(np.clip((np.trace(off[:, :3, :3], axis1=1, axis2=2) - 1.0) / 2.0, -1.0, 1.0)))
    assert 0.05 < turned_deg.max() < 2.0 and np.linalg.norm(off[:, :3, 3], axis=1).max() < 0.05
    assert not np.allclose(first.truth.T_map_base, second.truth.T_map_base, atol=1e-3)
    told = [json.loads((d.path / "meta.json").read_text())["sensors"] for d in drives]
    assert told[0]["gyro_bias"] != told[1]["gyro_bias"]
    assert np.hypot(*told[1]["gps_bias"][:2]) == pytest.approx(2.5)
    assert np.diff(second.imu.time_s).mean() == pytest.approx(0.005, rel=1e-3)
    assert second.imu.time_s[0] - first.imu.time_s[0] == pytest.approx(0.02, abs=1e-6)


def test_a_rig_of_ones_own_is_used(tmp_path, capsys):
    write_calibration(front_rig(80, 50), tmp_path / "mine.yaml")
    words = ["--rig", str(tmp_path / "mine.yaml"), "--num-frames", "1", "--masks-only"]
    assert main(["simulate", str(tmp_path / "drive"), *words]) == OK
    drive = read_drive(tmp_path / "drive")
    assert drive.frames[0].mask("sem", "front").shape == (50, 80)
    assert drive.rig.names == read_calibration(tmp_path / "mine.yaml").names


def test_an_interrupted_drive_is_finished_with_the_same_bytes(tmp_path):
    config = replace(TINY, num_frames=2, drive=1)
    simulate("road", 2, tmp_path / "whole", config)
    simulate("road", 2, tmp_path / "broken", config)
    # As a kill leaves it: no list of frames, the last mask missing, the first one as it was.
    place = tmp_path / "broken"
    recipe = []
    with pytest.MonkeyPatch.context() as patch:
        module = sys.modules["semloc_jax.simulation.simulate"]
        patch.setattr(module, "write_pictures", lambda *args: recipe.append((place / "unfinished.json").read_text()))
        simulate("road", 2, place, config)
    (place / "frames.csv").unlink()
    (place / "unfinished.json").write_text(recipe[0])
    (place / "sem_net" / "front" / "000001.png").unlink()
    first = (place / "sem" / "front" / "000000.png").stat().st_mtime_ns
    assert main(["simulate", str(place), "--seed", "3", "--num-frames", "2"]) == FAILED
    simulate("road", 2, place, config)
    assert (place / "sem" / "front" / "000000.png").stat().st_mtime_ns == first
    for path in sorted(p for p in (tmp_path / "whole").rglob("*") if p.is_file()):
        assert path.read_bytes() == (place / path.relative_to(tmp_path / "whole")).read_bytes(), path
    assert not (place / "unfinished.json").exists()


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"epoch": -1}, "epoch = -1"),
        ({"imu_rate_hz": 0.0}, "imu_rate_hz = 0"),
        ({"gps_bias_m": -1.0}, "gps_bias_m = -1"),
    ],
)
def test_wrong_values_are_named(tmp_path, change, says):
    with pytest.raises(SemlocError, match=says):
        simulate("road", 1, tmp_path / "drive", replace(TINY, **change))


@pytest.mark.parametrize("tour", [loop_tour, hall_tour, lot_tour])
def test_whole_ways_keep_their_world_from_drive_to_drive(tour):
    """Map, obstacles and changes are the same on drive 0, whose random numbers go on from the world's, and another."""
    wish = TourWish(5.0, 1, 0.05, has_obstacles=tour is not loop_tour)
    first = tour(world_rng := np.random.default_rng([2, 9]), world_rng, wish)
    second = tour(np.random.default_rng([2, 9]), np.random.default_rng(77), wish)
    assert [e.id for e in first.world.elements] == [e.id for e in second.world.elements]
    for one, other in zip(first.world.elements, second.world.elements, strict=True):
        np.testing.assert_array_equal(one.points, other.points)
    assert first.world.features == second.world.features
    changes = [at_epoch(way.world, [2, 9, 10], 2)[1] for way in (first, second)]
    assert changes[0] == changes[1] and len(changes[0]["since_epoch_0"]) > 3
    times = np.linspace(0.0, 0.5 * min(first.end_s, second.end_s), 7)
    assert not np.allclose(first.motion.poses(times), second.motion.poses(times), atol=0.05)
