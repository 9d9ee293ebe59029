"""`semloc doctor` and what is set up before JAX: self-tests pass, faulty releases are named, caches never crash."""

import os
import subprocess
import sys
import tomllib
from pathlib import Path

import numpy as np
import pytest

from semloc_jax.bench import selftest
from semloc_jax.cli import doctor
from semloc_jax.cli.main import FAILED, OK, main
from semloc_jax.errors import EXTRAS, install_command
from semloc_jax.runtime import prepare as runtime


def test_this_machine_is_well(capsys):
    assert main(["doctor"]) == OK
    said = capsys.readouterr().out
    assert "WRONG" not in said
    for word in ("jax ", "device", "compiled sums of 16385 rows, float64", "compiled sums of 32769 rows, float32"):
        assert word in said


@pytest.mark.parametrize(("dtype", "rows"), [(np.float64, 16385), (np.float32, 32769), (np.float64, 16384)])
def test_compiled_code_agrees_with_numpy_above_the_sizes_of_the_known_fault(dtype, rows):
    check = selftest.check_compiled_sum(dtype, rows)
    assert check.is_ok, check.found


def test_faulty_releases_of_jax_are_named_with_the_remedy():
    check = selftest.check_jax_version("0.10.2")
    assert not check.is_ok
    assert "silently wrong" in check.found
    assert "!=0.10.2" in check.remedy
    assert selftest.check_jax_version("0.10.1").is_ok


def test_a_failed_check_is_exit_code_1(monkeypatch, capsys):
    monkeypatch.setattr(selftest, "run_checks", lambda: [selftest.Check("sums", False, "off by 3", "reinstall it")])
    assert main(["doctor"]) == FAILED
    said = capsys.readouterr().out
    assert "WRONG sums" in said
    assert "to do: reinstall it" in said


def test_what_is_printed_to_install_works_from_every_folder(monkeypatch, capsys):
    """The package is on no index: 'semloc-jax[bags]' finds nothing; the library itself is found."""
    project = tomllib.loads((Path(__file__).parents[2] / "pyproject.toml").read_text())["project"]
    for extra, requirement in EXTRAS.items():
        assert project["optional-dependencies"][extra] == [requirement]
        assert install_command(extra) == f'{sys.executable} -m pip install "{requirement}"'
    monkeypatch.setattr(selftest, "run_checks", lambda: [])
    monkeypatch.setattr(doctor.importlib.util, "find_spec", lambda name: None)
    main(["doctor"])
    said = capsys.readouterr().out
    assert "semloc-jax[" not in said
    assert all(install_command(extra) in said for extra in EXTRAS)


def _environment(code: str, **extra: str) -> list[str]:
    """Lines printed by a fresh process in which JAX has not been loaded."""
    drop = ("XLA_FLAGS", "JAX_COMPILATION_CACHE_DIR", "TF_CPP_MIN_LOG_LEVEL", "OPENBLAS_NUM_THREADS")
    environment = {key: value for key, value in os.environ.items() if key not in drop} | extra
    code = f"import os\nfrom semloc_jax.runtime import prepare as runtime\n{code}"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, env=environment, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout.splitlines()


SHOW = """runtime.prepare_jax()
print(os.environ.get('XLA_FLAGS', '-'))
print(os.environ.get('JAX_COMPILATION_CACHE_DIR', '-'))"""


def test_the_environment_is_set_before_jax(tmp_path):
    xla_flags, cache = _environment(SHOW, XDG_CACHE_HOME=str(tmp_path))
    assert ("avx512f" in runtime.cpu_features()) == ("--xla_cpu_prefer_vector_width=512" in xla_flags)
    assert cache.startswith(str(tmp_path))


def test_what_the_user_has_set_stays(tmp_path):
    mine = {"XLA_FLAGS": "--xla_cpu_prefer_vector_width=256", "JAX_COMPILATION_CACHE_DIR": str(tmp_path / "mine")}
    xla_flags, cache = _environment(SHOW, **mine)
    assert xla_flags.startswith(mine["XLA_FLAGS"]) and "vector_width=512" not in xla_flags
    assert cache == mine["JAX_COMPILATION_CACHE_DIR"]
    other, _ = _environment(SHOW, XLA_FLAGS="--xla_force_host_platform_device_count=1", XDG_CACHE_HOME=str(tmp_path))
    assert other.startswith("--xla_force_host_platform_device_count=1")


def test_small_matrices_get_one_thread_unless_the_user_says_otherwise():
    show = "runtime.prepare_jax()\nprint(os.environ.get('OPENBLAS_NUM_THREADS', '-'))"
    assert _environment(show) == ["1"]
    assert _environment(show, OPENBLAS_NUM_THREADS="3") == ["3"]
    assert _environment(f"import numpy\n{show}") == ["-"]  # it would say what is not so


def test_a_home_that_cannot_be_written_to_turns_the_cache_off(tmp_path):
    (tmp_path / "file").write_text("no folder can be made below a file")
    assert _environment(SHOW, XDG_CACHE_HOME=str(tmp_path / "file"))[1] == "-"


API = """{first}
import semloc_jax as sj
sj.Rig
import jax
print(jax.config.jax_compilation_cache_dir or '-')"""


def test_one_variable_switches_the_cache_off(tmp_path):
    for code in (SHOW, API.format(first="import jax")):
        assert _environment(code, XDG_CACHE_HOME=str(tmp_path), SEMLOC_CACHE="0")[-1] == "-"


MULTIPLIES = f"""{API}
jax.config.update('jax_persistent_cache_min_compile_time_secs', 0.0)
print(jax.jit(lambda x: x * 3)(1.0))
print(len(list(__import__('pathlib').Path(jax.config.jax_compilation_cache_dir).glob('*-cache'))))"""


@pytest.mark.slow
def test_the_python_api_has_the_cache_and_loads_from_it_without_a_word(tmp_path):
    """Whether JAX is imported already or has even compiled; XLA logs two lines of 2,500 letters for each program that
    it loads."""
    env = {key: value for key, value in os.environ.items() if not key.startswith(("JAX_", "TF_CPP", "SEMLOC_"))}
    env |= {"XDG_CACHE_HOME": str(tmp_path)}
    late = "import jax; jax.jit(lambda x: x + 1)(1.0)"
    for first in (late, "", "import jax", late):  # the first process writes, the others read
        code = MULTIPLIES.format(first=first)
        done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, env=env, check=True)
        cache, product, num_files = done.stdout.splitlines()
        assert cache.startswith(str(tmp_path))
        assert (product, done.stderr) == ("3.0", "")
        assert num_files == "1"  # the flags of all are those of this process
