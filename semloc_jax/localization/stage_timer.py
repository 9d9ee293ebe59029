"""How long each stage of a frame takes (room: localization; host).

In: the end of each stage. Out: milliseconds by stage.
"""

import time


class StageTimer:
    """Time spent by stage since it was made."""

    def __init__(self) -> None:
        """Starts now."""
        self.times_ms: dict[str, float] = {}
        self._last = time.perf_counter()

    def lap(self, name: str) -> None:
        """The stage of that name ends now."""
        now = time.perf_counter()
        self.times_ms[name] = 1e3 * (now - self._last)
        self._last = now
