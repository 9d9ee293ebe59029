"""From one image, tens of metres and any heading: the true place is among the few that are worth a closer look."""

import time

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from semloc_jax.alignment.frame_localizer import FrameLocalizer, LocalizeConfig, sample_within
from semloc_jax.alignment.single_frame import frame_input
from semloc_jax.alignment.wide_search import WideSearchConfig, lattice, wide_search
from semloc_jax.datasets import open_drive
from semloc_jax.inputs.mask_source import mask_source
from semloc_jax.maps import read_map
from semloc_jax.perception import cost_maps

HALF_WIDTH_M = 20.0


def test_the_lattice_is_even_and_starts_in_the_middle():
    rows = lattice(2.0, 180.0, 1.0, 5.0)
    assert len(rows) == 1 + 5 * 5 * 72
    assert np.all(rows[0] == 0)
    assert len(np.unique(rows[1:], axis=0)) == 5 * 5 * 72
    assert np.abs(rows[:, :2]).max() == 2.0
    narrow = lattice(1.0, 7.0, 0.5, 5.0)
    assert np.degrees(np.abs(narrow[:, 2]).max()) == pytest.approx(10.0)


@pytest.mark.data
def test_the_true_place_is_among_sixteen(road_dir):
    drive = open_drive(road_dir)
    semantic_map, source = read_map(drive.map_path), mask_source("sem", drive, offset_px=(0.0, 0.0))
    config = LocalizeConfig()
    localizer, rng = FrameLocalizer(semantic_map, source.table, config), np.random.default_rng(0)
    found, seconds = [], []
    with jax.enable_x64(False):
        for frame in drive.frames[30::20]:
            T = drive.truth_at(frame)
            x, y = T[:2, 3] + rng.uniform(-HALF_WIDTH_M, HALF_WIDTH_M, 2) * 0.7
            T_center = semantic_map.road_pose(x, y, rng.uniform(-np.pi, np.pi))
            local_map = semantic_map.query(T_center[:3, 3], 85.0)
            samples = sample_within(local_map, config.sample_spacing_m, 16384)
            maps = cost_maps(source.masks(frame), localizer.shown, config.cost_maps)
            inputs = frame_input(samples, maps, source.seen_by(frame.rig), localizer.channel_of_label)
            T_local = T_center.copy()
            T_local[:3, 3] -= local_map.origin_map
            started = time.process_time()
            Ts, _ = wide_search(jnp.asarray(T_local, jnp.float32), inputs, HALF_WIDTH_M, 180.0, WideSearchConfig())
            Ts = np.array(jax.block_until_ready(Ts), np.float64)
            seconds.append(time.process_time() - started)
            Ts[:, :3, 3] += local_map.origin_map
            off = np.linalg.inv(T) @ Ts
            turn = np.degrees(np.arctan2(off[:, 1, 0], off[:, 0, 0]))
            found.append(np.any((np.abs(off[:, 0, 3]) < 2.0) & (np.abs(off[:, 1, 3]) < 1.2) & (np.abs(turn) < 6.0)))
    assert len(Ts) == 16
    # 121,000 poses; two frames in 15 drown in look-alikes when masks are those of a network, hardly one when exact.
    assert np.mean(found) >= 0.8, found
    assert np.median(seconds) < 5.0
