"""Doors of rooms: public names that are loaded on first use (room: ground; standard library only).

In: the names of each module of a room. Out: `__getattr__`, `__dir__` and `__all__` for its `__init__`.
A room with a door can be imported without loading what stands in it.
"""

import importlib
import sys
from collections.abc import Callable
from typing import Any


def door(
    room: str, names: dict[str, tuple[str, ...]], before_loading: Callable[[], None] = lambda: None
) -> tuple[Callable[[str], Any], Callable[[], list[str]], list[str]]:
    """`__getattr__`, `__dir__` and `__all__` of a room.

    Args:
        room: Its full name.
        names: What each of its modules shows, in the order of the data flow. No name is that of a module.
        before_loading: Called before a name is loaded.
    """
    home = {name: module for module, shown in names.items() for name in shown}

    def load(name: str) -> Any:
        if name not in home:
            raise AttributeError(f"module {room!r} has no attribute {name!r}; its names are {', '.join(home)}")
        before_loading()
        value = getattr(importlib.import_module(f"{room}.{home[name]}"), name)
        setattr(sys.modules[room], name, value)
        return value

    return load, lambda: sorted(home), list(home)
