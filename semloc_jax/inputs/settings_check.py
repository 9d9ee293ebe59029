"""Numbers of a configuration that cannot be meant (room: inputs).

In: a dataclass of settings or options, from the command line or a file. Out: nothing, or the sentence that helps.
A limit of NaN compares false with everything: what it was to keep out comes in without a word.
"""

import dataclasses
import math
from collections.abc import Iterator
from typing import Any

from semloc_jax.errors import UsageError

_COUNTS = ("num_", "max_iterations")
_POSITIVE = ("sigma_", "_sigma", "rate_hz", "radius_m", "spacing_m", "capacity")
MOST_HYPOTHESES = 1 << 17
"""Start poses whose scores a search still holds at once, with some GB; ours."""
_MOST = {"num_hypotheses": MOST_HYPOTHESES, "hypotheses": MOST_HYPOTHESES}
_LEAST = {"hypotheses": 1, "num_hypotheses": 1}


def require_plausible(settings: Any, where: str = "") -> None:
    """Look through every number of a dataclass and of the dataclasses in it.

    Args:
        settings: an instance of a dataclass.
        where: before the name of each option in messages, e.g. `--`.

    Raises:
        UsageError: NaN, an infinite number where the default is none, a size that is negative, or zero where none may
            be, or more than fits.
    """
    for name, value, default in _numbers(settings, ""):
        fault = _fault(name.split(".")[-1], value, default)
        if fault is not None:
            option = name.replace("_", "-")
            raise UsageError(f"{where}{option} {value}: expected {fault}")


def _numbers(settings: Any, prefix: str) -> Iterator[tuple[str, float | int, Any]]:
    """Name with its path, value and default of every number."""
    for item in dataclasses.fields(settings):
        value, name = getattr(settings, item.name), prefix + item.name
        if dataclasses.is_dataclass(value):
            yield from _numbers(value, "" if name in ("settings", "scene") else f"{name}.")
        elif isinstance(value, (int, float)) and not isinstance(value, bool):
            yield name, value, item.default
        elif isinstance(value, tuple):
            numbers = (v for v in value if isinstance(v, (int, float)) and not isinstance(v, bool))
            yield from ((name, v, None) for v in numbers)


def _fault(name: str, value: float | int, default: Any) -> str | None:
    """What was expected instead of a number; None where it may be meant. A default is always meant."""
    if isinstance(default, (int, float)) and value == default:
        return None
    if math.isnan(value) or (math.isinf(value) and not (isinstance(default, float) and math.isinf(default))):
        return "a finite number"
    if name in _LEAST and value < _LEAST[name]:
        return f"at least {_LEAST[name]}"
    if name in _MOST and value > _MOST[name]:
        return f"at most {_MOST[name]}"
    if name.startswith(_COUNTS) and value < 0:
        return "no negative number"
    if any(part in f"{name}_" for part in _POSITIVE) and not value > 0:
        return "more than 0"
    return None
