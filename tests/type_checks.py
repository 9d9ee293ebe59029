"""Types and shapes of all calls inside the package, checked while tests run; the check of a function is made when it is
first called.

jaxtyping's own decorator makes two checks of each function, at import: 20 CPU seconds in every test process, and most
functions are never called in it.
"""

import dataclasses
import functools
import inspect
from types import FunctionType

import jaxtyping
from beartype import BeartypeConf, beartype
from jaxtyping._decorator import _destring_annotation
from jaxtyping._storage import pop_shape_memo, push_shape_memo, shape_str

_at_once = jaxtyping.jaxtyped
_with_checks = beartype(conf=BeartypeConf(violation_type=jaxtyping.TypeCheckError))
"""What does not fit is a TypeError, as it is in Python."""


def check_types_of(package: str) -> None:
    """Check arguments and results of every function and dataclass of a package that is imported from now on."""
    jaxtyping.jaxtyped = _checked  # what the import hook decorates with
    jaxtyping.install_import_hook(package, "beartype.beartype")


def _checked(*things: object, typechecker: object) -> object:
    """In place of `jaxtyping.jaxtyped`."""
    if not things:
        return functools.partial(_checked, typechecker=typechecker)
    (thing,) = things
    if inspect.isclass(thing):
        if dataclasses.is_dataclass(thing) and not hasattr(thing.__init__, "checks_types"):
            thing.__init__ = _late(thing.__init__)
        return thing
    if not isinstance(thing, FunctionType) or inspect.isgeneratorfunction(thing):
        return _at_once(thing, typechecker=typechecker)
    return _late(thing) if thing.__annotations__ else thing


def _late(function: FunctionType) -> FunctionType:
    """The function, with axes of the same name as long as each other within a call."""
    checking = None

    @functools.wraps(function)
    def checked(*args: object, **kwargs: object) -> object:
        nonlocal checking
        if checking is None:
            checking = _with_checks(_with_known_types(function))
        axes = push_shape_memo({})
        try:
            return checking(*args, **kwargs)
        except jaxtyping.TypeCheckError as error:
            if not hasattr(error, "__notes__"):
                error.add_note(f"in {function.__module__}.{function.__qualname__}. {shape_str(axes)}")
            raise
        finally:
            pop_shape_memo()

    checked.checks_types = True
    return checked


def _with_known_types(function: FunctionType) -> FunctionType:
    """Names of types that are known by now are those types; what only a type checker imports may be anything."""
    known = {name: _destring_annotation(hint, function.__globals__) for name, hint in function.__annotations__.items()}
    function.__annotations__ = known
    return function
