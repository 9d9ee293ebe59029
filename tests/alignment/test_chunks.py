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
    pose.in_chunks(lambda T: T, jnp.zeros((2048, 4, 4)), chunk)
    pose.in_chunks(lambda T: T, jnp.zeros((3, 4, 4)), chunk)
    assert asked == [together, 3]


def test_chunks_are_of_one_size():
    """2,000 poses, at most 1,024 at a time, are two thousands: a smaller rest would be a second program."""
    sizes = []
    pose.in_chunks(lambda T: sizes.append(1) or T[0, 0], jnp.zeros((2000, 4, 4)), 1024)
    assert len(sizes) == 1
    found = pose.in_chunks(lambda T: T[0, 0], jnp.arange(5.0)[:, None, None] * jnp.ones((5, 4, 4)), 2)
    assert found.tolist() == [0.0, 1.0, 2.0, 3.0, 4.0]
