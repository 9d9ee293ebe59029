"""What is built is what is here: wheel and source archive, installed in an empty environment, work from any folder."""

import os
import subprocess
import sysconfig
import tarfile
import venv
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
pytestmark = pytest.mark.slow
USED = """
import pathlib, semloc_jax as sj
assert pathlib.Path(sj.__file__).is_relative_to(pathlib.Path({home!r})), sj.__file__
assert sj.load_class_table("drive").channels
street = sj.map_from_arrays([("pole", [[0, 0, 0], [0, 0, 5]])])
sj.write_map(street, "street.osm")
"""


def _run(*words, cwd):
    environment = {key: value for key, value in os.environ.items() if not key.startswith("PYTHON")}
    done = subprocess.run([*map(str, words)], cwd=cwd, capture_output=True, text=True, env=environment, check=False)
    assert done.returncode == 0, done.stderr[-2000:]
    return done.stdout


@pytest.fixture(scope="module")
def built(tmp_path_factory):
    """Wheel, source archive and the empty environment that they were built in."""
    folder = tmp_path_factory.mktemp("packages")
    venv.create(folder / "builder", with_pip=True)
    python = folder / "builder" / "bin" / "python"
    got = subprocess.run([python, "-m", "pip", "install", "-q", "hatchling>=1.25"], capture_output=True, text=True)
    if got.returncode != 0:
        pytest.skip(f"hatchling cannot be installed here: {got.stderr.strip().splitlines()[-1][:120]}")
    _run(python, "-m", "hatchling", "build", "-t", "wheel", "-t", "sdist", "-d", folder / "dist", cwd=ROOT)
    return next((folder / "dist").glob("*.whl")), next((folder / "dist").glob("*.tar.gz")), folder


def _sources():
    tracked = subprocess.run(["git", "ls-files", "semloc_jax"], cwd=ROOT, capture_output=True, text=True, check=False)
    if tracked.returncode != 0:
        pytest.skip("no git checkout: which files belong to the package is not known")
    return set(tracked.stdout.split())


def test_every_file_of_the_package_is_in_wheel_and_archive(built):
    wheel, archive, _ = built
    with zipfile.ZipFile(wheel) as packed:
        names = set(packed.namelist())
    assert _sources() <= names
    assert not [name for name in names if name.startswith(("tests/", "notebooks/"))]
    with tarfile.open(archive) as packed:
        held = {name.split("/", 1)[1] for name in packed.getnames() if "/" in name}
    assert _sources() | {"pyproject.toml", "README.md", "LICENSE"} <= held


@pytest.mark.parametrize("kind", ["wheel", "archive"])
def test_it_works_installed_from_any_folder(built, tmp_path, kind):
    wheel, archive, folder = built
    home = tmp_path / "env"
    venv.create(home, with_pip=True)
    python, semloc = home / "bin" / "python", home / "bin" / "semloc"
    packages = next((home / "lib").glob("python*/site-packages"))
    # The libraries come from the environment of the tests; the package does not.
    (packages / "libraries.pth").write_text(sysconfig.get_path("purelib") + "\n")
    path = wheel
    if kind == "archive":
        builder = folder / "builder" / "bin" / "python"
        words = ("-m", "pip", "wheel", "-q", "--no-deps", "--no-build-isolation", "-w", tmp_path, archive)
        _run(builder, *words, cwd=tmp_path)
        path = next(tmp_path.glob("*.whl"))
    _run(python, "-m", "pip", "install", "-q", "--no-deps", "--force-reinstall", path, cwd=tmp_path)
    _run(python, "-c", USED.format(home=str(home)), cwd=tmp_path)
    assert "semloc VERB" in _run(semloc, "--help", cwd=tmp_path)
    assert "pole" in _run(semloc, "inspect", "street.osm", cwd=tmp_path)
