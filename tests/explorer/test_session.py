"""What is told about a pose is true: by the landscape, by the masks themselves, by the truth of the drive."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from semloc_jax.analysis.landscape import frame_landscape
from semloc_jax.errors import SemlocError
from semloc_jax.explorer import Placement
from semloc_jax.explorer.messages import PoseQuery


def _query(session, level=1, **changes):
    return PoseQuery(session.start(), level, session.channel_names, **changes)


def _off(placement, forward_m=0.0, left_m=0.0, yaw_deg=0.0):
    c, s = np.cos(np.deg2rad(placement.yaw_deg)), np.sin(np.deg2rad(placement.yaw_deg))
    return replace(
        placement,
        x_m=placement.x_m + c * forward_m - s * left_m,
        y_m=placement.y_m + s * forward_m + c * left_m,
        yaw_deg=placement.yaw_deg + yaw_deg,
    )


@pytest.mark.parametrize("level", [0, 2])
def test_slices_are_those_of_the_landscape(session, level):
    head, arrays = session.answer(_query(session, level, with_path=False))
    frame = session.frame
    rig = session.masks.seen_by(session.drive.frames[1].rig.select(session.masks.cameras))
    x, y = (np.linspace(-1, 1, head["side"]) * head["extent"][name] for name in ("x", "y"))
    costs = frame_landscape(session.localizer, frame.masks, rig, frame.T_map_truth, ("x", "y"), x, y, level)
    np.testing.assert_allclose(arrays["slice_xy"], costs["all"], atol=2e-3)
    assert np.ptp(costs["all"]) > 0.3
    middle = head["side"] // 2
    assert head["cost"] == pytest.approx(costs["all"][middle, middle], abs=2e-3)
    by_name = {fit["name"]: fit["cost"] for fit in head["channels"]}
    for name in costs.keys() - {"all"}:
        if np.isfinite(costs[name][middle, middle]):
            assert by_name[name] == pytest.approx(costs[name][middle, middle], abs=2e-3)


def test_curves_and_slices_cross_where_they_should(session):
    head, arrays = session.answer(_query(session, with_path=False))
    middle, half = head["side"] // 2, arrays["curves"].shape[1] // 2
    for row, along in ((0, arrays["slice_xy"][:, middle]), (1, arrays["slice_xy"][middle])):
        assert arrays["curves"][row, [0, half, -1]] == pytest.approx(along[[0, middle, -1]], abs=1e-5)
    assert arrays["curves"][5, [0, -1]] == pytest.approx(arrays["slice_xyaw"][middle][[0, -1]], abs=1e-5)


def test_residuals_are_the_distances_to_the_borders_of_the_masks(session):
    """By OpenCV's distance transform of the mask of each class, at the pixels that the page draws."""
    level = 1
    placement = _off(session.start(), 0.2, 0.1, 0.3)
    head, arrays = session.answer(PoseQuery(placement, level, session.channel_names, "none", with_path=False))
    assert "slice_xy" not in arrays and "side" not in head
    ramp_px = session.config.cost_maps.ramp_px[level]
    mask, checked = session.frame.masks[0], 0
    for index, channel in enumerate(session.localizer.shown.channels):
        inside = np.isin(mask, channel.mask_ids).astype(np.uint8)
        if inside.min() == inside.max():
            continue
        outer, inner = (
            cv2.distanceTransform(part, cv2.DIST_L2, cv2.DIST_MASK_PRECISE) for part in (1 - inside, inside)
        )
        distance_px = np.where(inside, 0.5 - inner, outer - 0.5)
        chosen = (arrays["weight"][0] > 0) & (arrays["channel"][0] == index)
        u, v = np.round(arrays["uv"][0][chosen]).astype(int).T
        expected = np.clip(distance_px[v, u], -ramp_px, ramp_px)
        found = ramp_px * arrays["residual"][0][chosen]
        # Rounding to a pixel leaves half a pixel; corners and thin bars are smoothed by the ramps besides.
        error_px = np.abs(found - expected)
        assert np.median(error_px) < 1.0 and error_px.max() < 2.5, channel.name
        checked += chosen.sum()
    assert checked > 200


def test_a_solve_ends_at_the_truth_and_its_path_says_so(session):
    start = _off(session.start(), 0.8, -0.4, 1.0)
    head, _ = session.answer(replace(_query(session), placement=start))
    assert np.hypot(*head["to_truth"][:2]) == pytest.approx(np.hypot(0.8, 0.4), abs=0.02)
    path = head["path"]
    end, truth = path["end"], session.start()
    assert np.hypot(end["x_m"] - truth.x_m, end["y_m"] - truth.y_m) < 0.05
    assert abs(end["yaw_deg"] - truth.yaw_deg) < 0.1
    assert path["status"] == "CONVERGED"
    np.testing.assert_allclose(path["steps"][0]["xi"], 0.0, atol=1e-3)
    # The last step, as a tangent of the start, leads to the end: in the plane, by hand.
    last = [step for step in path["steps"] if step["accepted"]][-1]
    led = _off(start, *last["xi"][:2], last["xi"][5])
    assert np.hypot(led.x_m - last["xy"][0], led.y_m - last["xy"][1]) < 0.02
    assert led.yaw_deg == pytest.approx(last["yaw_deg"], abs=0.02)
    levels = [step["level"] for step in path["steps"] if step["stage"] == "coarse"]
    assert levels == sorted(levels) and set(levels) == {0, 1, 2, 3}
    for level in set(levels):
        costs = [s["cost"] for s in path["steps"] if s["accepted"] and (s["stage"], s["level"]) == ("coarse", level)]
        assert costs == sorted(costs, reverse=True)


def test_a_class_that_is_switched_off_does_not_count(session):
    only = replace(_query(session), channels=("lane_marking",), with_path=False)
    head, arrays = session.answer(only)
    index = session.channel_names.index("lane_marking")
    assert (arrays["in_view"][arrays["channel"] != index] == 0).all()
    assert (arrays["in_view"][arrays["channel"] == index] > 0).sum() > 50
    fit = next(fit for fit in head["channels"] if fit["name"] == "lane_marking")
    assert head["cost"] == pytest.approx(fit["cost"], abs=1e-5)
    # Lane lines alone hold the car across the road better than along it.
    sigma = np.sqrt(np.diagonal(head["covariance"]))
    assert sigma[0] > 2 * sigma[1]


def test_answers_do_not_depend_on_what_was_asked_before(session):
    far = replace(_query(session), placement=_off(session.start(), -18.0, 0.5))
    first = session.answer(far)[0]["cost"]
    for distance_m in (0.0, 9.0, -30.0):
        session.answer(replace(far, placement=_off(session.start(), distance_m)))
    assert session.answer(far)[0]["cost"] == pytest.approx(first, abs=1e-6)
    assert len(session.frame.cells) >= 2


def test_other_frames_and_places_without_road(session):
    at_one = session.start()
    session.open_frame(2)
    assert session.scene()["frame"] == 2
    assert np.hypot(session.start().x_m - at_one.x_m, session.start().y_m - at_one.y_m) > 1.0
    assert session.answer(_query(session))[0]["cost"] < 0.3
    with pytest.raises(SemlocError, match="no ground of the map within 60 m"):
        session.answer(replace(_query(session), placement=Placement(5e4, 0.0, 0.0)))
