"""Slots over many frames: association, existence and fusion of seeded sights; rows and skew of single frames."""

from dataclasses import replace

import numpy as np

from semloc_jax.mapping.object_tracks import ObjectTrackConfig, Tracker, associated, fused
from semloc_jax.mapping.slot_sights import Slot, in_rows, upright
from semloc_jax.mapping.slot_tracks import SlotTrack
from semloc_jax.mapping.slots import SlotConfig
from semloc_jax.maps import MapElement
from semloc_jax.structs import ElementClass


def sight(pose, sigma_m=0.05, kind="perpendicular", occupied=False):
    return Slot(kind, np.array(pose, float), 2.5, 5.0, 0.0, occupied, np.diag([sigma_m**2, sigma_m**2, 0.02**2]))


def row(num=6, y=4.0):
    return np.array([[2.5 * k, y, np.pi / 2] for k in range(num)])


def run(num_frames=12, sigma_m=0.05, miss=0.2, seed=0, gone_from=None):
    """A row of slots passed by; slot 2 is gone from a frame on."""
    rng, tracker = np.random.default_rng(seed), Tracker(SlotTrack)
    for frame in range(num_frames):
        shown = [k for k in range(6) if rng.uniform() > miss and not (k == 2 and frame >= (gone_from or 1e9))]
        slots = [sight(row()[k] + rng.normal(size=3) * [sigma_m, sigma_m, 0.02], sigma_m) for k in shown]
        rng.shuffle(slots)
        tracker.step(slots, 0.2 * frame, 0.5 * frame, np.ones(len(tracker.tracks), bool))
    return tracker


def test_every_slot_becomes_one_track_and_is_more_exact_than_a_sight():
    off = []
    for seed in range(5):
        final = run(seed=seed).final()
        assert len(final) == 6
        found = np.array(sorted((t.pose for t in final), key=lambda p: p[0]))
        off.append(np.abs(found - row())[:, :2])
        assert all(t.existence > 0.95 for t in final)
    # Ten sights of 5 cm each: the mean error of one is 4 cm, of the mean of ten 1.3 cm.
    assert np.mean(off) < 0.018


def test_what_is_seen_once_is_not_confirmed_and_what_is_gone_ends():
    tracker = run(miss=0.0)
    tracker.step([sight([30.0, 4.0, np.pi / 2])], 9.0, 9.0, np.ones(len(tracker.tracks), bool))
    assert len(tracker.final()) == 6
    assert 2.5 * 2 not in {round(float(t.pose[0]), 0) for t in run(miss=0.0, num_frames=14, gone_from=8).tracks}
    # A slot that nobody can see is not missed.
    tracker = run(miss=0.0, num_frames=6)
    for frame in range(20):
        tracker.step([], 2.0 + frame, 3.0, np.zeros(len(tracker.tracks), bool))
    assert len(tracker.tracks) == 6


def test_a_sight_beyond_the_gate_or_of_another_kind_is_another_slot():
    tracker, config = run(miss=0.0, num_frames=5), ObjectTrackConfig()
    tracks = sorted(tracker.tracks, key=lambda t: t.pose[0])
    near, far = sight(row()[0] + [0.1, 0.0, 0.0]), sight(row()[0] + [0.0, 0.6, 0.0])
    assert associated(tracks, [near], config) == {0: 0}
    assert associated(tracks, [far], config) == {}
    assert associated(tracks, [replace(near, kind="parallel")], config) == {}
    # One to one: of two sights of one slot the nearer one.
    assert associated(tracks, [sight(row()[1] + [0.15, 0.0, 0.0]), sight(row()[1] + [0.02, 0.0, 0.0])], config) == {
        1: 1
    }


def test_far_and_wild_sights_hardly_count():
    config = ObjectTrackConfig(drift_share=0.0)
    near = [(sight([0.01 * (-1) ** k, 0.0, 0.0], 0.03), 0.0) for k in range(6)]
    far = [(sight([0.3, 0.3, 0.0], 0.3), 0.0)] * 2
    wild = [(sight([0.9, -0.9, 0.0], 0.03), 0.0)]
    pose, covariance = fused(near + far + wild, 0.0, config)
    assert np.hypot(*pose[:2]) < 0.02
    assert 0.01 < np.sqrt(covariance[0, 0]) < 0.1


def element(corners, kind):
    return MapElement(
        "s", ElementClass.PARKING_SLOT, np.column_stack([corners, np.zeros(4)]), closed=True, attributes={"kind": kind}
    )


def test_an_end_that_was_missed_is_moved_to_the_line_of_its_row():
    whole = element([[2.5, 0.0], [0.0, 0.0], [0.0, 5.0], [2.5, 5.0]], "perpendicular")
    short = element([[5.0, 0.6], [2.5, 0.0], [2.5, 5.0], [5.0, 5.6]], "perpendicular")
    _, moved = in_rows([whole, short])
    np.testing.assert_allclose(moved, [[5.0, 0.0], [2.5, 0.0]], atol=1e-9)
    askew = replace(short, attributes={"kind": "angled"})
    np.testing.assert_allclose(in_rows([whole, askew])[1], short.points[:2, :2])


def test_a_slot_that_only_looks_askew_is_told_by_the_bar_at_its_entrance():
    askew = element([[2.6, 0.9], [0.0, 0.0], [0.0, 5.0], [2.6, 5.9]], "angled")
    bar = MapElement("b", ElementClass.SLOT_LINE, np.array([[-0.7, 0.0, 0.0], [0.7, 0.0, 0.0]]))
    assert upright([askew], [bar], SlotConfig())[0].attributes["kind"] == "perpendicular"
    assert upright([askew], [], SlotConfig())[0].attributes["kind"] == "angled"
    leaning = bar.with_points(np.array([[-0.66, -0.228, 0.0], [0.66, 0.228, 0.0]]))
    assert upright([askew], [leaning], SlotConfig())[0].attributes["kind"] == "angled"


def test_of_two_slots_in_one_place_the_one_seen_more_stays():
    """A missed divider makes one long slot of two; seen in three of ten frames it is none."""
    tracker = Tracker(SlotTrack)
    for frame in range(10):
        slots = [sight(pose) for pose in row(4)]
        if frame < 3:
            slots.append(replace(sight([1.25, 4.0, np.pi / 2], kind="parallel"), width_m=5.0, depth_m=2.2))
        tracker.step(slots, 0.2 * frame, 0.5 * frame, np.zeros(len(tracker.tracks), bool))
    assert sum(t.confirmed for t in tracker.tracks) == 5
    assert sorted(round(float(t.pose[0]), 1) for t in tracker.final()) == [0.0, 2.5, 5.0, 7.5]


def test_slots_side_by_side_at_an_angle_are_all_kept():
    """At 45 deg an entrance of 3.5 m leaves 2.5 m from side to side."""
    tracker, turn = Tracker(SlotTrack), np.deg2rad(135.0)
    slots = [
        replace(sight([3.5 * k, 4.0, turn], kind="angled"), width_m=3.5, skew_rad=float(np.deg2rad(45.0)))
        for k in range(4)
    ]
    for frame in range(4):
        tracker.step(slots, 0.2 * frame, 0.5 * frame, np.zeros(len(tracker.tracks), bool))
    assert len(tracker.final()) == 4
