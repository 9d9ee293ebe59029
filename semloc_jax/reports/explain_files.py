"""The files of an explained pose: rows of explain.csv, drive.csv and explain.json (room: reports; host).

In: an Explanation, checks, roles of elements in a drive. Out: rows and records in metres and degrees.
"""

import math
from collections.abc import Sequence

import numpy as np

from semloc_jax.analysis.explain_check import ElementEffect
from semloc_jax.analysis.explain_drive import ElementRole
from semloc_jax.analysis.explanation import Explanation, Holder

DIRECTIONS = ("longitudinal_m", "lateral_m", "heading_deg")
COLUMNS = (
    *("id", "class", "x_m", "y_m", "num_points", "observations", "pull", "residual_px"),
    *(f"share_{name.split('_')[0]}" for name in DIRECTIONS),
    *(f"sigma_without_{name}" for name in DIRECTIONS),
    *("shift_x", "shift_y", "linear_to_m"),
    *(f"linear_{name}" for name in DIRECTIONS),
    *(f"shifted_{name}" for name in DIRECTIONS),
    *(f"removed_{name}" for name in DIRECTIONS),
)
ROLE_COLUMNS = (
    *("id", "class", "frames", "share", "most_share", "frame_of_most_share"),
    *("most_moved_m", "frames_irreplaceable"),
)


def in_units(direction: np.ndarray) -> list[float]:
    """Longitudinal [m], lateral [m], heading [deg], rounded."""
    return [round(float(value), 5) for value in direction * [1.0, 1.0, np.degrees(1.0)]]


def holder_row(holder: Holder) -> list:
    """One line of explain.csv."""
    return [
        holder.id,
        holder.label.name.lower() if holder.label is not None else holder.id,
        *(round(float(value), 3) for value in holder.middle_map[:2]),
        holder.num_samples,
        *(round(value, 4) for value in (holder.observations, holder.pull, holder.residual_px)),
        *(round(float(value), 5) for value in holder.share),
        *in_units(holder.sigma_without),
        *(round(float(value), 4) for value in holder.worst_map[:2]),
        round(holder.linear_to_m, 4),
        *in_units(holder.linear),
        *in_units(holder.shifted),
        *in_units(holder.removed),
    ]


def explanation_record(frame_id: str, found: Explanation, checks: Sequence[ElementEffect]) -> dict:
    """What explain.json holds: everything of explain.csv, derivatives, checks."""

    def holders(some: Sequence[Holder]) -> list[dict]:
        rows = []
        for holder in some:
            row = dict(zip(COLUMNS, holder_row(holder), strict=True))
            row = {k: v if not isinstance(v, float) or math.isfinite(v) else None for k, v in row.items()}
            by_shift = {name: in_units(holder.by_shift[:, k]) for k, name in enumerate("xyz")}
            rows.append(row | {"by_shift_per_m": by_shift, "by_turn_per_deg": in_units(holder.by_turn / 57.29578)})
        return rows

    return {
        "frame": frame_id,
        "directions": DIRECTIONS,
        "T_map_base": found.T_map_base.tolist(),
        "offset_from_localized": in_units(found.offset),
        "is_exact": found.is_exact,
        "ramp_px": found.ramp_px,
        "sigma": in_units(found.sigma),
        "shift_m": found.shift_m,
        "most_missed": found.most_missed.id,
        "holders": holders(found.holders),
        "classes": holders(found.classes),
        "checks": [
            {
                "id": c.holder.id,
                "shifted": in_units(c.shifted),
                "removed": in_units(c.removed),
                "localized": c.is_localized,
            }
            for c in checks
        ],
    }


def role_row(role: ElementRole) -> list:
    numbers = (role.share, role.most_share, role.most_moved_m)
    share, most, moved = (round(float(value), 5) for value in numbers)
    """One line of drive.csv."""
    return [
        role.id,
        role.label.name.lower(),
        role.num_frames,
        share,
        most,
        role.most_share_at,
        moved,
        role.num_irreplaceable,
    ]
