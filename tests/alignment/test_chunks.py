"""How many poses are computed side by side: what was asked for, and what suits the device where nothing was."""

import jax
import jax.numpy as jnp
import pytest

from semloc_jax.alignment import pose


@pytest.mark.parametrize(
    ("device", "chunk", "together"), [("cpu", 8, 8), ("gpu", 8, 8), ("cpu", None, 32), ("gpu", None, 1024)]
)
def test_a_number_that_was_asked_for_is_taken(device, chunk, together, monkeypatch):
    asked = []
    monkeypatch.setattr(jax, "default_backend", lambda: device)
    monkeypatch.setattr(jax.lax, "map", lambda function, Ts, batch_size: asked.append(batch_size))
    pose.in_chunks(lambda T: T, jnp.zeros((2000, 4, 4)), chunk)
    pose.in_chunks(lambda T: T, jnp.zeros((3, 4, 4)), chunk)
    assert asked == [together, 3]
