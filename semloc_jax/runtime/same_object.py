"""Results that are kept for the objects they were made from (room: runtime; host).

In: a function of one object that cannot be hashed, as a Rig, and further arguments that can. Out: the same function,
which makes a result once for each object.
"""

from collections import OrderedDict
from collections.abc import Callable
from functools import wraps
from typing import TypeVar

Result = TypeVar("Result")
_KEPT = 16
"""Results of each function: those of one drive, whose frames share their rig."""


def once_for_each(function: Callable[..., Result]) -> Callable[..., Result]:
    """Decorator: the last results, by the identity of the first argument, which must not change, and the others."""
    kept: OrderedDict[tuple, tuple[object, Result]] = OrderedDict()

    @wraps(function)
    def remembered(first: object, *others: object) -> Result:
        key = (id(first), *others)
        if key not in kept:
            kept[key] = first, function(first, *others)  # with the object, so that no other one gets its id
            while len(kept) > _KEPT:
                kept.popitem(last=False)
        return kept[key][1]

    return remembered
