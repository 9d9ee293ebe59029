"""Frames in one program and starts spread over devices give what one solve after another gives."""

import os
import subprocess
import sys
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from semloc_jax.alignment.batches import align_frames, align_on, mesh_of, stack_evidence
from semloc_jax.alignment.pose import AlignConfig, align
from semloc_jax.errors import SemlocError
from tests.contracts.ground_scene import scene

CONFIG = AlignConfig(levels=(0, 1), max_steps=8)
OFF = np.array([0.4, -0.25, 0.02, 0.003, -0.002, 0.03])

TWO_DEVICES = """
import jax, numpy as np
from tests.alignment.test_batches import CONFIG, OFF, starts_of
from semloc_jax.alignment.batches import align_on, mesh_of
from semloc_jax.alignment.pose import align_many
from tests.contracts.ground_scene import scene
assert len(jax.devices()) == 2
world = scene("radtan", dtype=np.float32)
Ts, prior = starts_of(world, 4), world.prior(OFF)
spread = align_on(mesh_of(), Ts, world.evidence, prior, CONFIG)
assert len(spread.T_map_base.sharding.device_set) == 2
one = jax.jit(lambda Ts: align_many(Ts, world.evidence, prior, CONFIG))(Ts)
print(float(np.abs(np.asarray(spread.T_map_base) - np.asarray(one.T_map_base)).max()))
"""


def starts_of(world, num: int):
    return jnp.stack([world.moved(OFF * share) for share in np.linspace(0.2, 1.0, num)])


def test_frames_in_one_program_are_frame_after_frame():
    worlds = [scene("radtan", dtype=np.float32), scene("radtan", dtype=np.float32)]
    starts, priors = (
        [starts_of(world, 2) for world in worlds],
        [world.prior(OFF * (k + 1)) for k, world in enumerate(worlds)],
    )
    stacked = jax.tree.map(lambda *leaves: jnp.stack(leaves), *priors)
    together = align_frames(jnp.stack(starts), stack_evidence([w.evidence for w in worlds]), stacked, CONFIG)
    assert together.T_map_base.shape == (2, 2, 4, 4)
    solve = jax.jit(align, static_argnames="config")
    for frame in range(2):
        for k in range(2):
            alone = solve(starts[frame][k], worlds[frame].evidence, priors[frame], config=CONFIG)
            np.testing.assert_allclose(together.T_map_base[frame, k], alone.T_map_base, atol=2e-4)


def test_frames_of_other_sizes_are_refused_in_words():
    one, other = (scene(name, dtype=np.float32).evidence for name in ("radtan", "mixed"))
    with pytest.raises(SemlocError, match="frame 1 has other cameras or sizes"):
        stack_evidence([one, other])
    world = scene("radtan", dtype=np.float32)
    with pytest.raises(SemlocError, match="at least one"):
        stack_evidence([])
    single = align_on(mesh_of(jax.devices()[:1]), starts_of(world, 1), world.evidence, world.prior(OFF), CONFIG)
    assert single.T_map_base.shape == (1, 4, 4)


@pytest.mark.slow
def test_two_devices_share_the_starts():
    flags = {"XLA_FLAGS": "--xla_force_host_platform_device_count=2", "JAX_PLATFORMS": "cpu"}
    done = subprocess.run(
        [sys.executable, "-c", TWO_DEVICES],
        capture_output=True,
        text=True,
        env=os.environ | flags,
        cwd=Path(__file__).parents[2],
        check=False,
    )
    assert done.returncode == 0, done.stderr[-2000:]
    assert float(done.stdout) < 2e-4
