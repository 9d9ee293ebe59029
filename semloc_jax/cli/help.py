"""What `semloc VERB --help` prints (room: cli).

In: the options of a verb. Out: its text, 80 columns wide: what the verb does, then every option with its meaning.
"""

import ast
import contextlib
import dataclasses
import inspect
import io
import itertools
import re
import sys
import textwrap
import typing
from collections.abc import Iterator

_WIDTH = 80


def help_text(options_type: type, prog: str) -> str:
    """The help of a verb.

    Args:
        options_type: A frozen dataclass; the text below each field says what it means.
        prog: The command, e.g. `semloc localize`.
    """
    import tyro

    # Boxes are drawn with the signs that the terminal has.
    said = io.TextIOWrapper(io.BytesIO(), encoding=sys.stdout.encoding or "ascii")
    with contextlib.redirect_stdout(said), contextlib.suppress(SystemExit):
        tyro.cli(_as_shown(options_type), prog=prog, args=["--help"], config=(tyro.conf.FlagCreatePairsOff,))
    said.seek(0)
    lines = said.read().splitlines()
    boxes = next(index for index, line in enumerate(lines) if re.match(r"\W*(positional arguments|options)\b", line))
    usage = "\n".join(lines[:boxes]).split("\n\n", 1)[0]
    paragraphs = [usage, *re.split(r"\n\s*\n", inspect.cleandoc(options_type.__doc__ or ""))]
    head = [textwrap.fill(" ".join(text.split()), _WIDTH, break_on_hyphens=False) for text in paragraphs]
    return "\n\n".join([*head, "\n".join(lines[boxes:])])


def _as_shown(options_type: type) -> type:
    """The options with the words that a reader needs: no `{None}|PATH`, no default that is nothing."""
    import tyro

    texts = dict(_texts_of_fields(options_type))
    types = typing.get_type_hints(options_type, include_extras=True)
    fields = []
    for field in dataclasses.fields(options_type):
        kind, plain = types[field.name], typing.get_type_hints(options_type)[field.name]
        hint = "" if field.default is None or field.default is False or field.default in ("", ()) else None
        if field.default is dataclasses.MISSING and typing.get_origin(plain) is tuple:
            hint = "(required)"
        # `help=` keeps the lines of the source together, which tyro would break where one begins with a sign.
        shown = tyro.conf.arg(help=texts.get(field.name), help_behavior_hint=hint, metavar=_metavar(kind, plain))
        given = dataclasses.field(default=field.default) if field.default is not dataclasses.MISSING else None
        name = (field.name, typing.Annotated[kind, shown])
        fields.append(name if given is None else (*name, given))
    return dataclasses.make_dataclass(options_type.__name__, fields, frozen=True, kw_only=True)


def _metavar(kind: typing.Any, plain: typing.Any) -> str | None:
    """The word for the value of an option that may be left out: PATH for `Path | None`."""
    if any(getattr(extra, "metavar", None) for extra in getattr(kind, "__metadata__", ())):
        return next(extra.metavar for extra in kind.__metadata__ if getattr(extra, "metavar", None))
    others = [part for part in typing.get_args(plain) if part is not type(None)]
    if type(None) not in typing.get_args(plain) or len(others) != 1:
        return None
    choices = typing.get_args(others[0])
    return f"{{{','.join(map(str, choices))}}}" if choices else others[0].__name__.upper()


def _texts_of_fields(options_type: type) -> Iterator[tuple[str, str]]:
    """Each field and the text below it in the source; those of a subclass come last."""
    for cls in reversed([cls for cls in options_type.__mro__ if dataclasses.is_dataclass(cls)]):
        body = ast.parse(textwrap.dedent(inspect.getsource(cls))).body[0].body
        for field, below in itertools.pairwise(body):
            if isinstance(field, ast.AnnAssign) and isinstance(below, ast.Expr):
                yield field.target.id, " ".join(str(below.value.value).split())
