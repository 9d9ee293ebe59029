"""The rows of the hostile suite: every fault in every severity (room: simulation; host).

In: what is wanted. Out: FaultRow, whose name `with_fault` takes; PASSING, the sizes of faults that pass.
"""

from dataclasses import dataclass

from semloc_jax.errors import SemlocError
from semloc_jax.simulation.standing_faults import FAMILIES, GNSS, MAP, MASKS, NUM_SEVERITIES, ODOMETRY, STANDING


@dataclass(frozen=True)
class PassingFault:
    """The size of FaultSizes that makes a passing fault worse.

    Args:
        field: of FaultSizes.
        sizes: its values in the severities 1, 2 and 3.
        unit: of the sizes.
        family: what is wrong.
    """

    field: str
    sizes: tuple[float, float, float]
    unit: str
    family: str


PASSING: dict[str, PassingFault] = {
    "gnss_dropout": PassingFault("dropout_s", (5.0, 10.0, 30.0), "s", GNSS),
    "gnss_outliers": PassingFault("outlier_share", (0.05, 0.2, 0.5), "share of the fixes", GNSS),
    "no_gnss_after_start": PassingFault("fixes_until_s", (4.0, 2.0, 1.0), "s until then", GNSS),
    "black_images": PassingFault("short_s", (1.0, 3.0, 6.0), "s", MASKS),
    "occlusion": PassingFault("short_s", (1.0, 3.0, 6.0), "s", MASKS),
    "wrong_class_table": PassingFault("short_s", (1.0, 3.0, 6.0), "s", MASKS),
    "no_odometry": PassingFault("odometry_s", (1.0, 2.0, 5.0), "s", ODOMETRY),
    "kidnapped": PassingFault("jump_m", (10.0, 20.0, 30.0), "m", ODOMETRY),
    "off_map": PassingFault("begin_share", (0.7, 0.45, 0.2), "share of the drive", MAP),
}
"""Faults of `FAULTS` that the hostile suite takes in three severities."""


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
