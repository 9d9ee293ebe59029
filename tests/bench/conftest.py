"""Peers run in float32, as they do in their processes; the rest of the tests run in float64."""

import jax
import pytest


@pytest.fixture(autouse=True, scope="module")
def single_precision():
    with jax.enable_x64(False):
        yield
