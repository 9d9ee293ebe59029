"""The command line runs in float32, as it does for a user; most other tests run in float64."""

import pytest


@pytest.fixture(autouse=True, scope="module")
def in_single_precision(single_precision):
    """Every test of this room."""
