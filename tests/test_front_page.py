"""The public names: all there, loaded on first use, with a helpful refusal of the rest."""

import ast
import importlib
from pathlib import Path
from types import ModuleType

import pytest

import semloc_jax

ROOT = Path(semloc_jax.__file__).parent


@pytest.mark.parametrize("name", semloc_jax.__all__)
def test_every_public_name_is_there(name):
    assert getattr(semloc_jax, name) is not None


def test_all_and_homes_agree():
    names = [name for shown in semloc_jax._ROOMS.values() for name in shown]
    assert len(set(names)) == len(names)
    assert semloc_jax.__all__ == [*names, "__version__"]
    assert set(dir(semloc_jax)) >= set(names)


def test_names_are_those_of_their_rooms():
    for home, names in semloc_jax._ROOMS.items():
        for name in names:
            assert getattr(semloc_jax, name) is getattr(importlib.import_module(f"semloc_jax.{home}"), name)


def test_the_reference_finds_every_name_in_the_source_of_its_module():
    """The pages of the reference are made from sources (`.ci/reference_pages.py`), where a late name is not seen."""
    for names in semloc_jax._ROOMS.values():
        for name in names:
            module = importlib.import_module(getattr(semloc_jax, name).__module__)
            body = ast.parse(Path(module.__file__).read_text(encoding="utf-8")).body
            assert name in {getattr(node, "name", None) for node in body}, f"{name} is not defined in {module.__name__}"


@pytest.mark.parametrize("room", [path.parent.name for path in Path(semloc_jax.__file__).parent.glob("*/__init__.py")])
def test_every_name_at_the_door_of_a_room_is_there(room):
    loaded = importlib.import_module(f"semloc_jax.{room}")
    for name in getattr(loaded, "__all__", ()):
        value = getattr(loaded, name)
        assert value is not None
        assert not isinstance(value, ModuleType), f"{name} of {room} is hidden by a module of the same name"


LATE = [path for path in sorted(ROOT.rglob("__init__.py")) if "door(" in path.read_text(encoding="utf-8")]


@pytest.mark.parametrize("init", LATE, ids=lambda path: path.parent.name)
def test_no_name_that_is_loaded_late_is_that_of_a_module_behind_the_door(init):
    """Whoever imports the module first would get it instead of what the door shows."""
    package = ".".join(init.parent.relative_to(ROOT.parent).parts)
    behind = {path.stem for path in init.parent.iterdir()}
    assert behind.isdisjoint(getattr(importlib.import_module(package), "__all__", ())), package


def test_unknown_name_is_refused():
    with pytest.raises(AttributeError, match="no attribute 'localise'"):
        _ = semloc_jax.localise
