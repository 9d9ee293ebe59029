"""What every row of a hostile suite says, of tracked drives and of single frames (room: analysis; host).

In: reasons of frames. Out: RowOutcome, the reason that was told most often.
"""

import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass


def most_told(reasons: Sequence[Sequence[str]]) -> str:
    """The first reason of most frames; sentences that differ in their numbers only are one."""
    first = [told[0] for told in reasons if told]
    if not first:
        return ""
    kinds = [re.sub(r"[-+]?[0-9.]+", "#", text) for text in first]
    kind, _ = Counter(kinds).most_common(1)[0]
    return next(text for text, own in zip(first, kinds, strict=True) if own == kind)


@dataclass(frozen=True)
class RowOutcome:
    """One row of a hostile suite; *good* is a frame that is called TRACKING, or localized.

    Args:
        fault: its name.
        severity: 1, 2 or 3; 0 without a fault.
        size: of the fault, with its unit.
        family: what is wrong.
        apart: why nothing can see it; empty where something can.
        frames: number of frames.
        false: good frames with an error beyond a protection level.
        beyond_alert: good frames with an error beyond an alert limit.
        refused_right: frames whose pose is within the alert limits and that are not called good.
        max_lateral_m: largest error of a good frame [m].
        max_longitudinal_m: the same along the vehicle [m].
        max_heading_deg: the same of the heading [deg].
        reason: what was told most often where a frame was not good.
    """

    fault: str
    severity: int
    size: str
    family: str
    apart: str
    frames: int
    false: int
    beyond_alert: int
    refused_right: int
    max_lateral_m: float
    max_longitudinal_m: float
    max_heading_deg: float
    reason: str

    @property
    def counts(self) -> bool:
        """Whether the row is one of what was asked for: a fault that something can see."""
        return bool(self.severity) and not self.apart
