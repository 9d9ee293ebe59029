"""Poses and gradients from arrays alone: where they are, what is refused, and that nothing is ever silently NaN."""

import cv2
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import semloc_jax as sj
from semloc_jax.errors import SemlocError
from semloc_jax.geometry import rigid

pytestmark = pytest.mark.usefixtures("single_precision")
K = [[400, 0, 319.5], [0, 400, 199.5], [0, 0, 1]]
CLASSES = {10: "lane_marking", 12: "stop_line"}
TRUTH, GUESS = sj.planar_pose(2.0, 0.1, 0.01), sj.planar_pose(2.6, -0.2)
LINES = (
    ("lane_marking", [[0, 2, 0], [30, 2, 0]]),
    ("lane_marking", [[0, -2, 0], [30, -2, 0]]),
    ("stop_line", [[14, -1.9, 0], [14, 1.9, 0]]),
)


@pytest.fixture(scope="module")
def street():
    return sj.map_from_arrays(LINES)


@pytest.fixture(scope="module")
def rig():
    return sj.Rig([sj.camera_from_K(K, (640, 400))], [sj.mounted((1.6, 0.0, 1.4), down_deg=4.0)], ["front"])


@pytest.fixture(scope="module")
def mask(street, rig):
    return sj.render_masks(street, rig, TRUTH)[0]


def test_a_camera_alone_is_found_where_it_is(street, rig, mask):
    """Without a vehicle the pose is that of the lens itself, with axes forward, left, up."""
    forward = rig.T_base_cam[0] @ rigid.inverse(sj.mounted((0.0, 0.0, 0.0)))
    found = sj.align(mask, rig.cameras[0], street, GUESS @ forward, classes=CLASSES)
    step = rigid.log(rigid.inverse(TRUTH @ forward) @ found.T_map_base)
    sigma = np.sqrt(np.diagonal(found.covariance))
    assert (np.abs(step) < 3.0 * sigma).all() and sigma[1] < 0.1 and np.degrees(abs(step[5])) < 0.3
    assert np.isfinite(found.covariance).all() and found.T_map_base.dtype == np.float64


def test_a_place_along_two_lines_is_not_told_for_sure(street, rig):
    """Lines alone do not say where along them: from wherever it starts, the pose says so and keeps the prior's 1 m."""
    lines = sj.map_from_arrays([("lane_marking", [[-60, y, 0], [120, y, 0]]) for y in (-2, 2)])
    mask = sj.render_masks(lines, rig, TRUTH)[0]
    for ahead_m, left_m, turned_rad in ((-1.3, 0.4, -0.01), (0.4, -0.2, 0.02), (1.4, 0.1, 0.0), (-2.3, 0.0, 0.01)):
        guess = TRUTH @ sj.planar_pose(ahead_m, left_m, turned_rad)
        found = sj.align(mask, rig, lines, guess, classes=CLASSES)
        sigma = np.sqrt(np.diagonal(found.covariance))
        assert sj.SolveStatus(found.status) == sj.SolveStatus.WEAK_DIRECTION and "across" in found.held
        assert "along" not in found.held and sigma[0] > 0.8 and sigma[1] < 0.05
        assert abs(found.T_map_base[0, 3] - TRUTH[0, 3]) < 3.0 * sigma[0]


@jax.jit
def slopes(scene, prior, T_start):
    """Derivatives of all six directions at once by every number of scene and prior."""

    def moved(numbers):
        return jnp.sum(sj.align_differentiable(T_start, *numbers).tangent() * jnp.arange(1.0, 7.0))

    return jax.grad(moved, allow_int=True)((scene, prior))


@pytest.mark.parametrize("kind", ["as it is", "nothing is seen", "locked", "pole under the lens"])
def test_every_leaf_has_a_finite_derivative(street, rig, mask, kind):
    world, sigma = street, (1.0, 1.0, 0.03, 0.01, 0.01, 0.05)
    if kind == "nothing is seen":
        mask = np.zeros_like(mask)
    if kind == "locked":
        sigma = (1.0, 1.0, 0.0, 0.0, 0.0, 0.05)
    if kind == "pole under the lens":
        world = sj.map_from_arrays([*LINES[:2], ("stop_line", [[3.6, -1.0, 0], [3.6, 1.0, 0]])])
    scene, prior, T_start, _ = sj.differentiable_scene(mask, rig, world, GUESS, classes=CLASSES, sigma=sigma)
    found = jax.tree.leaves(slopes(scene, prior, T_start))
    numbers = [leaf for leaf in found if jnp.issubdtype(leaf.dtype, jnp.floating)]
    assert len(numbers) >= 14 and all(np.isfinite(leaf).all() for leaf in numbers)
    by_scene, by_prior = slopes(scene, prior, T_start)
    assert float(jnp.abs(by_prior.T_local_base).max()) > 0
    seen = float(jnp.abs(by_scene.maps.distance_px).max()), float(jnp.abs(by_scene.views[0].p_map).max())
    assert min(seen) > 0 if kind in ("as it is", "locked") else max(seen) >= 0


def test_what_has_no_derivative_says_so_and_names_what_has():
    told = r"has no derivative.*differentiable=True"
    T, texels = jnp.eye(4), jnp.ones((1, 1, 8, 8))

    def packed(ramp):
        from semloc_jax.residuals.texture import pack

        maps = sj.CostMaps((ramp,), (8.0,), (1,), jnp.ones((1, 4, 4), bool), 2)
        return pack(maps).ramp_px[0]

    def kernel(T):
        from semloc_jax.residuals.native_kernels import damped_step

        return damped_step(jnp.eye(6), T[0, 3] * jnp.ones(6), jnp.ones(()))[0]

    for function, argument in ((packed, texels), (kernel, T)):
        with pytest.raises(SemlocError, match=told):
            jax.grad(function)(argument)


def test_derivatives_by_masks_are_refused_with_the_way_to_their_ramps(street, rig, mask):
    def loss(mask):
        return sj.align(mask, rig, street, GUESS, classes=CLASSES, differentiable=True).tangent()[0]

    with pytest.raises(SemlocError, match=r"masks: given traced.*maps\.distance_px"):
        jax.grad(loss)(mask.astype(np.float32))


def test_a_guess_that_jit_hides_is_refused(street, rig, mask):
    with pytest.raises(SemlocError, match="prior: traced by jit"):
        jax.jit(lambda T: sj.align(mask, rig, street, T, classes=CLASSES, differentiable=True).tangent())(GUESS)


@pytest.mark.parametrize(
    ("change", "told"),
    [
        (
            {"masks": np.zeros((10, 10), np.uint8)},
            r"mask of camera 'front': given uint8\[10, 10\]; expected.*\[400 640\]",
        ),
        ({"masks": []}, "given 0 for 1 cameras"),
        ({"prior": np.eye(3)}, r"given shape \(3, 3\); expected a pose"),
        ({"prior": np.full((4, 4), np.nan)}, "expected a finite rigid motion"),
        ({"classes": {1: "lane"}}, "unknown map class 'lane'"),
        ({"classes": {"a": "pole"}}, "mask id 'a'; expected a whole number"),
        ({"classes": {1: "pole"}}, "its classes .* are not in class table"),
        ({"sigma": (1.0, 1.0)}, "sigma: shape"),
    ],
)
def test_wrong_arrays_are_named(street, rig, mask, change, told):
    given = {"masks": mask, "cameras": rig, "semantic_map": street, "prior": GUESS, "classes": CLASSES} | change
    with pytest.raises(SemlocError, match=told):
        sj.align(**given)


def test_a_prior_on_the_road_needs_to_know_where_the_camera_sits(street, rig, mask):
    with pytest.raises(SemlocError, match="where the camera sits above it is not known"):
        sj.align(mask, rig.cameras[0], street, sj.PosePrior(2.0, 0.0, 0.0, 1.0, 0.05), classes=CLASSES)


def test_map_coordinates_too_large_for_a_differentiable_pose_are_refused(rig, mask):
    far = np.array([500_000.0, 5_400_000.0, 0.0])
    street = sj.map_from_arrays([(label, np.array(points) + far) for label, points in LINES])
    guess = GUESS.copy()
    guess[:3, 3] += far
    with pytest.raises(SemlocError, match="float32 is too coarse for a differentiable pose and for terms"):
        sj.align(mask, rig, street, guess, classes=CLASSES, differentiable=True)
    found = sj.align(mask, rig, street, guess, classes=CLASSES)
    assert np.hypot(*(found.T_map_base[:2, 3] - far[:2] - TRUTH[:2, 3])) < 0.1


def test_arrays_that_are_no_map_are_named():
    for lines, told in (
        ([], "given no lines"),
        ([("lane", [[0, 0], [1, 0]])], "unknown class 'lane'"),
        ([("pole", [[0, 0, 3], [0, 0, 0]])], "expected base and top"),
        ([("lane_marking", [[0, 0]])], r"points of shape \(1, 2\)"),
        ([("lane_marking", [[0, 0], [1, 0]], {"widht_m": 1})], "widht_m"),
        (["lane_marking"], r"expected \(class, points\)"),
    ):
        with pytest.raises(SemlocError, match=told):
            sj.map_from_arrays(lines)


def test_camera_matrices_that_are_none_are_named():
    for arguments, told in (
        (([[400, 1, 0], [0, 400, 0], [0, 0, 1]], (640, 400)), "no skew"),
        ((K, (640, 400), (1, 2, 3)), "expected 4, 5, 8, 12 or 14"),
        ((K, (640, 400), (0.1, 0, 0, 0), "warped"), "'warped' is not supported"),
        ((K, (640.5, 400)), "whole pixels"),
    ):
        with pytest.raises(SemlocError, match=told):
            sj.camera_from_K(*arguments)


def test_a_differentiable_pose_is_at_its_optimum_for_every_focal_length(rig):
    """Masks half a pixel too wide, as polygons are filled, make the cost a long valley: 27 steps for one of these."""
    street = sj.map_from_arrays([*LINES[:2], (*LINES[2], {"width_m": 0.3})])
    T_cam_map = np.linalg.inv(sj.planar_pose(2.0, 0.0) @ rig.T_base_cam[0])
    mask = np.zeros((400, 640), np.uint8)
    for label, (x0, x1), y, half_m in (
        (10, (4.5, 30), 2, 0.06),
        (10, (4.5, 30), -2, 0.06),
        (12, (13.85, 14.15), 0, 1.9),
    ):
        corners = np.array([(x0, y - half_m), (x1, y - half_m), (x1, y + half_m), (x0, y + half_m)])
        p_cam = np.column_stack([corners, np.zeros(4)]) @ T_cam_map[:3, :3].T + T_cam_map[:3, 3]
        uv = 400.0 * p_cam[:, :2] / p_cam[:, 2:] + (319.5, 199.5)
        cv2.fillPoly(mask, [np.round(256 * uv).astype(np.int32)], label, shift=8)
    for focal_px in (399.9, 400.0, 401.0):
        camera = sj.camera_from_K([[focal_px, 0, 319.5], [0, focal_px, 199.5], [0, 0, 1]], (640, 400))
        own = sj.Rig([camera], rig.T_base_cam, rig.names)
        scene, prior, T_start, _ = sj.differentiable_scene(mask, own, street, GUESS, classes=CLASSES)
        found = sj.align_differentiable(T_start, scene, prior)
        assert sj.SolveStatus(int(found.status)) == sj.SolveStatus.CONVERGED
