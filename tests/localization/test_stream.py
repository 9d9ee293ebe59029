"""A frame or a fix that cannot be used costs itself only: the frames around it are as without it."""

import dataclasses
import gc
import threading

import jax
import numpy as np
import pytest

from semloc_jax.datasets import GnssTrack, open_drive
from semloc_jax.errors import SemlocError
from semloc_jax.fusion.measurements import FusedPose, GnssMeasurement
from semloc_jax.fusion.prediction import MotionLog
from semloc_jax.geometry import rigid
from semloc_jax.inputs.mask_source import mask_source
from semloc_jax.inputs.priors import prior_source
from semloc_jax.localization import elsewhere, map_window, phase, rivals
from semloc_jax.localization.drive import track_frames
from semloc_jax.localization.frame_in_map import FrameInMap
from semloc_jax.localization.health import HealthConfig
from semloc_jax.localization.initialization import no_fixes, with_fix
from semloc_jax.localization.localizer import Localizer
from semloc_jax.localization.moved_elements import moves
from semloc_jax.localization.other_calibrations import changed_rigs
from semloc_jax.localization.pipeline import Pipeline, PipelineConfig
from semloc_jax.localization.track_state import TrackStatus
from semloc_jax.localization.watch_config import WatchConfig
from semloc_jax.maps import read_map
from semloc_jax.runtime.stored_program import StoredProgram
from semloc_jax.simulation import with_fault
from tests.contracts.test_pose_terms import ranges

pytestmark = pytest.mark.usefixtures("single_precision")


@pytest.fixture(scope="module")
def pipeline(simulated_road):
    drive = open_drive(simulated_road)
    masks = mask_source("sem", drive)
    localizer = Localizer(read_map(drive.map_path), masks.table, MotionLog.of_drive(drive))
    return Pipeline(drive, masks, localizer, PipelineConfig(threads=False), prior_source("truth", drive))


@pytest.fixture(scope="module")
def in_order(pipeline):
    """The results of all frames."""
    return list(pipeline.run(pipeline.drive.frames))


def _poses(results):
    return [result.fused.T_map_base for result in results if result.fused is not None]


def test_frames_out_of_order_cost_themselves_only(pipeline, in_order):
    one, two, three = pipeline.drive.frames
    timeless = dataclasses.replace(two, time_s=float("nan"), id="timeless")
    mixed = list(pipeline.run([one, two, two, one, timeless, three]))
    said = [(result.frame_id, result.reasons) for result in mixed if result.fused is None]
    assert [name for name, _ in said] == [two.id, one.id, "timeless"]
    assert [reasons[0].split(" that of")[0] for _, reasons in said] == [
        f"the frame of {two.time_s:.3f} s comes after",
        f"the frame of {one.time_s:.3f} s comes after",
        "the frame has the time nan",
    ]
    assert TrackStatus.TRACKING not in [result.status for result in mixed if result.fused is None]
    np.testing.assert_array_equal(_poses(mixed), _poses(in_order))


@pytest.mark.slow
def test_other_measurements_of_the_pose_are_taken_with_the_frame(pipeline, in_order):
    """Ranges of 1 mm to three beacons, at a place 3 cm beside the vehicle, pull the pose there; without, it is not."""
    drive, semantic_map = pipeline.drive, read_map(pipeline.drive.map_path)

    def beside(frame):
        T = drive.truth_at(frame) @ np.array([[1, 0, 0, 0], [0, 1, 0, 0.03], [0, 0, 1, 0], [0, 0, 0, 1.0]])
        beacons_map = T[:3, 3] + np.array([[30.0, 10.0, 4.0], [-10.0, 35.0, 3.0], [5.0, -25.0, 6.0]])
        return (ranges(T, beacons_map, 1e-3),)

    def lateral_m(results):
        poses = zip(drive.frames, _poses(results), strict=True)
        return np.array([(np.linalg.inv(drive.truth_at(frame)) @ T)[1, 3] for frame, T in poses])

    pulled = list(track_frames(drive, semantic_map, "sem", prior="truth", terms=beside))
    assert np.abs(lateral_m(in_order)).max() < 0.015
    assert np.abs(lateral_m(pulled)[1:] - 0.03).max() < 0.01


def test_a_new_localizer_compiles_nothing_and_leaves_nothing_behind(pipeline):
    """Programs belong to shapes and settings, not to the object that runs them."""
    frames, count = pipeline.drive.frames[:2], [0]

    def on_event(name: str, duration_s: float, **_) -> None:
        count[0] += name == "/jax/core/compile/backend_compile_duration"

    def another() -> int:
        drive = pipeline.drive
        localizer = Localizer(read_map(drive.map_path), pipeline.localizer.table, MotionLog.of_drive(drive))
        guess = prior_source("truth", drive)
        list(Pipeline(drive, mask_source("sem", drive), localizer, PipelineConfig(threads=False), guess).run(frames))
        del localizer
        for thread in threading.enumerate():
            if thread.name == map_window.AHEAD:  # on a busy machine one still samples, and keeps the map
                thread.join()
        gc.collect()
        return len(jax.live_arrays())

    list(pipeline.run(frames))
    held = another()
    jax.monitoring.register_event_duration_secs_listener(on_event)
    try:
        assert another() <= held and count[0] == 0
        jax.jit(lambda x: x + 1.0)(0.0)
        assert count[0] == 1  # it is heard
    finally:
        jax.monitoring.unregister_event_duration_listener(on_event)


def test_a_frame_is_solved_once_and_with_each_kind_of_lens_once(pipeline, monkeypatch):
    """One program for the frame, its search along the road included; one for all lenses of each of two kinds, the other
    sign among them, one for all widths of the road, one for its own lenses again."""
    called, call = [], StoredProgram.__call__

    def counted(program, *args, **kwargs):
        called.append(program.__name__)
        return call(program, *args, **kwargs)

    monkeypatch.setattr(StoredProgram, "__call__", counted)
    monkeypatch.setattr(rivals, "joined", lambda state, *_: state)  # other places have solves of their own
    state, before_s, counts = pipeline.localizer.start(), -np.inf, []
    for frame in pipeline.drive.frames:
        features = pipeline.features(frame, before_s)
        called.clear()
        state, result = pipeline.localizer.step(state, features)
        counts.append({name: called.count(name) for name in ("align_predicted", "align_with_rigs", "profile_beside")})
        before_s = frame.time_s
    assert result.accepted and int(state.watch.num_frames) == 2
    assert counts[-1]["align_predicted"] == 1 and counts[-1]["profile_beside"] == 0
    assert 3 <= counts[-1]["align_with_rigs"] <= 4


def test_a_lens_among_others_is_solved_as_it_is_alone(pipeline):
    localizer, features, T = _at_truth(pipeline)
    rigs = changed_rigs(features.rig, "focal", WatchConfig())
    known = features, T, 0.01 * np.eye(6), localizer.trust_in(localizer.start()), np.zeros(3), np.ones((), np.float32)
    scores, Ts = localizer.aligner.align_again(rigs, [0.0] * 4, [0, 1, 3], *known)
    alone, T_alone = localizer.aligner.align_again((rigs[3],), [0.0], [0], *known)
    assert scores.shape == (3,) and np.ptp(scores) > 1.0
    np.testing.assert_allclose(scores[2], alone[0], atol=1e-4)
    np.testing.assert_allclose(Ts[2], T_alone[0], atol=1e-5)


def test_a_lens_that_is_right_fits_as_well_from_beside_the_pose(pipeline):
    """The right lens stands elsewhere than the wrong one: the way there is searched, and what is seen of the map is
    chosen there."""
    localizer, features, T = _at_truth(pipeline)
    spread = np.diag([0.3, 0.1, 0.1, 0.01, 0.01, 0.005]) ** 2
    known = spread, localizer.trust_in(localizer.start()), np.zeros(3), np.ones((), np.float32)
    rigs = (features.rig, *changed_rigs(features.rig, "focal", WatchConfig())[:2])
    here = localizer.aligner.align_again(rigs, [0.0] * 3, [0, 1, 2], features, T, *known)
    for ahead_m in (-0.5, 0.5):
        beside = T @ rigid.exp(np.array([ahead_m, 0.0, 0.0, 0.0, 0.0, 0.0]))
        (own, *others), Ts = localizer.aligner.align_again(rigs, [0.0] * 3, [0, 1, 2], features, beside, *known)
        assert abs(own - here[0][0]) < 4.0 and own < min(others) - 1.0  # nats
        assert np.linalg.norm(Ts[0][:3, 3] - T[:3, 3]) < 0.12


@pytest.mark.parametrize("sigma_m", [0.0, -1.0, np.nan])
def test_fixes_that_state_no_doubt_are_left_out(pipeline, sigma_m):
    frame = pipeline.drive.frames[0]
    localizer, start = pipeline.localizer, pipeline.localizer.start()
    features = pipeline.features(frame, -np.inf)._replace(fixes=())
    bad = GnssMeasurement(frame.time_s, np.zeros(3), np.full(3, sigma_m))
    state, _ = localizer.step(start, features._replace(fixes=(bad,)))
    without, _ = localizer.step(start, features)
    np.testing.assert_array_equal(state.fixes.time_s, without.fixes.time_s)
    if not np.isnan(sigma_m):
        with pytest.raises(SemlocError, match="expected positive"):
            GnssTrack(np.zeros(1), np.zeros((1, 3)), np.full((1, 3), sigma_m))


def _at_truth(pipeline, semantic_map=None):
    """A localizer of a map, a frame, and where it was taken."""
    frame = pipeline.drive.frames[0]
    localizer = pipeline.localizer
    if semantic_map is not None:
        localizer = Localizer(semantic_map, localizer.table, localizer.motion)
    return localizer, pipeline.features(frame, -np.inf), pipeline.drive.truth_at(frame)


def test_lines_and_posts_are_each_least_costly_where_they_are(pipeline):
    """Repainted lines pull half a metre aside, posts stay: that is what tells an outdated map."""
    repainted = with_fault("lines_repainted:2", pipeline.drive, pipeline.localizer.map).semantic_map
    aside = moves(WatchConfig())[:31, 1]
    assert aside[15] == 0.0 and aside[[0, -1]] == pytest.approx([-1.5, 1.5])
    for semantic_map, lines_m in ((pipeline.localizer.map, 0.0), (repainted, 0.5)):
        localizer, features, T = _at_truth(pipeline, semantic_map)
        known = moves(WatchConfig()), np.zeros(3), np.ones((), np.float32), WatchConfig().level
        lines, posts = localizer.aligner.costs_of_classes(features, T, *known)[:2, :31]
        assert aside[np.argmin(lines)] == pytest.approx(lines_m, abs=0.11)
        assert aside[np.argmin(posts)] == pytest.approx(0.0, abs=0.11)
        assert min(posts[0], posts[-1]) > posts.min() + 3.0


def test_each_side_of_the_road_is_least_costly_where_it_is(pipeline):
    """Of a road that was made wider, what lies to the left fits half a metre aside of what lies to the right."""
    wider = with_fault("one_side_moved:2", pipeline.drive, pipeline.localizer.map).semantic_map
    aside = moves(WatchConfig())[:31, 1]
    localizer, features, T = _at_truth(pipeline, wider)
    known = moves(WatchConfig()), np.zeros(3), np.ones((), np.float32), WatchConfig().level
    left, right = localizer.aligner.costs_of_classes(features, T, *known)[2:, :31]
    assert aside[np.argmin(left)] == pytest.approx(0.5, abs=0.11)
    assert aside[np.argmin(right)] == pytest.approx(0.0, abs=0.11)


def test_a_road_that_the_map_has_too_wide_fits_better_when_it_is_made_narrower(pipeline):
    """All to the left of the way is 0.3 m aside in the map, so the middle of both sides is 0.15 m to the left of where
    the vehicle stands: from there it is found with a road that is so much narrower."""
    wider = with_fault("one_side_moved:1", pipeline.drive, pipeline.localizer.map).semantic_map
    spread, gains = np.diag([0.3, 0.1, 0.1, 0.01, 0.01, 0.005]) ** 2, []
    for semantic_map, best, middle_m in ((pipeline.localizer.map, 0, 0.0), (wider, 2, 0.15)):
        localizer, features, T = _at_truth(pipeline, semantic_map)
        known = features, T, spread, localizer.trust_in(localizer.start()), np.zeros(3), np.ones((), np.float32)
        (own, *others), Ts = localizer.aligner.align_again((features.rig,) * 3, [0.0, 0.3, -0.3], [0, 1, 2], *known)
        gains += [own - score for score in others]
        off = rigid.log(rigid.inverse(T) @ Ts[best])
        assert off[:2] == pytest.approx([0.0, middle_m], abs=0.08)
    assert max(gains[:3]) < -5.0 and gains[3] > 3.0  # nats


@pytest.mark.parametrize(("fault", "name"), [("focal:2", "focal"), ("distortion:3", "radial")])
def test_a_lens_stated_wrong_fits_better_when_it_is_changed_back(pipeline, fault, name):
    """Too long, and with the distortion of the wrong sign: too wide at the sides."""
    localizer, features, T = _at_truth(pipeline)
    wrong = with_fault(fault, pipeline.drive, localizer.map).drive.rig
    features = features._replace(rig=wrong.select(pipeline.source.cameras))
    given = features.rig
    scores = []
    for rig in (given, *changed_rigs(given, name, WatchConfig())[:2]):
        known = localizer.start()
        trust = lambda rows: np.ones(len(rows))  # noqa: E731
        spread = np.diag([0.3, 0.1, 0.1, 0.01, 0.01, 0.005]) ** 2
        seen = (features._replace(rig=rig), T, spread, 0.0, trust, known.stance, np.ones((), np.float32))
        scores.append(localizer.aligner.align(*seen).score)
    as_stated, wider, narrower = scores
    assert narrower < as_stated - 1.0 and narrower < wider - 2.0


@pytest.mark.parametrize("aside_m", [0.0, -3.5])
def test_masks_settle_a_lane_that_satellites_ask_for(pipeline, aside_m):
    """Fixes 3.5 m to the left of a pose that is right are wrong; of a pose that is a lane to the right they are not."""
    localizer, features, T = _at_truth(pipeline)
    T = T @ rigid.exp(np.array([0.0, aside_m, 0.0, 0.0, 0.0, 0.0]))
    trust = lambda rows: np.ones(len(rows))  # noqa: E731
    frame = FrameInMap(features, localizer.aligner, trust, localizer.start(), HealthConfig())
    found = frame.align(T, np.diag([0.1, 0.1, 0.05, 0.01, 0.01, 0.01]) ** 2, 0.0).found
    asked_m = 3.5 * T[:2, 1]
    fixes = no_fixes()
    for k in range(8):
        fixes = with_fix(fixes, GnssMeasurement(0.1 * k, T[:3, 3] + [*asked_m, 0.0], np.full(3, 0.5)))
    pose = FusedPose(features.time_s, T, 1e-4 * np.eye(6), 1.0, 0.0, asked_m)
    nats = elsewhere._behind(pose, found, fixes, frame)
    assert (phase.doubts(pose, fixes, nats) == ()) == (aside_m == 0.0)
    assert aside_m == 0.0 or nats < 0.0  # the other place is the better one
