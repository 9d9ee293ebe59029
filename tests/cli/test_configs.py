"""The configurations that come with the repository load, change what they say, and nothing they do not say."""

from pathlib import Path

import pytest
import yaml

from semloc_jax.cli import localize
from semloc_jax.cli.arguments import read_settings
from semloc_jax.inputs.config_files import to_plain

CONFIGS = sorted((Path(__file__).resolve().parents[2] / "configs").glob("*.yaml"))


def _leaves(content, prefix=()):
    for key, value in content.items():
        if isinstance(value, dict):
            yield from _leaves(value, (*prefix, key))
        else:
            yield (*prefix, key), value


def test_the_four_places_and_what_was_learned_are_there():
    assert [path.stem for path in CONFIGS] == ["garage", "highway", "learned", "surround", "urban"]


@pytest.mark.parametrize("path", CONFIGS, ids=lambda path: path.stem)
def test_a_configuration_changes_just_what_it_says(path):
    defaults = localize.default_settings()
    settings, words = read_settings(str(path), localize.Options, defaults)
    said = dict(_leaves(yaml.safe_load(path.read_text())))
    before, after = dict(_leaves(to_plain(defaults))), dict(_leaves(to_plain(settings)))
    assert words == []
    assert said
    assert {key: value for key, value in after.items() if value != before[key]} == {
        key: value for key, value in said.items() if value != before[key]
    }
    assert any(value != before[key] for key, value in said.items()), "a file that changes nothing is not needed"
