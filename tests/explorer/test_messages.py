"""What the page may ask, and how numbers travel to it."""

import json

import numpy as np
import pytest

from semloc_jax.errors import SemlocError
from semloc_jax.explorer.messages import packed, read_frame_index, read_query

POSE = {"x_m": 1.0, "y_m": -2.0, "yaw_deg": 30.0}
NAMES = ("lane_marking", "pole")


def test_a_query_with_its_defaults():
    query = read_query({"pose": POSE, "level": 2}, 4, NAMES)
    assert vars(query.placement) == {**POSE, "height_m": 0.0, "roll_deg": 0.0, "pitch_deg": 0.0}
    assert (query.level, query.channels, query.grid, query.with_path, query.prior) == (
        2,
        NAMES,
        "coarse",
        True,
        "start",
    )


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ([], "got list; expected a JSON object"),
        ({"level": 0}, "no 'pose'"),
        ({"pose": POSE}, "level None; expected 0 (coarse) to 3"),
        ({"pose": POSE, "level": 4}, "level 4; expected 0 (coarse) to 3"),
        ({"pose": POSE, "level": True}, "level True"),
        ({"pose": {"x_m": 1.0}, "level": 0}, "y_m None; expected a number"),
        ({"pose": POSE | {"x_m": float("nan")}, "level": 0}, "x_m nan"),
        ({"pose": POSE | {"y_m": float("inf")}, "level": 0}, "y_m inf"),
        ({"pose": POSE | {"x_m": 10**400}, "level": 0}, "expected a number from -1e+07 to 1e+07"),
        ({"pose": POSE | {"yaw_deg": "30"}, "level": 0}, "yaw_deg 30; expected a number"),
        ({"pose": POSE | {"height_m": 9.0}, "level": 0}, "height_m 9.0; expected a number from -5 to 5"),
        ({"pose": POSE, "level": 0, "channels": ["tree"]}, "no channel 'tree'; expected some of lane_marking, pole"),
        ({"pose": POSE, "level": 0, "channels": "pole"}, "must be a list"),
        ({"pose": POSE, "level": 0, "grid": "huge"}, "expected one of coarse, fine, none"),
        ({"pose": POSE, "level": 0, "grid": ["fine"]}, "expected one of coarse, fine, none"),
        ({"pose": POSE, "level": 0, "zoom": 0}, "expected a number from 0.0625 to 16"),
        ({"pose": POSE, "level": 0, "path": 1}, "expected true or false"),
    ],
)
def test_bad_queries_are_told_what_was_expected(content, words):
    with pytest.raises(SemlocError, match=".") as told:
        read_query(content, 4, NAMES)
    assert words in str(told.value)


@pytest.mark.parametrize("content", [{}, [], {"index": -1}, {"index": 3}, {"index": 1.0}, {"index": True}])
def test_frames_that_are_not_there(content):
    with pytest.raises(SemlocError, match="expected an index from 0 to 2"):
        read_frame_index(content, 3)


def test_arrays_arrive_as_they_were_sent():
    sent = {
        "uv": np.random.default_rng(0).normal(size=(2, 5, 2)).astype(np.float32),
        "channel": np.arange(7, dtype=np.uint8),
        "cost": np.array([0.5, np.nan], np.float32),
    }
    raw = packed({"sigma": float("inf"), "n": np.float32(2), "xy": np.array([1.0, np.nan])}, sent)
    length = int.from_bytes(raw[:4], "little")
    head = json.loads(raw[4 : 4 + length])
    assert (head["sigma"], head["n"], head["xy"]) == (None, 2.0, [1.0, None])
    for name, array in sent.items():
        place = head["arrays"][name]
        start = 4 + length + place["offset"]
        assert start % 4 == 0
        found = np.frombuffer(raw, place["dtype"], array.size, start).reshape(place["shape"])
        np.testing.assert_array_equal(found, array)
