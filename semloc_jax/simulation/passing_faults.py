"""How bad faults that pass are in three severities (room: simulation; host).

In: nothing. Out: PASSING, the sizes by the name of the fault.
"""

from dataclasses import dataclass

from semloc_jax.simulation.standing_faults import GNSS, MAP, MASKS, ODOMETRY


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
