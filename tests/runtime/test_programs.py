"""A stored program gives the numbers of the compiled function, in the process that made it and in the next one."""

import subprocess
import sys
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from semloc_jax.runtime import programs

SCRIPT = """
import sys, time
import jax
jax.config.update("jax_compilation_cache_dir", sys.argv[1])
import jax.numpy as jnp
from semloc_jax.runtime.programs import stored_program

@stored_program("power")
def spectrum(matrix, offset, power):
    print("traced")
    return {"values": jnp.linalg.eigvalsh(matrix + offset) ** power, "offset": offset}

found = spectrum(jnp.diag(jnp.array([3.0, 1.0, 2.0])), offset=0.0, power=2)
print(*(round(float(value), 4) for value in found["values"]))
"""


class Pair(NamedTuple):
    total: jax.Array
    doubled: jax.Array


@pytest.fixture
def cache(tmp_path, monkeypatch):
    monkeypatch.setattr(programs, "_folder", lambda: tmp_path / "programs")
    return tmp_path / "programs"


def test_the_next_process_does_not_trace(tmp_path):
    command = [sys.executable, "-c", SCRIPT, str(tmp_path)]
    first, second = (subprocess.run(command, capture_output=True, text=True, check=True).stdout for _ in range(2))
    assert first.split() == ["traced", "1.0", "4.0", "9.0"]
    assert second.split() == ["1.0", "4.0", "9.0"]


def test_results_keep_their_structure_and_shapes_their_programs(cache):
    calls = []

    @programs.stored_program()
    def summed(values: jax.Array) -> Pair:
        calls.append(values.shape)
        return Pair(jnp.sum(values), 2 * values)

    for length in (3, 5, 3):
        found = summed(np.arange(length))
        assert isinstance(found, Pair)
        assert found.total == length * (length - 1) / 2
        np.testing.assert_array_equal(found.doubled, 2 * np.arange(length))
    assert calls == [(3,), (5,)]
    assert len(list(cache.iterdir())) == 2


def test_a_broken_file_is_made_anew(cache):
    def product(values):
        return jnp.prod(values)

    programs.stored_program()(product)(np.arange(1.0, 5.0))
    (path,) = cache.iterdir()
    path.write_bytes(path.read_bytes()[:100])
    assert programs.stored_program()(product)(np.arange(1.0, 5.0)) == 24
    assert path.stat().st_size > 100


def test_inside_another_function_it_is_traced_as_usual(cache):
    @programs.stored_program("scale")
    def scaled(value, scale):
        return scale * value

    assert jax.jit(lambda value: scaled(value, scale=3.0) + 1)(2.0) == 7
    assert jax.grad(lambda value: scaled(value, scale=3.0))(2.0) == 3
    assert not cache.exists()
