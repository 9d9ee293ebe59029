"""Kernels come from a compiler whose command may have several words, and from a cache that only this user fills."""

import shutil
import subprocess
import sys

import pytest

SCRIPT = "from semloc_jax.native import build; print(build.status().text)"


@pytest.fixture
def run(tmp_path, monkeypatch):
    if shutil.which("g++") is None:
        pytest.skip("no compiler")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.delenv("CXX", raising=False)

    def told() -> subprocess.CompletedProcess:
        return subprocess.run([sys.executable, "-c", SCRIPT], capture_output=True, text=True, check=False)

    return told


@pytest.mark.slow
def test_a_command_of_two_words_builds_and_a_damaged_library_is_built_anew(run, tmp_path, monkeypatch):
    quick = tmp_path / "quick"  # what is built is loaded and not run, so it need not be optimised
    quick.write_text('exec g++ "$@" -O0\n')
    monkeypatch.setenv("CXX", f"bash {quick}")
    assert run().stdout == f"built with bash {quick}\n"
    (kept,) = (tmp_path / "semloc_jax" / "native").iterdir()
    assert run().stdout == f"loaded from {kept}\n"
    content = bytearray(kept.read_bytes())
    content[len(content) // 2] ^= 0xFF
    kept.write_bytes(content[:-4096])
    again = run()
    assert again.returncode == 0 and again.stdout == f"built with bash {quick}\n"
    assert again.stderr.count("made anew") == 1


def test_a_named_compiler_that_fails_is_told(run, monkeypatch):
    monkeypatch.setenv("CXX", "no-such-compiler -O2")
    found = run()
    assert "no-such-compiler -O2" in found.stdout
    assert "pure JAX is used" in found.stderr and found.returncode == 0
