"""Command lines as frozen dataclasses (room: cli).

In: words of the command line. Out: the options of a verb, with its configuration in `settings`.
Precedence: defaults < YAML file < command line.
"""

import contextlib
import dataclasses
import io
import re
from collections.abc import Sequence
from types import ModuleType
from typing import Annotated, Any

from semloc_jax.cli.help import help_text
from semloc_jax.cli.shared_config import assembled, flat, is_shared, own_part, without_shared
from semloc_jax.errors import UsageError
from semloc_jax.inputs.config_files import check_keys, flags, flatten, read_yaml, suggestion, with_lengths
from semloc_jax.inputs.paths import pinned_options
from semloc_jax.inputs.settings_check import require_plausible

NOT_IN_FILES = ("config", "out")
"""Options that a configuration file cannot hold."""


def parse(verb_name: str, verb: ModuleType, words: Sequence[str]) -> Any:
    """Options of a verb.

    Args:
        verb_name: Name of the verb, for messages.
        verb: Its module: `Options` (frozen dataclass) and, where it has a configuration, `default_settings()`. Every
            field of the settings is an option too.
        words: The command line after the verb.

    Returns:
        An instance of `Options`, with the attribute `settings` where the verb has a configuration. Paths through the
        link results/latest name the run that it points to now.

    Raises:
        UsageError: An option, a key or a value is wrong.
        SystemExit: Help was asked for and printed.
    """
    prog = f"semloc {verb_name}"
    if any(word in ("-h", "--help") for word in words):
        # The configuration is left out: its class lives in rooms that take a second to import.
        print(help_text(verb.Options, prog))
        raise SystemExit(0)
    options_type, from_file = verb.Options, []
    known = [f"--{field.name.replace('_', '-')}" for field in dataclasses.fields(verb.Options)]
    if hasattr(verb, "default_settings"):
        settings = verb.default_settings()
        path = _config_path(words)
        if path is not None:
            settings, from_file = read_settings(path, verb.Options, settings)
        values = flat(settings)
        known += flags(values)
        options_type = _type_with_settings(verb.Options, _values_only(type(values)), values)
    for word in words:
        flag = word.split("=", 1)[0].replace("_", "-")
        if re.match(r"--[a-zA-Z]", flag) and flag not in known:
            raise UsageError(f"unknown option '{flag}'{suggestion(flag, known)}")
    options = _run_tyro(options_type, [*from_file, *words], prog)
    if hasattr(verb, "default_settings"):
        options = dataclasses.replace(options, settings=assembled(settings, options.settings))
    require_plausible(options, "--")
    return pinned_options(options)


def with_settings(options_type: type, values: dict[str, Any]) -> Any:
    """Options as `parse` makes them, from the values of their fields and of `settings`."""
    settings = values["settings"]
    return _type_with_settings(options_type, type(settings), settings)(**values)


def _type_with_settings(options_type: type, settings_type: Any, default: Any) -> type:
    return dataclasses.make_dataclass(
        options_type.__name__,
        [("settings", settings_type, dataclasses.field(default=default))],
        bases=(options_type,),
        frozen=True,
        kw_only=True,
    )


def read_settings(path: str, options_type: type, defaults: Any) -> tuple[Any, list[str]]:
    """The settings of a file over the defaults, and the options of the verb in it as words of a command line.

    Raises:
        UsageError: The file is missing, holds an unknown key or a wrong value.
    """
    content = read_yaml(path)
    optional = [f.name for f in dataclasses.fields(options_type) if f.default is not dataclasses.MISSING]
    option_keys = [name for name in optional if name not in NOT_IN_FILES]
    if is_shared(defaults):
        content = own_part(content, defaults, option_keys, f"config {path}")
    else:
        content = without_shared(
            content, [*(f.name for f in dataclasses.fields(defaults)), *option_keys], f"config {path}"
        )
        check_keys(content, defaults, f"config {path}", option_keys)
    values = flat(defaults)
    for_verb = {key: value for key, value in content.items() if key in option_keys and value is not None}
    for_settings = {key: value for key, value in content.items() if key not in option_keys}
    values = with_lengths(values, for_settings)
    values = _run_tyro(_values_only(type(values)), list(flatten(for_settings)), f"config {path}", values)
    settings = assembled(defaults, values)
    switches = [f"--{key.replace('_', '-')}" for key, value in for_verb.items() if value is True]
    others = {key: value for key, value in for_verb.items() if not isinstance(value, bool)}
    return settings, [*switches, *flatten(others)]


def _config_path(words: Sequence[str]) -> str | None:
    path = None
    for index, word in enumerate(words):
        if word == "--config" and index + 1 < len(words):
            path = words[index + 1]
        elif word.startswith("--config="):
            path = word.split("=", 1)[1]
    return path


def _values_only(settings_type: type) -> Any:
    """The settings as nameless options whose flags take a value (--lock True), so that files can say the same."""
    import tyro

    return Annotated[settings_type, tyro.conf.arg(name=""), tyro.conf.FlagConversionOff]


def _run_tyro(options_type: Any, words: Sequence[str], prog: str, default: Any = None) -> Any:
    """An instance of the class from the words; what tyro would print in a box becomes one line."""
    import tyro

    said = io.StringIO()
    given = {} if default is None else {"default": default}
    with contextlib.redirect_stderr(said):
        try:
            return tyro.cli(options_type, prog=prog, args=list(words), config=(tyro.conf.FlagCreatePairsOff,), **given)
        except SystemExit as stop:
            lines = [line.strip("│ ").strip() for line in said.getvalue().splitlines()]
            lines = [line for line in lines if line and line[0] not in "╭╰"]
            rule = next((i for i, line in enumerate(lines) if line.startswith("─")), len(lines))
            where = f"{prog}: " if prog.startswith("config ") else ""
            reason = re.sub(r"\s+\.$", "", " ".join(lines[:rule]))
            raise UsageError(f"{where}{reason or 'wrong arguments'}") from stop
