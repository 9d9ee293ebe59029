"""One configuration file for every verb (room: cli).

In: what a file holds, the settings and options of one verb. Out: what of it this verb is told; the rest is checked.
The top level of a file describes the scene; a section named after a verb (track, calibrate, learn, survey) is for that
verb alone. Others accept it and leave it aside, but a misspelt key is refused wherever it stands.
"""

import dataclasses
import importlib
import typing
from collections.abc import Mapping, Sequence
from typing import Any

from semloc_jax.errors import UsageError
from semloc_jax.inputs.config_files import SCENE, check_keys, flat_fields, own_fields, section_of

VERBS = ("localize", "track", "explain", "landscape", "calibrate", "learn", "survey")
"""Verbs that share one file."""


def is_shared(settings: Any) -> bool:
    """Whether the settings are of a verb that shares its file with others."""
    return hasattr(type(settings), "SECTION")


def flat(settings: Any) -> Any:
    """The settings as an instance of a dataclass that has the fields of scene and verb side by side."""
    return settings if section_of(settings) is None else _instance(settings, flat_fields(settings))


def assembled(settings: Any, values: Any) -> Any:
    """The settings with the values of an instance that `flat` made."""
    if section_of(settings) is None:
        return values
    scene = getattr(settings, SCENE)
    given = {field.name: getattr(values, field.name) for field in dataclasses.fields(scene)}
    own = {name: getattr(values, name) for name in own_fields(settings)}
    return dataclasses.replace(settings, **{SCENE: dataclasses.replace(scene, **given)}, **own)


def own_part(content: Mapping[str, Any], settings: Any, options: Sequence[str], where: str) -> dict[str, Any]:
    """What a file tells one verb, with the keys of its own section beside those of the scene.

    Args:
        content: What the file holds.
        settings: Settings of the verb with their defaults.
        options: Names of options of the verb that a file may hold.
        where: The file, for messages.

    Raises:
        UsageError: a key is unknown to every verb, or stands in another place than its own.
    """
    section = section_of(settings)
    scene = settings if section is None else getattr(settings, SCENE)
    known = {*options, *flat_fields(scene)}
    told = {key: value for key, value in content.items() if key in known}
    left = {key: value for key, value in content.items() if key not in known}
    if section is not None and section in left:
        own = left.pop(section)
        _check_section(own, settings, where)
        told |= own
    if left:
        _check_others(left, scene, options, where)
    check_keys({k: v for k, v in told.items() if k not in options}, flat(settings), where)
    return told


def without_shared(content: Mapping[str, Any], own: Sequence[str], where: str) -> dict[str, Any]:
    """What of a file is for a verb with a configuration of its own: the scene that others share is left aside.

    Args:
        content: What the file holds.
        own: Keys of the verb.
        where: The file, for messages.

    Raises:
        UsageError: a key within the shared part is misspelt.
    """
    keys, sections, _ = _shared_keys()
    for key, value in content.items():
        if key in own:
            continue
        if key in sections:
            _check_section(value, sections[key], where)
        elif key in keys:
            check_keys({key: value}, keys[key], where)
    return {key: value for key, value in content.items() if key in own or not (key in sections or key in keys)}


def _shared_keys() -> tuple[dict[str, Any], dict[str, Any], set[str]]:
    """Keys of the scene and sections, each with its settings, and the options of all verbs that share a file."""
    keys, sections, names = {}, {}, set()
    for verb in VERBS:
        module = importlib.import_module(f"semloc_jax.cli.{verb}")
        settings, section = module.default_settings(), section_of(module.default_settings())
        names |= {field.name for field in dataclasses.fields(module.Options)}
        if section is None:
            keys |= {name: settings for name in flat_fields(settings)}
        else:
            sections[section] = settings
    return keys, sections, names


def _check_others(content: Mapping[str, Any], scene: Any, options: Sequence[str], where: str) -> None:
    """Refuse keys that no verb knows, and keys inside of sections that their verb does not know."""
    keys, sections, names = _shared_keys()
    for key, value in content.items():
        homes = [section for section, settings in sections.items() if key in own_fields(settings)]
        if key in sections:
            _check_section(value, sections[key], where)
        elif key in keys:
            check_keys({key: value}, keys[key], where)
        elif homes and key not in names:
            raise UsageError(f"{where}: '{key}' is no part of the scene; write it below '{homes[0]}:'")
        elif key not in names:
            check_keys({key: value}, scene, where, [*options, *keys, *sections])


def _check_section(content: Any, settings: Any, where: str) -> None:
    """Refuse keys in the section of a verb that the verb does not have."""
    section, own = section_of(settings), own_fields(settings)
    if not isinstance(content, Mapping):
        raise UsageError(f"{where}: '{section}' is {content!r}; expected keys: {', '.join(own)}")
    check_keys(content, _instance(settings, own), f"{where}: {section}")


def _instance(settings: Any, values: Mapping[str, Any]) -> Any:
    """An instance of a dataclass with these fields, typed as the settings and their scene have them."""
    hints = typing.get_type_hints(type(settings))
    if section_of(settings) is not None:
        hints = typing.get_type_hints(type(getattr(settings, SCENE))) | hints
    fields = [(name, hints[name], dataclasses.field(default=value)) for name, value in values.items()]
    return dataclasses.make_dataclass(type(settings).__name__, fields, frozen=True)()
