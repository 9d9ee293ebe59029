"""Command lines and configuration files as frozen dataclasses (room: cli).

In: words of the command line, YAML files. Out: the options of a verb, with its configuration in `settings`.
Precedence: defaults < YAML file < command line. Wrong keys are refused with a suggestion, never ignored.
"""

import contextlib
import dataclasses
import difflib
import enum
import io
import re
import typing
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from types import ModuleType
from typing import Annotated, Any

RECORD_KEY = "run"
"""Top-level key of a saved config.yaml that tells how it came about; it is not read back."""


class UsageError(Exception):
    """The command line or a configuration file is wrong (exit code 2)."""


def parse(verb_name: str, verb: ModuleType, words: Sequence[str]) -> Any:
    """Options of a verb.

    Args:
        verb_name: Name of the verb, for messages.
        verb: Its module: `Options` (frozen dataclass) and, where it has a configuration, `settings_type()` that
            returns the class of it. Every field of that class is an option too.
        words: The command line after the verb.

    Returns:
        An instance of `Options`, with the attribute `settings` where the verb has a configuration.

    Raises:
        UsageError: An option, a key or a value is wrong.
        SystemExit: Help was asked for and printed.
    """
    import tyro

    prog = f"semloc {verb_name}"
    if any(word in ("-h", "--help") for word in words):
        # The configuration is left out: its class lives in rooms that take a second to import.
        tyro.cli(verb.Options, prog=prog, args=["--help"], config=(tyro.conf.FlagCreatePairsOff,))
    options_type, from_file = verb.Options, []
    if hasattr(verb, "settings_type"):
        settings_type = verb.settings_type()
        defaults, from_file = _read_config(_config_path(words), verb.Options, settings_type)
        options_type = dataclasses.make_dataclass(
            verb.Options.__name__,
            [("settings", Annotated[settings_type, tyro.conf.arg(name="")], dataclasses.field(default=defaults))],
            bases=(verb.Options,),
            frozen=True,
            kw_only=True,
        )
    _check_flags(words, options_type)
    return _run_tyro(options_type, [*from_file, *words], prog)


def load_settings(path: str | Path | None, settings_type: type) -> Any:
    """The configuration in a YAML file over the defaults of its class; `path` None gives the defaults."""
    return _read_config(None if path is None else str(path), None, settings_type)[0]


def to_plain(value: Any) -> Any:
    """Dataclasses, enumerations, tuples and paths as what YAML can hold."""
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return {field.name: to_plain(getattr(value, field.name)) for field in dataclasses.fields(value)}
    if isinstance(value, Mapping):
        return {str(key): to_plain(item) for key, item in value.items()}
    if isinstance(value, enum.Enum):
        return value.name
    if isinstance(value, tuple | list):
        return [to_plain(item) for item in value]
    return str(value) if isinstance(value, Path) else value


def parse_slice(text: str, option: str = "--frames") -> slice:
    """A Python slice such as `::5`, `10:20` or `-3:`; a single number selects one frame.

    Raises:
        UsageError: The text is not a slice.
    """
    parts = text.strip().removeprefix("[").removesuffix("]").split(":")
    try:
        numbers = [int(part) if part.strip() else None for part in parts]
        if len(numbers) == 1 and numbers[0] is not None:
            return slice(numbers[0], numbers[0] + 1 or None)
        if len(numbers) in (2, 3) and (len(numbers) == 2 or numbers[2] != 0):
            return slice(*numbers)
    except ValueError:
        pass
    raise UsageError(f"{option} '{text}': expected a Python slice such as ::5, 10:20 or -3:, or one number")


def parse_names(text: str | None) -> tuple[str, ...] | None:
    """Names of a comma-separated list; None where nothing was given."""
    names = tuple(name.strip() for name in (text or "").split(",") if name.strip())
    return names or None


def _config_path(words: Sequence[str]) -> str | None:
    path = None
    for index, word in enumerate(words):
        if word == "--config" and index + 1 < len(words):
            path = words[index + 1]
        elif word.startswith("--config="):
            path = word.split("=", 1)[1]
    return path


def _read_config(path: str | None, options_type: type | None, settings_type: type) -> tuple[Any, list[str]]:
    if path is None:
        return settings_type(), []
    content = _read_yaml(path)
    content.pop(RECORD_KEY, None)
    settings_keys = {field.name for field in dataclasses.fields(settings_type)}
    option_keys = {f.name for f in _options_for_files(options_type)} if options_type else set()
    _check_keys(content, settings_type, f"config {path}", option_keys)
    settings_words = list(_flatten({key: value for key, value in content.items() if key in settings_keys}))
    option_words = [
        f"--{key.replace('_', '-')}={_word(value)}"
        for key, value in content.items()
        if key in option_keys and value is not None
    ]
    return _run_tyro(settings_type, settings_words, f"config {path}"), option_words


def _read_yaml(path: str) -> dict[str, Any]:
    import yaml

    if not Path(path).is_file():
        raise UsageError(f"config {path}: no such file; expected a YAML file, 'semloc config' prints one")
    try:
        content = yaml.safe_load(Path(path).read_text(encoding="utf-8"))
    except (yaml.YAMLError, UnicodeDecodeError) as error:
        raise UsageError(f"config {path}: not a YAML file: {' '.join(str(error).split())}") from error
    if content is None:
        return {}
    if not isinstance(content, dict):
        raise UsageError(f"config {path}: holds a {type(content).__name__}; expected keys and values")
    return {str(key).replace("-", "_"): value for key, value in content.items()}


def _options_for_files(options_type: type) -> list[dataclasses.Field]:
    """Options that a file may hold too: the optional ones that do not name the file itself."""
    return [f for f in dataclasses.fields(options_type) if not _is_required(f) and f.name not in ("config", "out")]


def _is_required(field: dataclasses.Field) -> bool:
    return field.default is dataclasses.MISSING and field.default_factory is dataclasses.MISSING


def _nested(owner: type, name: str) -> type | None:
    """The dataclass that a field holds, None for a plain value."""
    hint = typing.get_type_hints(owner).get(name)
    return hint if isinstance(hint, type) and dataclasses.is_dataclass(hint) else None


def _check_keys(content: Mapping[str, Any], owner: type, where: str, more: set[str] = frozenset()) -> None:
    known = [field.name for field in dataclasses.fields(owner)] + sorted(more)
    for key, value in content.items():
        if key not in known:
            raise UsageError(f"{where}: unknown key '{key}'{_hint(key, known) or '; keys: ' + ', '.join(known)}")
        inner = _nested(owner, key) if key not in more else None
        if inner is not None and not isinstance(value, Mapping):
            raise UsageError(f"{where}: '{key}' is {value!r}; expected keys and values of {inner.__name__}")
        if inner is not None:
            _check_keys(value, inner, f"{where}: {key}")


def _flatten(content: Mapping[str, Any], prefix: str = "") -> Iterator[str]:
    """YAML as words of a command line: {a: {b_c: [1, 2]}} -> --a.b-c 1 2."""
    for key, value in content.items():
        name = f"{prefix}{str(key).replace('_', '-')}"
        if isinstance(value, Mapping):
            yield from _flatten(value, f"{name}.")
        elif isinstance(value, list):
            yield f"--{name}"
            yield from (_word(item) for item in value)
        else:
            yield f"--{name}={_word(value)}"


def _word(value: Any) -> str:
    return "None" if value is None else str(value)


def _flags(owner: type, prefix: str = "") -> Iterator[str]:
    """Every `--flag` of a dataclass, nested ones with dots."""
    for field in dataclasses.fields(owner):
        name = f"{prefix}{field.name.replace('_', '-')}"
        inner = _nested(owner, field.name)
        if inner is None:
            yield f"--{name}"
        else:
            yield from _flags(inner, "" if field.name == "settings" else f"{name}.")


def _check_flags(words: Sequence[str], owner: type) -> None:
    known = list(_flags(owner))
    for word in words:
        flag = word.split("=", 1)[0].replace("_", "-")
        if re.match(r"--[a-zA-Z]", flag) and flag not in known:
            raise UsageError(f"unknown option '{flag}'{_hint(flag, known)}")


def _hint(word: str, known: Sequence[str]) -> str:
    close = difflib.get_close_matches(word, known, n=1)
    return f"; did you mean '{close[0]}'?" if close else ""


def _run_tyro(options_type: type, words: Sequence[str], prog: str) -> Any:
    """An instance of the class from the words; what tyro would print in a box becomes one line."""
    import tyro

    said = io.StringIO()
    # Flags take a value (--lock True) everywhere, so that files and command lines say the same.
    with contextlib.redirect_stderr(said):
        try:
            return tyro.cli(options_type, prog=prog, args=list(words), config=(tyro.conf.FlagConversionOff,))
        except SystemExit as stop:
            lines = [line.strip("│ ").strip() for line in said.getvalue().splitlines()]
            lines = [line for line in lines if line and not line.startswith("╭") and not line.startswith("╰")]
            rule = next((i for i, line in enumerate(lines) if line.startswith("─")), len(lines))
            where = f"{prog}: " if prog.startswith("config ") else ""
            raise UsageError(f"{where}{' '.join(lines[:rule]) or 'wrong arguments'}") from stop
