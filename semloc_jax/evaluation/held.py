"""Which directions of a pose are held, and what would hold the others (room: evaluation).

In: bounds or standard deviations of a pose, and their limits. Out: names of directions, and a sentence for people.
"""

from collections.abc import Sequence

DIRECTIONS = ("across", "along", "heading")
"""Lateral [m], longitudinal [m] and heading [deg], in this order everywhere."""
HELP = {
    "across": "lane lines or kerbs that run along the road",
    "along": "signs, posts, stop lines or ends of dashes, or satellite fixes",
    "heading": "lines or posts farther ahead, or odometry",
}
_UNITS = {"across": "m", "along": "m", "heading": "deg"}


def held_directions(bounds: Sequence[float], limits: Sequence[float], doubted: Sequence[str] = ()) -> tuple[str, ...]:
    """The directions whose bound is within its limit.

    Args:
        bounds: lateral [m], longitudinal [m], heading [deg]; not finite where nothing is known.
        limits: of the same.
        doubted: directions that are open whatever their bound says.

    >>> held_directions((0.08, 1.4, 0.2), (0.25, 0.5, 0.5))
    ('across', 'heading')
    """
    return tuple(
        name
        for name, bound, limit in zip(DIRECTIONS, bounds, limits, strict=True)
        if bound <= limit and name not in doubted
    )


def held_text(bounds: Sequence[float], held: Sequence[str]) -> str:
    """A sentence on a pose of which some directions are held and some are open; empty where all are or none is.

    Args:
        bounds: lateral [m], longitudinal [m], heading [deg].
        held: from `held_directions`.

    >>> held_text((0.08, 1.4, 0.2), ("across", "heading"))
    'across held to 0.08 m, heading held to 0.20 deg, along open: signs, posts, stop lines or ends of dashes, or \
satellite fixes would help'
    """
    is_open = [name for name in DIRECTIONS if name not in held]
    if not held or not is_open:
        return ""
    parts = [
        f"{name} held to {bound:.2f} {_UNITS[name]}"
        for name, bound in zip(DIRECTIONS, bounds, strict=True)
        if name in held
    ]
    return f"{', '.join(parts)}, {' and '.join(is_open)} open: {'; '.join(HELP[name] for name in is_open)} would help"
