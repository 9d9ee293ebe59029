"""What every camera promises, whatever its model: one contract, each camera held to it."""

import cv2
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from semloc_jax.cameras import (
    BevCamera,
    BrownConradyCamera,
    CylindricalCamera,
    DoubleSphereCamera,
    KannalaBrandtCamera,
    PinholeCamera,
    PolynomialFisheyeCamera,
    Rig,
    stack_cameras,
)
from semloc_jax.cameras.base import as_leaf
from semloc_jax.cameras.io import read_calibration, write_calibration
from semloc_jax.cameras.models import MODELS, model_of
from semloc_jax.errors import SemlocError
from tests.compiling import jit_quickly

FRONT = (742.3, 743.1, 476.4, 291.7, 960, 600)
SIDE = (196.1, 196.3, 318.6, 240.6, 640, 480)
CAMERAS = {
    "pinhole": PinholeCamera(*FRONT),
    "radtan": BrownConradyCamera(*FRONT, -0.118, 0.042, 0.0006, -0.0004),
    "radtan_k3": BrownConradyCamera(*FRONT, -0.21, 0.09, -0.002, 0.003, 0.02),
    "radtan_that_turns": BrownConradyCamera(500.0, 500.0, 480.0, 300.0, 960, 600, -0.3, 0.02),
    "fisheye": KannalaBrandtCamera(*SIDE, -0.013, -0.0042, 0.0011, -0.0002),
    "fisheye_that_turns": KannalaBrandtCamera(303.3, 322.3, 486.5, 323.9, 960, 640, -0.0355, -0.0198, 0.0261, -0.00972),
    "angle_polynomial": PolynomialFisheyeCamera(*SIDE, 0.05, -0.09, -0.01),
    "double_sphere": DoubleSphereCamera(*SIDE, -0.18, 0.59),
    "double_sphere_that_turns": DoubleSphereCamera(300.0, 301.0, 318.6, 240.6, 640, 480, -0.3, 0.8),
    "cylinder": CylindricalCamera(150.0, 479.5, 120.0, 960, 400, fy=170.0),
    "bev": BevCamera.covering(12.0, 6.0, 7.0, 7.0, 0.02),
}
"""At least one example of every model; a new model adds its own here, and the lists below follow."""
# A cylinder sees all around it and a top view sees from all heights: neither has an axis that pixels move away from.
BEHIND = [name for name, camera in CAMERAS.items() if not isinstance(camera, BevCamera | CylindricalCamera)]
WIDE = [name for name in BEHIND if hasattr(CAMERAS[name], "max_theta_rad")]
PERSPECTIVE = [name for name in BEHIND if name not in WIDE]
IN_OPENCV = [name for name in BEHIND if type(CAMERAS[name]) in (PinholeCamera, BrownConradyCamera, KannalaBrandtCamera)]


@pytest.fixture(params=CAMERAS, ids=str)
def camera(request):
    return CAMERAS[request.param]


def pixels(camera, step=37):
    """A grid over the whole image, border pixels included."""
    width, height = camera.resolution
    grid = np.meshgrid(np.linspace(0, width - 1, width // step), np.linspace(0, height - 1, height // step))
    return np.stack(grid, axis=-1).reshape(-1, 2)


def points_in_view(camera, num=200, seed=0):
    """Points that the camera sees, 0.5 to 60 m along random lines of sight (on the road for a top view)."""
    rng = np.random.default_rng(seed)
    width, height = camera.resolution
    uv = rng.uniform([0, 0], [width - 1, height - 1], (num, 2))
    ray, valid = (np.asarray(a) for a in camera.unproject(uv))
    if isinstance(camera, BevCamera):
        return ray + rng.uniform([0, 0, -0.2], [0, 0, 0.2], ray.shape)
    return ray[valid] * rng.uniform(0.5, 60.0, (valid.sum(), 1))


def points_anywhere(num=400, seed=1):
    """Points all around the camera, also behind it and far outside the view."""
    return np.random.default_rng(seed).normal(size=(num, 3)) * 8.0


def K_of(camera):
    return np.array([[camera.fx, 0, camera.cx], [0, camera.fy, camera.cy], [0, 0, 1]], dtype=float)


def opencv(camera, p_cam):
    """Pixels of cv2 and its Jacobian with respect to the point [n 2 3]."""
    zero, K = np.zeros(3), K_of(camera)
    if isinstance(camera, KannalaBrandtCamera):
        D = np.array([camera.k1, camera.k2, camera.k3, camera.k4], dtype=float)
        uv, jacobian = cv2.fisheye.projectPoints(p_cam[:, None], zero, zero, K, D)
        return uv[:, 0], jacobian[:, 11:14].reshape(-1, 2, 3)
    names = ("k1", "k2", "p1", "p2", "k3") if isinstance(camera, BrownConradyCamera) else ()
    D = np.array([getattr(camera, name) for name in names], dtype=float)
    uv, jacobian = cv2.projectPoints(p_cam[:, None], zero, zero, K, D)
    return uv[:, 0], jacobian[:, 3:6].reshape(-1, 2, 3)


def jacobian_of(camera, p_cam):
    """d uv / d p_cam [n 2 3] by forward mode."""
    return np.asarray(_jacobian(camera, p_cam))


@jit_quickly
def _jacobian(camera, p_cam):
    return jax.vmap(jax.jacfwd(lambda p: camera.project(p)[0]))(p_cam)


projected = jit_quickly(lambda camera, p_cam: camera.project(p_cam))
"""Pixels of points: one program for each model and number of points, where single operations would be a hundred."""


def all_gradients(camera, x, y, z):
    """u, v and, by one pull-back of ones each, all six derivatives: the way the solver asks for them."""

    def pull(which):
        value, back = jax.vjp(lambda *p: camera.project_xyz(*p)[which], x, y, z)
        return [value, *back(jnp.ones_like(value))]

    return jnp.stack(pull(0) + pull(1))


compiled_gradients = jit_quickly(all_gradients)


def test_every_model_is_held_to_the_contract():
    """A row without an example would be a camera that nobody has tried."""
    assert {type(camera) for camera in CAMERAS.values()} == {model.camera for model in MODELS}


def test_every_limit_of_the_view_is_written(camera):
    """A field that is neither a pixel number nor in the row would be lost between writer and reader."""
    model = model_of(camera)
    pixel_fields = ("fx", "fy", "cx", "cy", "width", "height")
    assert set(vars(camera)) == {*pixel_fields, *model.leading, *model.coefficients, *model.limits}


def test_a_written_calibration_gives_the_same_pixels(camera, tmp_path):
    """Also of a camera that was shifted, cropped and resized unevenly, and with a narrower view than by default."""
    model, p_cam = model_of(camera), np.concatenate([points_in_view(camera), points_anywhere()])
    narrow = camera
    for limit in model.limits:
        value = as_leaf(0.9 * getattr(camera, limit))
        narrow = eqx.tree_at(lambda c, limit=limit: getattr(c, limit), narrow, value)
    width, height = camera.resolution
    variants = [camera, camera.shifted(0.45, -0.5), camera.cropped(10, 20, 300, 200), narrow]
    variants.append(camera.resized(width // 2, height // 4))
    names = [f"camera_{k}" for k in range(len(variants))]
    rig = Rig(variants, np.tile(np.eye(4), (len(variants), 1, 1)), names)
    write_calibration(rig, tmp_path / "calib.yaml")
    again = read_calibration(tmp_path / "calib.yaml")
    assert again.names == rig.names
    for before, after in zip(rig.cameras, again.cameras, strict=True):
        assert type(after) is type(before) and after.resolution == before.resolution
        (uv, valid), (uv_again, valid_again) = projected(before, p_cam), projected(after, p_cam)
        assert np.abs(np.asarray(uv_again) - np.asarray(uv)).max() < 1e-6
        np.testing.assert_array_equal(valid_again, valid)


def test_a_model_without_a_row_is_refused(tmp_path):
    """It was written as a pinhole without distortion, 14 px off."""

    class OwnCamera(BrownConradyCamera):
        """May project as it likes."""

    rig = Rig([OwnCamera(*FRONT, -0.118, 0.042)], np.eye(4)[None], ["own"])
    with pytest.raises(SemlocError, match=r"own: .* no name for OwnCamera; expected one of PinholeCamera, .*row"):
        write_calibration(rig, tmp_path / "calib.yaml")
    assert not (tmp_path / "calib.yaml").exists()


def test_project_undoes_unproject(camera):
    uv = pixels(camera)
    ray, valid = camera.unproject(uv)
    again, seen = projected(camera, ray)
    assert np.mean(valid) > 0.6
    assert np.array_equal(valid, seen & valid)
    assert np.abs(np.asarray(again) - uv)[np.asarray(valid)].max() < 1e-8


def test_unproject_gives_the_line_of_sight(camera):
    p_cam = points_in_view(camera)
    uv, _ = projected(camera, p_cam)
    ray, valid = (np.asarray(a) for a in camera.unproject(uv))
    assert valid.all()
    if isinstance(camera, BevCamera):
        assert np.allclose(ray, p_cam * [1, 1, 0], atol=1e-12)
    else:
        assert np.linalg.norm(ray, axis=1) == pytest.approx(1.0, abs=1e-9)
        assert np.cross(ray, p_cam / np.linalg.norm(p_cam, axis=1, keepdims=True)) == pytest.approx(0.0, abs=1e-9)


def test_derivatives_are_finite_differences(camera):
    p_cam = points_anywhere()
    steps = 1e-6 * np.eye(3)
    ahead = np.stack([projected(camera, p_cam + step)[0] for step in steps], axis=-1)
    behind = np.stack([projected(camera, p_cam - step)[0] for step in steps], axis=-1)
    numeric, exact = (ahead - behind) / 2e-6, jacobian_of(camera, p_cam)
    x, y, z = p_cam.T
    # The seam of a cylinder and the axis behind a fisheye have no derivative, the lens plane one on each side.
    smooth = (np.hypot(x, y) > 0.05) & ((z > 0) | (np.abs(x) > 1e-4)) & (np.abs(z - 0.01) > 1e-4)
    error = np.abs(numeric - exact).max(axis=(1, 2)) / np.abs(exact).max(axis=(1, 2))
    assert smooth.mean() > 0.98
    assert error[smooth].max() < 1e-6


def test_one_pull_back_gives_every_points_jacobian(camera):
    p_cam = points_anywhere()
    gradients = compiled_gradients(camera, *p_cam.T)
    jacobian = jacobian_of(camera, p_cam)
    assert np.allclose(gradients[1:4].T, jacobian[:, 0], rtol=1e-12)
    assert np.allclose(gradients[5:8].T, jacobian[:, 1], rtol=1e-12)


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_values_and_gradients_are_finite_everywhere(camera, dtype):
    special = [-1e4, -1.0, -1e-3, -1e-20, 0.0, 1e-20, 1e-8, 1e-3, 1e-2, 1.0, 1e4]
    x, y, z = np.stack(np.meshgrid(special, special, special)).reshape(3, -1).astype(dtype)
    gradients = np.asarray(compiled_gradients(camera, x, y, z))
    assert np.isfinite(gradients).all()
    # A solver sums squares of them with weight zero.
    assert np.isfinite(np.square(gradients).sum(axis=1)).all()


@pytest.mark.parametrize("name", BEHIND)
def test_points_behind_are_not_valid(name):
    p_cam = points_anywhere()
    assert not np.any(projected(CAMERAS[name], np.array([[0.0, 0.0, -5.0], [0.1, 0.1, -5.0], [0.0, 0.0, 0.0]]))[1][:2])
    behind = p_cam[:, 2] < -np.linalg.norm(p_cam, axis=1) * 0.75
    assert behind.sum() > 20
    assert not np.any(projected(CAMERAS[name], p_cam[behind])[1])


@pytest.mark.parametrize("name", BEHIND)
def test_directions_outside_the_view_never_fold_back(name):
    """Past the turning point of a polynomial, pixels keep moving outward, and nothing jumps on the way."""
    camera = CAMERAS[name]
    angle = np.linspace(0.0, np.radians(89 if name in PERSPECTIVE else 179), 2000)
    for azimuth in np.linspace(0.0, 2 * np.pi, 7):
        p_cam = np.stack([np.sin(angle) * np.cos(azimuth), np.sin(angle) * np.sin(azimuth), np.cos(angle)], axis=-1)
        uv, valid = (np.asarray(a) for a in projected(camera, p_cam))
        radius = np.hypot((uv[:, 0] - camera.cx) / camera.fx, (uv[:, 1] - camera.cy) / camera.fy)
        first_outside = np.argmin(valid) if not valid.all() else len(valid)
        assert not valid[first_outside:].any()
        if not valid.all():
            assert radius[first_outside:].min() > 0.999 * radius[:first_outside].max()
        assert np.all(np.diff(radius) > 0)


@pytest.mark.parametrize("name", [name for name in BEHIND if hasattr(CAMERAS[name], "max_radius") or name in WIDE])
def test_slope_is_continuous_at_the_end_of_the_view(name):
    camera = CAMERAS[name]
    limit = float(camera.max_theta_rad if name in WIDE else np.arctan(camera.max_radius))
    angle = limit + np.array([-1e-7, 1e-7])
    p_cam = 4.0 * np.stack([0.8 * np.sin(angle), -0.6 * np.sin(angle), np.cos(angle)], axis=-1)
    _, valid = projected(camera, p_cam)
    inside, outside = jacobian_of(camera, p_cam)
    assert list(valid) == [True, False]
    assert np.abs(inside - outside).max() < 1e-4 * np.abs(inside).max()


@pytest.mark.parametrize("name", IN_OPENCV)
def test_equals_opencv(name):
    camera, p_cam = CAMERAS[name], points_in_view(CAMERAS[name])
    p_cam = p_cam[p_cam[:, 2] > 0.01]  # cv2.fisheye knows only the half space in front of the lens
    uv, jacobian = opencv(camera, p_cam)
    assert np.abs(np.asarray(projected(camera, p_cam)[0]) - uv).max() < 1e-8
    assert np.abs(jacobian_of(camera, p_cam) - jacobian).max() < 1e-7 * np.abs(jacobian).max()


@pytest.mark.parametrize("name", ["double_sphere", "double_sphere_that_turns"])
def test_a_double_sphere_is_that_of_its_authors(name):
    """Equations 40 to 42 of Usenko, Demmel and Cremers, in Cartesian coordinates."""
    camera, p_cam = CAMERAS[name], points_in_view(CAMERAS[name])
    x, y, z = p_cam.T
    d1 = np.sqrt(x**2 + y**2 + z**2)
    d2 = np.sqrt(x**2 + y**2 + (camera.xi * d1 + z) ** 2)
    below = camera.alpha * d2 + (1.0 - camera.alpha) * (camera.xi * d1 + z)
    uv = np.stack([camera.fx * x / below + camera.cx, camera.fy * y / below + camera.cy], axis=-1)
    np.testing.assert_allclose(projected(camera, p_cam)[0], uv, atol=1e-8)


def test_derivatives_of_the_calibration_equal_opencv():
    """Self-calibration differentiates through the camera itself."""
    camera = CAMERAS["radtan_k3"]
    p_cam = points_in_view(camera)
    gradient = jit_quickly(jax.jacfwd(lambda c: c.project(p_cam)[0]))(camera)
    D = np.array([camera.k1, camera.k2, camera.p1, camera.p2, camera.k3], dtype=float)
    _, jacobian = cv2.projectPoints(p_cam[:, None], np.zeros(3), np.zeros(3), K_of(camera), D)
    names = ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3")
    ours = np.stack([np.asarray(getattr(gradient, name)).ravel() for name in names], axis=-1)
    assert np.allclose(ours, jacobian[:, 6:15], rtol=1e-7, atol=1e-7)


def test_compiled_equals_eager(camera):
    x, y, z = points_anywhere(num=32769).astype(np.float32).T
    eager, compiled = all_gradients(camera, x, y, z), jax.jit(all_gradients)(camera, x, y, z)
    # Derivatives grow without bound towards the lens, so errors are measured against the size of each row.
    scale = np.abs(np.asarray(eager)).max(axis=1, keepdims=True)
    assert np.all(np.abs(np.asarray(eager) - np.asarray(compiled)) <= 2e-6 * scale)


def test_float32_is_enough(camera):
    p_cam = points_in_view(camera)
    exact, _ = projected(camera, p_cam)
    short, valid = projected(camera, p_cam.astype(np.float32))
    assert short.dtype == np.float32
    assert np.asarray(valid).all()
    assert np.abs(np.asarray(short) - np.asarray(exact)).max() < 1e-3
    ray, valid = camera.unproject(pixels(camera).astype(np.float32))
    wanted, expected = camera.unproject(pixels(camera))
    assert ray.dtype == np.float32
    assert np.mean(np.asarray(valid) == np.asarray(expected)) > 0.995
    both = np.asarray(valid & expected)
    assert np.abs(np.asarray(ray) - np.asarray(wanted))[both].max() < 1e-5


def test_resized_cropped_and_shifted_move_pixels_as_images_do(camera):
    p_cam = points_in_view(camera)
    uv = np.asarray(projected(camera, p_cam)[0])
    width, height = camera.resolution
    small = camera.resized(width / 2, height / 4)
    assert small.resolution == (width // 2, height // 4)
    assert np.allclose(projected(small, p_cam)[0], (uv + 0.5) * [0.5, 0.25] - 0.5, atol=1e-9)
    assert np.allclose(projected(small.resized(width, height), p_cam)[0], uv, atol=1e-9)
    window = camera.cropped(10, 20, 300, 200)
    assert window.resolution == (300, 200)
    assert np.allclose(projected(window, p_cam)[0], uv - [10, 20], atol=1e-9)
    assert np.allclose(projected(camera.shifted(0.45, -0.5), p_cam)[0], uv + [0.45, -0.5], atol=1e-9)
    assert type(small) is type(camera)


def test_resized_is_what_opencv_does_to_an_image():
    """A blob at a known pixel of the full image has its centroid where the resized camera says."""
    camera = CAMERAS["radtan"]
    p_cam = np.array([[1.0, -0.7, 9.0]])
    u, v = np.asarray(projected(camera, p_cam)[0])[0]
    rows, columns = np.mgrid[0:600, 0:960]
    blob = np.exp(-((columns - u) ** 2 + (rows - v) ** 2) / (2 * 8.0**2))
    for size in ((480, 300), (320, 150), (1440, 900)):
        small = cv2.resize(blob, size, interpolation=cv2.INTER_AREA if size[0] < 960 else cv2.INTER_LINEAR)
        rows, columns = np.mgrid[0 : size[1], 0 : size[0]]
        centroid = np.array([(small * columns).sum(), (small * rows).sum()]) / small.sum()
        assert np.allclose(projected(camera.resized(*size), p_cam)[0][0], centroid, atol=5e-3)


def test_cameras_of_one_model_stack(camera):
    """vmap over stacked cameras is the same as one camera after the other."""
    cameras = [camera, camera.shifted(3.0, -2.0), camera.resized(320, 200)]
    p_cam = points_in_view(camera)
    stacked = jit_quickly(jax.vmap(lambda c: c.project(p_cam)[0]))(stack_cameras(cameras))
    assert np.allclose(stacked, np.stack([projected(c, p_cam)[0] for c in cameras]), atol=1e-9)


def test_border_of_the_image(camera):
    width, height = camera.resolution
    u = np.array([-0.5, -0.51, width - 0.5, width - 0.49, 5.0, 5.0, 0.0, width - 1.0])
    v = np.array([0.0, 0.0, height - 0.5, height / 2, -0.51, height - 0.49, 0.0, height - 1.0])
    assert list(camera.in_image(u, v)) == [True, False, True, False, False, False, True, True]
    assert not np.any(camera.in_image(u, v, margin_px=1.0))
    assert bool(camera.in_image(0.5, height - 1.5, margin_px=1.0))
