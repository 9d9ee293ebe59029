"""What poses see of a map: the kernels against JAX, two cameras, parts and poses put together."""

from dataclasses import replace

import jax
import numpy as np
import pytest

from semloc_jax.alignment.observed import Borders, CoarseSamples, ObserveConfig
from semloc_jax.alignment.seen_samples import SeenSamples, coarse_nats, seen_from
from semloc_jax.cameras import KannalaBrandtCamera, PinholeCamera, Rig
from semloc_jax.geometry import rigid
from semloc_jax.host import native_status
from semloc_jax.simulation.cameras import mounted
from semloc_jax.structs import ElementClass, MapSamples, SampleKind

NUM, WIDTH, HEIGHT, STRIDE = 600, 320, 200, 2
RIG = Rig(
    [PinholeCamera(240.0, 242.0, 158.0, 96.0, WIDTH, HEIGHT), PinholeCamera(250.0, 251.0, 161.0, 99.0, WIDTH, HEIGHT)],
    np.stack([mounted((1.6, 0.1, 1.45), 0.0, 6.0, 0.5), mounted((1.2, -0.1, 1.5), 140.0, 12.0, -0.8)]),
    ["front", "rear"],
)
FISHEYE = Rig(
    [KannalaBrandtCamera(90.0, 91.0, 158.0, 99.0, WIDTH, HEIGHT, 0.05, -0.01, 0.002, -0.0004)],
    mounted((1.6, 0.0, 1.2), 20.0, 15.0, 0.0)[None],
    ["side"],
)
CHANNELS = np.where(np.arange(len(ElementClass)) % 5 == 4, -1, np.arange(len(ElementClass)) % 2).astype(np.int32)
CONFIG = ObserveConfig(max_range_m=30.0, min_ground_px_per_m=3.0, cell_px=24.0)


def random_map(seed=0):
    """Samples of all kinds on all sides, in arrays of the host."""
    random = np.random.default_rng(seed)
    tangent = random.normal(size=(NUM, 3))
    p_map = random.uniform((-40.0, -30.0, 0.0), (40.0, 30.0, 3.0), (NUM, 3)).astype(np.float32)
    kind = random.integers(0, len(SampleKind), NUM)
    columns = dict(
        p_map=p_map,
        tangent_map=(tangent / np.linalg.norm(tangent, axis=1, keepdims=True)).astype(np.float32),
        offset_m=np.where(kind == SampleKind.FIXED, 0.0, random.uniform(-0.3, 0.3, NUM)).astype(np.float32),
        length_m=random.uniform(0.05, 0.6, NUM).astype(np.float32),
        label=random.integers(0, len(ElementClass), NUM).astype(np.int32),
        kind=kind.astype(np.int32),
        element=(np.arange(NUM) // 6).astype(np.int32),
        center_map=(p_map + random.normal(size=(NUM, 3))).astype(np.float32),
        height_sigma=np.zeros((NUM, 3), np.float32),
        valid=random.random(NUM) < 0.9,
    )
    return jax.tree.map(np.asarray, MapSamples(**jax.device_put(columns)))


def random_borders(num_cameras, seed=1):
    random = np.random.default_rng(seed)
    signed = random.uniform(-40.0, 40.0, (num_cameras, 2, HEIGHT // STRIDE, WIDTH // STRIDE)).astype(np.float32)
    usable = random.random((num_cameras, HEIGHT // 4, WIDTH // 4)) < 0.8
    return Borders(signed, np.float32(STRIDE), usable, np.float32(4.0))


def poses(num, seed=2):
    random = np.random.default_rng(seed)
    return np.stack([rigid.exp(random.normal(size=6) * [4.0, 3.0, 0.1, 0.02, 0.02, 0.8]) for _ in range(num)])


def rows_of(seen):
    return {row: k for k, row in enumerate(zip(seen.pose, seen.camera, seen.sample, strict=True))}


@pytest.mark.parametrize("rig", [RIG, FISHEYE], ids=["two pinholes", "fisheye"])
def test_kernels_see_what_jax_sees(rig):
    """Where a sample lies within rounding of a limit, the two may differ: no more than one in a hundred does."""
    if not native_status(type(rig.cameras[0]).__name__.removesuffix("Camera")).available:
        pytest.skip("no kernels on this machine")
    known = random_map(), rig, CHANNELS, random_borders(len(rig))
    by_kernel, by_jax = (seen_from(poses(70), *known, replace(CONFIG, path=path)) for path in ("analytic", "xla"))
    one, other = rows_of(by_kernel), rows_of(by_jax)
    both = sorted(one.keys() & other.keys())
    assert len(both) > 1500 and len(one.keys() ^ other.keys()) <= len(both) // 100
    assert list(one) == sorted(one), "rows are not in the order of poses, cameras and samples"
    assert {camera for _, camera, _ in both} == set(range(len(rig)))
    here, there = ([rows[key] for key in both] for rows in (one, other))
    # A random field has slopes of 40 px from pixel to pixel.
    np.testing.assert_allclose(by_kernel.signed_px[here], by_jax.signed_px[there], atol=0.05)
    np.testing.assert_allclose(by_kernel.length_px[here], by_jax.length_px[there], rtol=1e-3, atol=1e-3)
    np.testing.assert_allclose(by_kernel.range_m[here], by_jax.range_m[there], rtol=1e-5)
    assert np.mean(by_kernel.cell[here] != by_jax.cell[there]) < 0.01


@pytest.mark.parametrize("rig", [RIG, FISHEYE], ids=["two pinholes", "fisheye"])
@pytest.mark.parametrize("num_parts", [1, 3])
def test_kernels_gain_what_jax_gains_at_a_first_look(rig, num_parts):
    if not native_status(type(rig.cameras[0]).__name__.removesuffix("Camera")).available:
        pytest.skip("no kernels on this machine")
    random = np.random.default_rng(5)
    p_map = random.uniform((-40.0, -30.0, 0.0), (40.0, 30.0, 3.0), (3, 50, 3)).swapaxes(1, 2).astype(np.float32)
    channel, weight = random.integers(0, 2, (3, 50)).astype(np.int32), random.random((3, 50), np.float32)
    gain = random.normal(size=(len(rig), 2, HEIGHT // 4, WIDTH // 4)).astype(np.float32)
    known = poses(90), CoarseSamples(p_map, channel, weight), num_parts, rig, gain, 4.0
    one, other = (coarse_nats(*known, replace(CONFIG, path=path)) for path in ("analytic", "xla"))
    # A sample that rounding moves to the next pixel gains another random number.
    assert one.shape == (90,) and np.mean(np.abs(one - other) > 1e-3) <= 0.02 and np.abs(other).max() > 1.0


def test_poses_one_after_another_are_those_seen_together():
    known = random_map(), RIG, CHANNELS, random_borders(2), CONFIG
    Ts = poses(5)
    whole, joined = seen_from(Ts, *known), seen_from(Ts[:2], *known).joined(seen_from(Ts[2:], *known))
    assert joined.num_poses == whole.num_poses == 5
    jax.tree.map(np.testing.assert_array_equal, vars(joined), vars(whole))


def test_only_a_part_of_the_samples():
    seen = seen_from(poses(3), random_map(), RIG, CHANNELS, random_borders(2), CONFIG)
    part = np.arange(NUM) % 3 == 0
    own = seen.only(part)
    assert 0 < len(own.sample) < len(seen.sample) and part[own.sample].all()
    assert rows_of(own).keys() == {row for row in rows_of(seen) if part[row[2]]}


def test_nothing_is_seen_from_far_away():
    away = poses(2) + np.pad([[1e4]], ((0, 3), (3, 0)))
    seen = seen_from(away, random_map(), RIG, CHANNELS, random_borders(2), CONFIG)
    assert isinstance(seen, SeenSamples) and (seen.num_poses, seen.num_cameras, len(seen.sample)) == (2, 2, 0)
