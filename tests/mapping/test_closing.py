"""The way of a drive closed in its own maps: pieces made once, what fixes the frame, what the report says of loops."""

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from semloc_jax.cameras import PinholeCamera, Rig
from semloc_jax.datasets import Drive, Frame
from semloc_jax.datasets.sensors import GnssTrack
from semloc_jax.errors import SemlocError
from semloc_jax.evaluation.trajectory import Trajectory
from semloc_jax.geometry import rigid
from semloc_jax.inputs.mask_view import MaskSource
from semloc_jax.mapping import stretch_maps
from semloc_jax.mapping.base_places import places_of
from semloc_jax.mapping.closing import closed_way
from semloc_jax.mapping.found_loops import FoundLoop
from semloc_jax.mapping.gauge import gauge_of
from semloc_jax.mapping.stretch_maps import StretchMaps
from semloc_jax.maps import MapElement, SemanticMap
from semloc_jax.perception import load_class_table
from semloc_jax.reports.map_judgement import loop_metrics
from tests.mapping.test_chain_graph import NUM, made_chain


def drive(truth=None, gnss=None):
    rig = Rig([PinholeCamera(400.0, 400.0, 320.0, 240.0, 640, 480)], np.eye(4)[None], ["front"])
    frames = tuple(Frame(k, f"{k:06d}", 0.2 * k, "", rig, {}) for k in range(NUM))
    return Drive("made", Path("."), frames, rig, truth=truth, gnss=gnss)


def masks():
    def segment(frame, camera):
        raise AssertionError("no mask is needed")

    return MaskSource("none", load_class_table("drive"), ("front",), segment)


def test_stretches_are_made_once_and_by_a_frame_every_step_of_the_way(monkeypatch):
    chain, _ = made_chain()
    made = []

    def make_map(drive, masks, frames, Ts_map_base, config, looker):
        made.append([frame.index for frame in frames])
        np.testing.assert_array_equal(Ts_map_base, chain.Ts_odom_base[made[-1]])
        assert (config.look.spacing_m, looker) == (stretch_maps.SPACING_M, "looker")
        if 0 in made[-1]:
            raise SemlocError("nothing stays")
        element = MapElement("line", "lane_marking", np.zeros((2, 3)) + [[0.0], [1.0]])
        return SimpleNamespace(belief_map=SimpleNamespace(map=SemanticMap((element,))))

    monkeypatch.setattr(stretch_maps, "make_map", make_map)
    monkeypatch.setattr(stretch_maps, "Looker", lambda *args: "looker")
    map_of = StretchMaps(drive(), masks(), chain)
    assert map_of(np.arange(0)) is None
    assert map_of(np.arange(0, 5)) is None
    stretch = map_of(np.arange(5, 25))
    assert [element.id for element in stretch.elements] == ["line"]
    assert map_of(np.arange(5, 25)) is stretch
    assert made == [[*range(5)], [*range(5, 25)]]
    made.clear()
    # Half a metre a frame: every second or third one looks.
    slow = StretchMaps(drive(), masks(), chain._replace(way_m=0.25 * chain.way_m))
    slow(np.arange(12, 24))
    assert made == [[12, 15, 17, 20, 22]]


def test_what_fixes_the_frame_of_a_map():
    chain, poses = made_chain()
    truth = Trajectory(chain.times_s, rigid.planar_pose(10.0, 20.0, 1.0) @ poses)
    gnss = GnssTrack(chain.times_s, truth.T_map_base[:, :3, 3], np.full((NUM, 3), 0.5))
    both = drive(truth, gnss)
    assert gauge_of(both, chain, None).name == "gnss"
    assert gauge_of(drive(truth), chain, None).name == "identity"
    closed = closed_way(both, masks(), chain, gauge_of(both, chain, "truth"))
    assert closed.loops == []
    np.testing.assert_allclose(closed.Ts_map_base[0], truth.T_map_base[0], atol=1e-3)
    first = closed_way(both, masks(), chain, gauge_of(both, chain, "identity")).Ts_map_base
    np.testing.assert_allclose(first[0], np.eye(4), atol=1e-3)
    np.testing.assert_allclose(closed.Ts_map_base, truth.T_map_base[0] @ first, atol=2e-3)
    fixed = closed_way(both, masks(), chain, gauge_of(both, chain, "gnss")).Ts_map_base
    assert np.linalg.norm((fixed - truth.T_map_base)[:, :2, 3], axis=1).max() < 1.0
    with pytest.raises(SemlocError, match="has no satellite fixes"):
        gauge_of(drive(truth), chain, "gnss")


def test_a_start_in_a_map_that_is_there_is_a_guess():
    """A place in the map moves the first pose by more than the start, as the frame of a new map, would allow."""
    chain, poses = made_chain()
    truth = Trajectory(chain.times_s, poses)
    gauge = gauge_of(drive(truth), chain, "truth")
    place = FoundLoop(
        -1, 10, rigid.planar_pose(0.8, -0.6) @ poses[10], np.diag([0.05, 0.05, 0.05, 0.01, 0.01, 0.005]) ** 2, 50.0, ()
    )
    places = places_of([place], NUM)
    stays = gauge.solve(chain, places=places).Ts_map_base[0]
    moves = gauge.guessed(2.0, 0.05).solve(chain, places=places).Ts_map_base[0]
    assert np.linalg.norm((stays - truth.T_map_base[0])[:2, 3]) < 0.01
    np.testing.assert_allclose((moves - truth.T_map_base[0])[:2, 3], [0.8, -0.6], atol=0.35)
    assert gauge_of(drive(truth), chain, "identity").gnss is None


def test_the_report_counts_loops_and_false_ones():
    _, poses = made_chain()
    true = rigid.inverse(poses[2]) @ poses[12]
    covariance = np.eye(6)
    twin = true @ rigid.planar_pose(2.5, 0.0)
    found = [FoundLoop(2, 12, true @ rigid.planar_pose(0.03, 0.04), covariance, 50.0, ())]
    found += [FoundLoop(2, 12, twin, covariance, 50.0, ()), FoundLoop(2, 12, twin, covariance, 5.0, ("twins",))]
    told = {metric.key: metric.value for metric in loop_metrics(found, poses)}
    assert (told["loops.searched"], told["loops.accepted"], told["loops.false"]) == (3.0, 2.0, 1.0)
    assert told["loops.error.max"] == pytest.approx(2.5, abs=1e-6)
    assert told["loops.error.median"] == pytest.approx(0.5 * (2.5 + 0.05), abs=1e-6)
    assert [metric.key for metric in loop_metrics(found, None)] == ["loops.searched", "loops.accepted"]
