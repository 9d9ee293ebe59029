"""The rows of the hostile suite: every fault in every severity (room: simulation; host).

In: what is wanted. Out: FaultRow, whose name `with_fault` takes.
"""

from dataclasses import dataclass

from semloc_jax.errors import SemlocError
from semloc_jax.simulation.passing_faults import PASSING
from semloc_jax.simulation.standing_faults import FAMILIES, NUM_SEVERITIES, STANDING

ALL = "all"


@dataclass(frozen=True)
class FaultRow:
    """One fault in one severity, as the hostile suite lists it.

    Args:
        fault: its name.
        severity: 1, 2 or 3; 0 for none.
        size: with its unit.
        family: what is wrong: map, calibration, time, odometry, gnss or masks.
        apart: why nothing can see it; empty where something can.
    """

    fault: str
    severity: int
    size: str
    family: str
    apart: str = ""

    @property
    def name(self) -> str:
        """As `with_fault` takes it."""
        return f"{self.fault}:{self.severity}" if self.severity else self.fault


def suite(wanted: str = ALL) -> tuple[FaultRow, ...]:
    """The rows of the hostile suite, what they are compared with first.

    Args:
        wanted: `all`, a family, a fault (all its severities), a fault with its severity; several with commas.

    Raises:
        SemlocError: there is none of that name.
    """
    rows = [FaultRow("none", 0, "", "")]
    for name, fault in (*STANDING.items(), *PASSING.items()):
        for k in range(NUM_SEVERITIES):
            apart = fault.apart if name in STANDING and k < fault.apart_to else ""
            rows.append(FaultRow(name, k + 1, f"{fault.sizes[k]:g} {fault.unit}", fault.family, apart))
    if wanted == ALL:
        return tuple(rows)
    words = [word.strip() for word in wanted.split(",")]
    unknown = [word for word in words if not any(word in (r.fault, r.name, r.family) for r in rows)]
    if unknown:
        raise SemlocError(
            f"fault '{unknown[0]}': not known; expected all, a family ({', '.join(FAMILIES)}) or one of "
            f"{', '.join(dict.fromkeys(r.fault for r in rows))}, with a severity as in focal:2 or without"
        )
    return tuple(r for r in rows if any(word in (r.fault, r.name, r.family) for word in words))


def is_suite(wanted: str) -> bool:
    """Whether several faults are asked for, not one in one severity."""
    return wanted == ALL or wanted in FAMILIES or "," in wanted
