"""Rows that are filled are mapped, the others are left alone, and no number of rows compiles anew."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from semloc_jax.alignment.filled_rows import map_filled


@pytest.mark.parametrize("num", [0, 1, 5, 8])
def test_filled_rows_are_those_of_the_function(num):
    rows = {"x": jnp.arange(8.0), "y": jnp.arange(24.0).reshape(8, 3)}
    found = map_filled(lambda row: (row["x"] + 1.0, row["y"].sum()), rows, num)
    assert np.asarray(found[0]) == pytest.approx(np.where(np.arange(8) < num, np.arange(8) + 1.0, 0.0))
    assert np.asarray(found[1]) == pytest.approx(np.where(np.arange(8) < num, 9.0 * np.arange(8) + 3.0, 0.0))


def test_one_program_serves_any_number_of_rows():
    traces = []

    def doubled(row):
        traces.append(row)
        return 2.0 * row

    mapped = jax.jit(lambda rows, num: map_filled(doubled, rows, num))
    first = mapped(jnp.arange(4.0), np.int32(2))
    count = len(traces)
    assert np.asarray(first) == pytest.approx([0.0, 2.0, 0.0, 0.0])
    assert np.asarray(mapped(jnp.arange(4.0), np.int32(4))) == pytest.approx([0.0, 2.0, 4.0, 6.0])
    assert len(traces) == count
