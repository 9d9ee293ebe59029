"""Types and shapes checked while tests run, made for each function when it is first called.

Making all checks at import takes 6 CPU seconds in every test process, and most functions are never called in it.
"""

import functools
from types import FunctionType

import jaxtyping

CHECKED_CALLS = 200
"""Of each function in each process: one that is called more often is the inside of a loop, and its check, 50 us, would
take longer than what it does."""

_at_once = jaxtyping.jaxtyped


def check_types_of(package: str) -> None:
    """Check arguments and results of every function of a package that is imported from now on."""
    jaxtyping.jaxtyped = _late  # what the import hook decorates with
    jaxtyping.install_import_hook(package, "beartype.beartype")


def _late(*things: object, typechecker: object) -> object:
    """`jaxtyping.jaxtyped`: of a function when it is first called, of a class at once."""
    if not things:
        return functools.partial(_late, typechecker=typechecker)
    (thing,) = things
    if not isinstance(thing, FunctionType):
        return _at_once(thing, typechecker=typechecker)
    checking, left = None, CHECKED_CALLS

    @functools.wraps(thing)
    def checked(*args: object, **kwargs: object) -> object:
        nonlocal checking, left
        if not left:
            return thing(*args, **kwargs)
        left -= 1
        checking = checking or _at_once(thing, typechecker=typechecker)
        return checking(*args, **kwargs)

    return checked
