"""The public names: all there, loaded on first use, with a helpful refusal of the rest."""

import importlib

import pytest

import semloc_jax


@pytest.mark.parametrize("name", semloc_jax.__all__)
def test_every_public_name_is_there(name):
    assert getattr(semloc_jax, name) is not None


def test_all_and_homes_agree():
    assert set(semloc_jax.__all__) == {*semloc_jax._HOME, "__version__"}
    assert set(dir(semloc_jax)) >= set(semloc_jax.__all__)


def test_names_are_those_of_their_rooms():
    for name, home in semloc_jax._HOME.items():
        assert getattr(semloc_jax, name) is getattr(importlib.import_module(f"semloc_jax.{home}"), name)


def test_unknown_name_is_refused():
    with pytest.raises(AttributeError, match="no attribute 'localise'"):
        _ = semloc_jax.localise
