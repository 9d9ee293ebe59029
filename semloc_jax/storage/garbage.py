"""Python's search for garbage, less often while much is made that stays (room: ground; standard library only)."""

import gc
from collections.abc import Iterator
from contextlib import contextmanager

_OBJECTS, _YOUNG, _MIDDLE = 100_000, 20, 20
"""Python's own are 700 (2,000 since 3.14), 10 and 10."""


@contextmanager
def rare_collection() -> Iterator[None]:
    """Collect garbage rarely within the block.

    Every collection walks through all that is alive. Reading a map makes hundreds of thousands of objects and hardly
    any cycle: at the usual rate a third of its time goes into looking for them.
    """
    before = gc.get_threshold()
    gc.set_threshold(_OBJECTS, _YOUNG, _MIDDLE)
    try:
        yield
    finally:
        gc.set_threshold(*before)
