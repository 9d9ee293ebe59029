"""What was told most often (room: analysis; host).

In: reasons of frames. Out: one of them.
"""

import re
from collections import Counter
from collections.abc import Sequence


def most_told(reasons: Sequence[Sequence[str]]) -> str:
    """The first reason of most frames; sentences that differ in their numbers only are one."""
    first = [told[0] for told in reasons if told]
    if not first:
        return ""
    kinds = [re.sub(r"[-+]?[0-9.]+", "#", text) for text in first]
    kind, _ = Counter(kinds).most_common(1)[0]
    return next(text for text, own in zip(first, kinds, strict=True) if own == kind)
