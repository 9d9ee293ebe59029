"""Cost maps: where the ramps cross zero, how they rise, and which pixels may be used."""

from functools import lru_cache

import cv2
import numpy as np
import pytest
from scipy.ndimage import distance_transform_edt, map_coordinates

from semloc_jax import native
from semloc_jax.errors import SemlocError
from semloc_jax.perception import (
    Channel,
    ClassTable,
    distance,
    load_class_table,
    read_mask,
)
from semloc_jax.perception.cost_maps import CostMapConfig, cost_maps
from semloc_jax.structs import ElementClass
from tests.perception.shapes import rendered

PAINT = load_class_table("lane_paint")
DRIVE = load_class_table("drive")
HEIGHT, WIDTH = 112, 136
ANGLES_DEG = np.random.default_rng(1).uniform(0, 180, 16)


def sampled(maps, level, uv, camera=0, channel=0):
    """Bilinear lookup of a level at pixels of the full mask, by the formula in the docstring of CostMaps."""
    at = (np.asarray(uv) + 0.5) / maps.stride[level] - 0.5
    plane = np.asarray(maps.ramps[level][camera, channel], np.float64)
    return map_coordinates(plane, [at[..., 1], at[..., 0]], order=1, mode="nearest")


def crossings(maps, level, points, normal):
    """Signed distance [px] from the true boundary points, along their outward normal, to the zero of the ramp."""
    reach = np.linspace(-2.5, 2.5, 401)
    values = sampled(maps, level, points[:, None] + reach[:, None] * normal)
    rises = (values[:, :-1] <= 0) & (values[:, 1:] > 0)
    assert rises.any(axis=1).all()
    best = np.argmin(np.where(rises, np.abs(reach[:-1]), np.inf), axis=1)
    rows = np.arange(len(points))
    low, high = values[rows, best], values[rows, best + 1]
    return reach[best] - (reach[1] - reach[0]) * low / (high - low)


@lru_cache
def edge_errors(width_px):
    """Crossing errors of straight edges at random angles and sub-pixel places: float[edge level point]."""
    rng, errors = np.random.default_rng(0), []
    for angle in np.deg2rad(ANGLES_DEG):
        normal = np.array([np.cos(angle), np.sin(angle)])
        centre = np.array([WIDTH / 2, HEIGHT / 2]) + rng.uniform(-0.5, 0.5) * normal

        def inside(u, v, normal=normal, centre=centre):
            across = (u - centre[0]) * normal[0] + (v - centre[1]) * normal[1]
            return across < 0 if width_px is None else np.abs(across) < width_px / 2

        maps = cost_maps([rendered(inside, HEIGHT, WIDTH)], PAINT)
        along = np.linspace(-35, 35, 141)[:, None] * np.array([-normal[1], normal[0]])
        # The side lines of a thin line have no zero on the reduced levels.
        levels = range(4) if width_px is None else (3,)
        for side in (1.0,) if width_px is None else (1.0, -1.0):
            points = centre + along + (0.0 if width_px is None else side * width_px / 2 * normal)
            errors.append([crossings(maps, level, points, side * normal) for level in levels])
    return np.array(errors)


@pytest.mark.parametrize("width_px", [None, 3.0])
def test_finest_zero_lies_on_the_true_edge(width_px):
    errors = edge_errors(width_px)[:, -1]
    assert abs(errors.mean()) < 0.02
    assert np.abs(errors.mean(axis=1)).max() < 0.1
    assert np.sqrt(np.mean(errors**2)) < 0.18


def test_reduced_levels_share_the_geometry_of_the_full_mask():
    for level in (0, 1, 2):
        errors = edge_errors(None)[:, level]
        assert abs(errors.mean()) < 0.03
        assert np.abs(errors.mean(axis=1)).max() < 0.15


def test_zero_lies_midway_between_the_pixels_of_an_upright_edge():
    mask = np.zeros((64, 64), np.uint8)
    mask[:, :20] = 1
    for stride in (1, 2, 4):
        maps = cost_maps([mask], PAINT, CostMapConfig(ramp_px=(6.0,), stride=(stride,)))
        uv = np.stack([np.linspace(12, 27, 31), np.full(31, 32.0)], axis=-1)
        exact = np.clip((uv[:, 0] - 19.5) / 6, -1, 1)
        np.testing.assert_allclose(sampled(maps, 0, uv), exact, atol=0.05 if stride == 1 else 0.08 * stride)
        assert abs(sampled(maps, 0, [[19.5, 32.0]])[0]) < 0.01


@pytest.mark.parametrize("width_px", [1.0, 1.4, 2.0])
def test_thin_lines_survive_on_every_level(width_px):
    normal = np.array([np.cos(0.4), np.sin(0.4)])
    mask = rendered(lambda u, v: np.abs((u - 68.2) * normal[0] + (v - 56.3) * normal[1]) < width_px / 2, HEIGHT, WIDTH)
    maps = cost_maps([mask], PAINT)
    along = np.linspace(-35, 35, 71)[:, None] * np.array([-normal[1], normal[0]])
    for level, ramp_px in enumerate(maps.ramp_px):
        values = sampled(maps, level, np.array([68.2, 56.3]) + along)
        assert values.max() < 2.0 / ramp_px
        # Both sides are alike, so a thin line does not pull the pose to one side.
        left, right = (sampled(maps, level, np.array([68.2, 56.3]) + along + s * 3 * normal) for s in (-1, 1))
        assert abs(left.mean() - right.mean()) * ramp_px < 0.15


def test_ramp_rises_without_plateau_up_to_its_width():
    mask = rendered(lambda u, v: (u - 68) ** 2 + (v - 56) ** 2 < 30.0**2, HEIGHT, WIDTH)
    maps = cost_maps([mask], PAINT)
    for level, ramp_px in enumerate(maps.ramp_px):
        step = 0.25 * maps.stride[level]
        radius = np.arange(30 - min(ramp_px, 26), 30 + min(ramp_px, 25) - maps.stride[level], step)
        for angle in np.linspace(0, 2 * np.pi, 13):
            uv = np.stack([68 + radius * np.cos(angle), 56 + radius * np.sin(angle)], axis=-1)
            slope = np.diff(sampled(maps, level, uv)) * ramp_px / step
            # A distance has slope 1; the lattice shows in single steps, a plateau would show as 0.
            assert slope.min() > 0.1 and slope.max() < 2.0
            assert abs(slope.mean() - 1) < 0.12


def test_far_values_are_the_euclidean_distance():
    mask = read_pattern()
    outside, inside = distance_transform_edt(mask == 0), distance_transform_edt(mask == 1)
    exact = np.where(mask == 0, outside - 0.5, 0.5 - inside)
    maps = cost_maps([mask], PAINT, CostMapConfig(ramp_px=(40.0, 12.0), stride=(1, 1)))
    for level in (0, 1):
        ramp_px = maps.ramp_px[level]
        ours = np.asarray(maps.ramps[level][0, 0]) * ramp_px
        error = np.abs(ours - np.clip(exact, -ramp_px, ramp_px))[np.abs(exact) > 3]
        # The fast transform is right to 2 % of the distance.
        assert error.max() < 0.9


def read_pattern():
    rng = np.random.default_rng(5)
    mask = np.zeros((96, 128), np.uint8)
    for _ in range(4):
        v, u = rng.integers(5, 80), rng.integers(5, 110)
        mask[v : v + 9, u : u + 14] = 1
    return mask


def test_channels_do_not_mix_and_absent_ones_stay_far():
    mask = np.ones((60, 80), np.uint8)
    mask[20:30, 30:40], mask[40:50, 10:14] = 10, 20
    maps = cost_maps([mask], DRIVE)
    lane, pole, cone = (DRIVE.channel_index(name) for name in ("lane_marking", "pole", "cone"))
    for level in range(len(maps.ramps)):
        planes = np.asarray(maps.ramps[level][0])
        stride = maps.stride[level]
        assert planes[lane, 25 // stride, 35 // stride] < 0 < planes[lane, 45 // stride, 12 // stride]
        assert planes[pole, 25 // stride, 35 // stride] > 0
        assert (planes[cone] == 1).all()
    only = cost_maps([mask], DRIVE, channels=[pole])
    assert (np.asarray(only.ramps[3][0, lane]) == 1).all()
    np.testing.assert_array_equal(only.ramps[3][0, pole], maps.ramps[3][0, pole])


def test_any_size_and_smaller_cameras_are_padded_with_unusable_pixels():
    big, small = np.zeros((61, 97), np.uint8), np.zeros((31, 50), np.uint8)
    big[:, 90:], small[28:] = 1, 1
    maps = cost_maps([big, small], PAINT)
    alone = cost_maps([small], PAINT)
    for level, stride in enumerate(maps.stride):
        assert maps.ramps[level].shape == (2, 1, -(-61 // stride), -(-97 // stride))
        h, w = alone.ramps[level].shape[2:]
        np.testing.assert_array_equal(maps.ramps[level][1, :, :h, :w], alone.ramps[level][0])
        assert (np.asarray(maps.ramps[level][1, 0, h:]) == 1).all()
    usable = np.asarray(maps.usable)
    assert usable[0].all() and usable[1, :16, :25].all() and usable[1].sum() == 16 * 25


def test_image_border_is_no_boundary():
    mask = np.zeros((60, 80), np.uint8)
    mask[:, 60:] = 1
    finest = np.asarray(cost_maps([mask], PAINT).ramps[3][0, 0])
    assert (finest[:, 64:] == -1).all() and (finest[:, :55] == 1).all()


def test_pixels_near_an_occluder_are_unusable():
    mask = np.ones((80, 120), np.uint8)
    mask[38:42, :] = 10
    mask[20:60, 50:80] = 7
    mask[70:, :] = 8
    mask[:5, :5] = 255
    maps = cost_maps([mask], DRIVE)
    usable = np.asarray(maps.usable[0]).repeat(2, axis=0).repeat(2, axis=1)
    hidden = np.isin(mask, [7, 8, 255])
    near = distance_transform_edt(~hidden)
    assert not usable[near <= 2].any()
    assert usable[near > 4].all()
    # Where the car cuts the lane line the ramp crosses zero, and none of that may be used.
    crosses = np.flatnonzero(np.diff(np.sign(np.asarray(maps.ramps[3][0, 0, 40, 20:100])))) + 20
    assert crosses.tolist() == [49, 79] and not usable[40, [48, 49, 50, 51, 78, 79, 80, 81]].any()


@pytest.mark.parametrize("kind", ["gradient", "laplacian"])
def test_unsigned_costs_of_the_literature_have_their_valley_on_the_boundary(kind):
    normal = np.array([np.cos(0.5), np.sin(0.5)])
    mask = rendered(lambda u, v: (u - 68.3) * normal[0] + (v - 56.1) * normal[1] < 0, HEIGHT, WIDTH)
    maps = cost_maps([mask], PAINT, CostMapConfig(kind=kind))
    along = np.linspace(-15, 15, 31)[:, None] * np.array([-normal[1], normal[0]])
    for level, (ramp_px, stride) in enumerate(zip(maps.ramp_px, maps.stride, strict=True)):
        reach = np.arange(-1.5 * ramp_px, 1.5 * ramp_px, 0.1)
        uv = np.array([68.3, 56.1]) + along[:, None] + reach[:, None] * normal
        profile = sampled(maps, level, uv).mean(axis=0)
        assert profile.min() < 0.25 and profile[0] > 0.9 and profile[-1] > 0.9
        depth = 1 - profile
        assert abs(np.sum(depth * reach) / depth.sum()) < 0.12 * stride


def test_literature_takes_the_laplacian_for_signs_and_the_gradient_for_the_rest():
    mask = np.ones((96, 96), np.uint8)
    mask[20:50, 20:50], mask[60:90, 60:64] = 21, 10
    both = cost_maps([mask], DRIVE, CostMapConfig(kind="literature"))
    sign, lane = DRIVE.channel_index("sign"), DRIVE.channel_index("lane_marking")
    for kind, channel in (("laplacian", sign), ("gradient", lane)):
        alone = cost_maps([mask], DRIVE, CostMapConfig(kind=kind))
        np.testing.assert_array_equal(both.ramps[1][0, channel], alone.ramps[1][0, channel])


def test_inputs_that_cannot_work_are_named():
    with pytest.raises(SemlocError, match="one entry for each level"):
        CostMapConfig(ramp_px=(8.0,), stride=(1, 1))
    with pytest.raises(SemlocError, match="unknown kind 'ramps'"):
        CostMapConfig(kind="ramps")
    with pytest.raises(SemlocError, match="strides must be"):
        CostMapConfig(ramp_px=(8.0,), stride=(3,))
    with pytest.raises(SemlocError, match=r"mask 0 is float64\[4, 4\]"):
        cost_maps([np.zeros((4, 4))], PAINT)
    with pytest.raises(SemlocError, match="one mask for each camera"):
        cost_maps([], PAINT)


def worn_lines(height, width, seed=0):
    """A mask of lines and blobs of all widths at all angles, some of a single pixel, of two classes."""
    rng = np.random.default_rng(seed)
    mask = np.zeros((height, width), np.uint8)
    for _ in range(14):
        ends = rng.integers(-20, max(height, width) + 20, 4)
        cv2.line(mask, tuple(ends[:2]), tuple(ends[2:]), int(rng.integers(1, 3)), int(rng.integers(1, 9)))
    mask[rng.random(mask.shape) < 0.002] = 1
    return mask


def dequantised(maps):
    return [np.asarray(ramp, np.float64) / 127 - 1 for ramp in maps.ramps]


TWO = ClassTable("two", (Channel("a", (1,), (ElementClass.LANE_MARKING,)), Channel("b", (2,), (ElementClass.POLE,))))


@pytest.mark.skipif(not native.is_available(), reason="no native kernels: " + native.status().text)
@pytest.mark.parametrize("size", [(112, 136), (61, 97), (240, 333)])
def test_the_native_ramps_are_those_of_opencv(size):
    mask = worn_lines(*size)
    config = CostMapConfig()
    floats, found = cost_maps([mask], TWO, config), dequantised(cost_maps([mask], TWO, config, quantised=True))
    for level, ramp_px in enumerate(config.ramp_px):
        exact = np.asarray(floats.ramps[level], np.float64)
        assert found[level].shape == exact.shape
        rising = np.abs(exact) < 0.95
        # OpenCV's distance is off by 2 %; and where lines of one pixel meet the two differ in what they call thin.
        apart_px = ((np.abs(found[level] - exact) - 0.025 * np.abs(exact)) * ramp_px)[rising]
        assert np.median(apart_px) < 0.25 * ramp_px / 127 + 0.05
        assert np.mean(apart_px > 0.5) < 0.06
        assert np.abs(np.mean((found[level] - exact)[rising]) * ramp_px) < 0.06


@pytest.mark.skipif(not native.is_available(), reason="no native kernels: " + native.status().text)
def test_the_native_distance_is_the_euclidean_one():
    mask = worn_lines(120, 160)
    config = CostMapConfig(ramp_px=(20.0,), stride=(1,), blur_px=1.0)
    found = dequantised(cost_maps([mask], TWO, config, quantised=True))[0][0, 0] * 20
    inside = mask == 1
    exact = distance_transform_edt(~inside) - distance_transform_edt(inside)
    exact -= np.where(inside, -0.5, 0.5)
    far = (np.abs(exact) > 3) & (np.abs(exact) < 19)
    # What is left is the step of a byte.
    assert np.abs(found - exact)[far].max() < 0.5 * 20 / 127 + 1e-3


def test_bytes_without_kernels_are_the_rounded_floats(monkeypatch):
    monkeypatch.setattr("semloc_jax.perception.ramps.native.is_available", lambda: False)
    mask = worn_lines(112, 136)
    floats, found = cost_maps([mask], TWO), dequantised(cost_maps([mask], TWO, quantised=True))
    for exact, rounded in zip(floats.ramps, found, strict=True):
        assert np.abs(np.asarray(exact) - rounded).max() <= 0.5 / 127 + 1e-6


def test_cameras_of_several_sizes_keep_their_ramps_as_bytes():
    masks = [worn_lines(64, 96), worn_lines(48, 80, seed=1)]
    both = cost_maps(masks, TWO, quantised=True)
    alone = cost_maps(masks[1:], TWO, quantised=True)
    for wide, own in zip(both.ramps, alone.ramps, strict=True):
        height, width = own.shape[2:]
        np.testing.assert_array_equal(wide[1, :, :height, :width], own[0])
        assert (np.asarray(wide[1, :, height:]) == 254).all()
        assert (np.asarray(wide[1, :, :, width:]) == 254).all()


@pytest.mark.data
def test_distances_of_a_rendered_frame_are_taken_at_half_size(road_dir, monkeypatch):
    """A transform at full size costs four times as much: it is left to the surroundings of thin lines."""
    mask = read_mask(sorted((road_dir / "sem" / "front").glob("*.png"))[20])
    sizes = []
    transform = distance._plain_distance

    def counted(binary, *args):
        sizes.append(binary.size)
        return transform(binary, *args)

    monkeypatch.setattr(distance, "_plain_distance", counted)
    cost_maps([mask], DRIVE)
    num_channels = sum(bool(np.isin(mask, channel.mask_ids).any()) for channel in DRIVE.channels)
    assert 0 < sum(sizes) < 0.5 * num_channels * mask.size
