"""Configuration files: YAML against frozen dataclasses (room: inputs).

In: a YAML file, the defaults. Out: words of a command line that set what the file sets; dataclasses as plain YAML.
Wrong keys are refused with a suggestion, never ignored.
"""

import dataclasses
import difflib
import enum
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from semloc_jax.errors import UsageError

RECORD_KEY = "run"
"""Top-level key of a saved config.yaml that tells how it came about; it is not read back."""


def read_yaml(path: str | Path) -> dict[str, Any]:
    """Keys and values of a configuration file, without the record of the run that wrote it.

    Raises:
        UsageError: there is no such file, or it holds something else.
    """
    import yaml

    if not Path(path).is_file():
        raise UsageError(f"config {path}: no such file; expected a YAML file, 'semloc config' prints one")
    try:
        content = yaml.safe_load(Path(path).read_text(encoding="utf-8"))
    except (yaml.YAMLError, UnicodeDecodeError, RecursionError, ValueError) as error:
        raise UsageError(f"config {path}: not a YAML file: {' '.join(str(error).split())}") from error
    if not isinstance(content, dict | None):
        raise UsageError(f"config {path}: holds a {type(content).__name__}; expected keys and values")
    return {str(key).replace("-", "_"): value for key, value in (content or {}).items() if key != RECORD_KEY}


def check_keys(content: Mapping[str, Any], defaults: Any, where: str, more: Sequence[str] = ()) -> None:
    """Refuse keys that the dataclass does not have.

    Args:
        content: What the file holds.
        defaults: Instance of the dataclass.
        where: The file and the place in it, for messages.
        more: Keys that are allowed besides.

    Raises:
        UsageError: a key is unknown, or holds a plain value where keys and values are expected.
    """
    known = [*_names(defaults), *more]
    for key, value in content.items():
        if key not in known:
            raise UsageError(f"{where}: unknown key '{key}'{suggestion(key, known) or '; keys: ' + ', '.join(known)}")
        default = getattr(defaults, key, None)
        if is_settings(default):
            if not isinstance(value, Mapping):
                raise UsageError(f"{where}: '{key}' is {value!r}; expected keys: {', '.join(_names(default))}")
            check_keys(value, default, f"{where}: {key}")
        elif _is_list_of_settings(default):
            if not isinstance(value, list) or not value or not all(isinstance(item, Mapping) for item in value):
                raise UsageError(f"{where}: '{key}' is {value!r}; expected a list of {', '.join(_names(default[0]))}")
            for index, item in enumerate(value):
                check_keys(item, default[0], f"{where}: {key}[{index}]")


def with_lengths(defaults: Any, content: Mapping[str, Any]) -> Any:
    """The defaults with as many items in each list of dataclasses as the file has; new items copy the last one."""
    changes = {}
    for key, value in content.items():
        default = getattr(defaults, key)
        if is_settings(default):
            changes[key] = with_lengths(default, value)
        elif _is_list_of_settings(default):
            items = [default[min(index, len(default) - 1)] for index in range(len(value))]
            changes[key] = tuple(with_lengths(item, given) for item, given in zip(items, value, strict=True))
    return dataclasses.replace(defaults, **changes) if changes else defaults


def flatten(content: Mapping[str, Any], prefix: str = "") -> Iterator[str]:
    """YAML as words of a command line: {a: {b_c: [1, 2]}} -> --a.b-c 1 2."""
    for key, value in content.items():
        name = f"{prefix}{str(key).replace('_', '-')}"
        if isinstance(value, Mapping):
            yield from flatten(value, f"{name}.")
        elif isinstance(value, list) and value and all(isinstance(item, Mapping) for item in value):
            yield from flatten({str(index): item for index, item in enumerate(value)}, f"{name}.")
        elif isinstance(value, list):
            yield f"--{name}"
            yield from (str(item) for item in value)
        else:
            yield f"--{name}={value}"


def flags(defaults: Any, prefix: str = "") -> Iterator[str]:
    """Every `--flag` of an instance of a dataclass; nested ones have dots, items of lists their number."""
    for name in _names(defaults):
        value, flag = getattr(defaults, name), f"{prefix}{name.replace('_', '-')}"
        if is_settings(value):
            yield from flags(value, f"{flag}.")
        elif _is_list_of_settings(value):
            for index, item in enumerate(value):
                yield from flags(item, f"{flag}.{index}.")
        else:
            yield f"--{flag}"


def to_plain(value: Any) -> Any:
    """Dataclasses, enumerations, tuples and paths as what YAML can hold."""
    if is_settings(value):
        return {name: to_plain(getattr(value, name)) for name in _names(value)}
    if isinstance(value, Mapping):
        return {str(key): to_plain(item) for key, item in value.items()}
    if isinstance(value, enum.Enum):
        return value.name
    if isinstance(value, tuple | list):
        return [to_plain(item) for item in value]
    return str(value) if isinstance(value, Path) else value


SCENE = "scene"
"""Field of the settings of a verb whose fields stand at the top level of a file."""


def section_of(settings: Any) -> str | None:
    """Name of the section of a file that holds the settings of a verb; None where they stand at the top level."""
    return getattr(type(settings), "SECTION", None)


def own_fields(settings: Any) -> dict[str, Any]:
    """What a verb has to say besides the scene, by name."""
    return {name: getattr(settings, name) for name in _names(settings) if name != SCENE}


def flat_fields(settings: Any) -> dict[str, Any]:
    """Settings as options of a command line: the fields of the scene and those of the verb side by side."""
    if section_of(settings) is None:
        return {name: getattr(settings, name) for name in _names(settings)}
    return flat_fields(getattr(settings, SCENE)) | own_fields(settings)


def to_file(settings: Any) -> dict[str, Any]:
    """Settings as a configuration file holds them: the scene at the top level, the rest in the section of the verb."""
    if section_of(settings) is None:
        return to_plain(settings)
    return to_plain(getattr(settings, SCENE)) | {section_of(settings): to_plain(own_fields(settings))}


def suggestion(word: str, known: Sequence[str]) -> str:
    """`; did you mean '...'?` where a known word is close, else nothing."""
    close = difflib.get_close_matches(word, known, n=1)
    return f"; did you mean '{close[0]}'?" if close else ""


def is_settings(value: Any) -> bool:
    """Whether the value is an instance of a dataclass."""
    return dataclasses.is_dataclass(value) and not isinstance(value, type)


def _is_list_of_settings(value: Any) -> bool:
    return isinstance(value, tuple) and bool(value) and all(is_settings(item) for item in value)


def _names(settings: Any) -> list[str]:
    return [field.name for field in dataclasses.fields(settings)]
