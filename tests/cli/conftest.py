"""The command line runs in float32, as it does for a user; the rest of the tests run in float64."""

import jax
import pytest


@pytest.fixture(autouse=True, scope="module")
def single_precision():
    with jax.enable_x64(False):
        yield
