"""A stored program gives the numbers of the compiled function, in the process that made it and in the next one."""

import os
import pickle
import shutil
import subprocess
import sys
from pathlib import Path
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import semloc_jax
from semloc_jax.mapping.crowd import kept_cells
from semloc_jax.native import build
from semloc_jax.runtime import effort, prepare, programs
from semloc_jax.runtime.stored_program import stored_program
from semloc_jax.storage.sources import hash_of_sources

SCRIPT = """
import sys, time
import jax
jax.config.update("jax_compilation_cache_dir", sys.argv[1])
import jax.numpy as jnp
from semloc_jax.runtime.stored_program import stored_program

@stored_program("power")
def spectrum(matrix, offset, power):
    print("traced")
    return {"values": jnp.linalg.eigvalsh(matrix + offset) ** power, "offset": offset}

found = spectrum(jnp.diag(jnp.array([3.0, 1.0, 2.0])), offset=0.0, power=2)
print(*(round(float(value), 4) for value in found["values"]))
"""


OF_ANOTHER_ROOM = """
import sys
import jax
jax.config.update("jax_compilation_cache_dir", sys.argv[1])
import jax.numpy as jnp
from semloc_jax.analysis.edited import weighted
from semloc_jax.runtime.stored_program import stored_program

@stored_program()
def total(values):
    return jnp.sum(weighted(values))

print(float(total(jnp.arange(4.0))))
"""


class Pair(NamedTuple):
    total: jax.Array
    doubled: jax.Array


@pytest.fixture
def cache(tmp_path, monkeypatch):
    monkeypatch.setattr(effort, "_runs_of_few", [])  # whatever the effort of the other tests
    monkeypatch.setattr(programs, "is_open", lambda: True)
    monkeypatch.setattr(programs, "_folder", lambda: tmp_path / "programs")
    return tmp_path / "programs"


def test_the_next_process_does_not_trace(tmp_path, monkeypatch):
    monkeypatch.delenv("SEMLOC_PROGRAMS", raising=False)
    command = [sys.executable, "-c", SCRIPT, str(tmp_path)]
    first, second = (subprocess.run(command, capture_output=True, text=True, check=True).stdout for _ in range(2))
    assert first.split() == ["traced", "1.0", "4.0", "9.0"]
    assert second.split() == ["1.0", "4.0", "9.0"]


@pytest.fixture
def copied_package(tmp_path):
    """A copy of the package that may be edited."""
    folder = tmp_path / "copy" / "semloc_jax"
    shutil.copytree(Path(semloc_jax.__file__).parent, folder, ignore=shutil.ignore_patterns("__pycache__", "*.so"))
    return folder


def test_an_edited_function_of_another_room_does_not_run_its_old_program(copied_package, tmp_path):
    """Weights times 5 once changed nothing: the room of the function was not in the fingerprint."""
    command = [sys.executable, "-c", OF_ANOTHER_ROOM, str(tmp_path / "cache")]
    # Python takes its own compiled file for that of a source of the same size that was edited in the same second.
    own = {"PYTHONPATH": str(copied_package.parent), "SEMLOC_PROGRAMS": "1", "PYTHONDONTWRITEBYTECODE": "1"}
    environment, found = {**os.environ, **own}, []
    for weight in ("1.0", "5.0"):
        edited = copied_package / "analysis" / "edited.py"
        edited.write_text(f"def weighted(values):\n    return {weight} * values\n", encoding="utf-8")
        done = subprocess.run(command, capture_output=True, text=True, check=True, env=environment, cwd=tmp_path)
        found.append(float(done.stdout))
        assert len(list((tmp_path / "cache" / "programs").glob("total_*.bin"))) == len(found)
    assert found == [6.0, 30.0]


def test_every_room_is_in_the_fingerprint(copied_package, monkeypatch):
    """One character more in any source, C++ included, and no stored program and no kept cell of a map fits any more."""
    for user in (programs, kept_cells):
        monkeypatch.setattr(user, "hash_of_sources", lambda: hash_of_sources.__wrapped__(copied_package))

    def fingerprint():
        return programs._environment.__wrapped__(), kept_cells._code.__wrapped__()

    rooms = {path.relative_to(copied_package).parts[0]: path for path in sorted(copied_package.rglob("*.py"))}
    kernels = sorted((copied_package / "native" / "src").iterdir())
    assert len(rooms) > 20 and kernels
    seen = [fingerprint()]
    for path in (*rooms.values(), *kernels):
        path.write_bytes(path.read_bytes() + b"\n")
        seen.append(fingerprint())
    for found in zip(*seen, strict=True):
        assert len(set(found)) == 1 + len(rooms) + len(kernels)


def test_results_keep_their_structure_and_shapes_their_programs(cache):
    calls = []

    @stored_program()
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

    stored_program()(product)(np.arange(1.0, 5.0))
    (path,) = cache.iterdir()
    path.write_bytes(path.read_bytes()[:100])
    assert stored_program()(product)(np.arange(1.0, 5.0)) == 24
    assert path.stat().st_size > 100


def test_inside_another_function_it_is_traced_as_usual(cache):
    @stored_program("scale")
    def scaled(value, scale):
        return scale * value

    assert jax.jit(lambda value: scaled(value, scale=3.0) + 1)(2.0) == 7
    assert jax.grad(lambda value: scaled(value, scale=3.0))(2.0) == 3
    assert not cache.exists()


def test_a_release_without_the_option_compiles_all_the_same(cache, monkeypatch):
    """Options of the compiler come and go with its releases; the program must not."""
    monkeypatch.setattr(effort, "UNFUSED", {"xla_option_of_no_release": False})

    def doubled(value):
        return 2 * value

    assert stored_program()(doubled)(np.arange(3.0))[2] == 4
    (path,) = cache.iterdir()
    assert path.stat().st_size > 0


def test_fused_or_not_the_numbers_agree(cache):
    def chain(value):
        return jnp.sin(value) ** 2 + jnp.cos(value) ** 2 + jnp.cumsum(value)

    value = np.linspace(0.0, 3.0, 50, dtype=np.float32)
    found = [stored_program(fused=fused)(chain)(value) for fused in (False, True)]
    np.testing.assert_allclose(found[0], found[1], rtol=1e-6)


class Command:
    """Unpickled, it runs a command."""

    def __init__(self, path):
        self.path = path

    def __reduce__(self):
        return os.mkdir, (str(self.path),)


def test_a_planted_program_is_not_run(cache, tmp_path, caplog):
    def product(values):
        return jnp.prod(values)

    stored_program()(product)(np.arange(1.0, 5.0))
    (path,) = cache.iterdir()
    path.write_bytes(pickle.dumps((Command(tmp_path / "ran"), 0)))
    assert stored_program()(product)(np.arange(1.0, 5.0)) == 24
    assert not (tmp_path / "ran").exists()
    assert caplog.text.count("made anew") == 1
    assert cache.stat().st_mode & 0o777 == 0o700


def test_the_key_knows_every_library_that_traces(monkeypatch):
    programs._environment.cache_clear()
    before = programs._environment()
    for name in ("optimistix", "lineax", "equinox", "jaxlie", "jax", "jaxlib"):
        others = {**prepare.versions(), name: "0.0.0"}
        monkeypatch.setattr(programs, "versions", lambda others=others: others)
        programs._environment.cache_clear()
        assert name in before and programs._environment() != before
    programs._environment.cache_clear()


def test_a_cache_that_others_write_to_is_not_used(tmp_path):
    shared = tmp_path / "shared"
    shared.mkdir()
    shared.chmod(0o777)
    script = (
        "import os; from semloc_jax.runtime.prepare import prepare_jax; prepare_jax(); "
        "print(os.environ['JAX_COMPILATION_CACHE_DIR'])"
    )
    environment = {**os.environ, "JAX_COMPILATION_CACHE_DIR": str(shared), "XDG_CACHE_HOME": str(tmp_path / "home")}
    command = [sys.executable, "-c", script]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=True)
    assert str(tmp_path / "home") in done.stdout
    assert "other users can write" in done.stderr and done.stderr.count("\n") == 1
    shared.chmod(0o755)
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=True)
    assert done.stdout.strip() == str(shared) and done.stderr == ""


def test_a_run_of_few_frames_has_programs_of_its_own(cache, monkeypatch):
    """Whatever is on disk already, a run gets the programs of its own effort: they round differently."""
    asked = []
    monkeypatch.setattr(effort, "options", lambda fused: asked.append(effort.is_quick()) or {})
    squares = stored_program()(lambda x: x**2)
    for num_frames in (effort.FEW_FRAMES, effort.FEW_FRAMES + 1, effort.FEW_FRAMES):
        with effort.effort_for(num_frames):
            assert float(squares(np.float32(3))) == 9
    assert not effort.is_quick()
    assert set(asked) == {True, False} and len(squares._programs) == 2


def test_a_program_whose_kernels_are_missing_is_made_anew(cache, monkeypatch):
    """A program from disk needs the kernels that its process had loaded; one that cannot load them does not crash."""
    monkeypatch.setattr(build, "loaded_parts", lambda: ("NoSuchCamera",))
    monkeypatch.setattr(build, "_compiled", lambda command, part: (_ for _ in ()).throw(build._NotBuilt("no compiler")))
    traced = []

    def halved(x):
        traced.append(x)
        return x / 2

    for _ in range(2):
        assert float(stored_program()(halved)(np.float32(3))) == 1.5
    assert len(traced) == 2 and not build.status("NoSuchCamera").available
