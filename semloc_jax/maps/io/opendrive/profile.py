"""Functions of the way along a road that OpenDRIVE gives as pieces of cubics (room: maps; host).

In: records with s and a, b, c, d. Out: Profile, evaluated at many places at once.
"""

from dataclasses import dataclass
from xml.etree.ElementTree import Element

import numpy as np

from semloc_jax.maps.io.xml_stream import numbers

_SHORTEST_STEP_M = 0.1


@dataclass(frozen=True)
class Profile:
    """Piecewise cubic f(s) = a + b ds + c ds^2 + d ds^3, ds from the start of the piece.

    Attributes:
        starts: where the pieces begin, ascending, `float64[k]` [m].
        cubics: a, b, c, d of each, `float64[k 4]`.
    """

    starts: np.ndarray
    cubics: np.ndarray

    @classmethod
    def from_records(cls, records: list[Element], where: str, key: str = "s", shift_m: float = 0.0) -> "Profile":
        """Returns the profile of XML records; `key` names their place, to which `shift_m` is added."""
        rows = np.array([numbers(record, f"{key} a b c d", where) for record in records]).reshape(-1, 5)
        rows = rows[np.argsort(rows[:, 0], kind="stable")]
        return cls(rows[:, 0] + shift_m, rows[:, 1:])

    def at(self, s: np.ndarray) -> np.ndarray:
        """Returns the values at `s` `[n]` [m]; 0 before the first piece."""
        return self._evaluate(s, self.cubics)

    def slope(self, s: np.ndarray) -> np.ndarray:
        """Returns the derivative at `s` `[n]` [m]."""
        return self._evaluate(s, np.column_stack([self.cubics[:, 1:] * [1.0, 2.0, 3.0], np.zeros(len(self.cubics))]))

    def samples(self, end: float, error: float) -> np.ndarray:
        """Returns places up to `end` between which chords follow the profile to within `error`."""
        places = [self.starts]
        for index, start in enumerate(self.starts):
            stop = min(end, self.starts[index + 1] if index + 1 < len(self.starts) else end)
            c, d = self.cubics[index, 2:]
            bend = max(abs(2.0 * c), abs(2.0 * c + 6.0 * d * (stop - start)))
            if stop > start and bend > 0.0:
                step = max(np.sqrt(8.0 * error / bend), _SHORTEST_STEP_M)
                places.append(np.arange(start, stop, step))
        return np.concatenate(places)

    def _evaluate(self, s: np.ndarray, cubics: np.ndarray) -> np.ndarray:
        s = np.asarray(s, dtype=np.float64)
        if len(self.starts) == 0:
            return np.zeros_like(s)
        piece = np.searchsorted(self.starts, s + 1e-9, side="right") - 1
        row = np.maximum(piece, 0)
        ds = np.maximum(s - self.starts[row], 0.0)
        a, b, c, d = cubics[row].T
        return np.where(piece >= 0, a + ds * (b + ds * (c + ds * d)), 0.0)


@dataclass(frozen=True)
class LateralShape:
    """Height of the road above its tilted plane as a function of s and t (`shape` records), linear between places.

    Attributes:
        places: the s of the cross sections, ascending, `float64[k]` [m].
        sections: one profile over t for each.
    """

    places: np.ndarray
    sections: tuple[Profile, ...]

    @classmethod
    def from_records(cls, records: list[Element], where: str) -> "LateralShape":
        """Returns the shape of XML records with s, t, a, b, c, d."""
        groups: dict[float, list[Element]] = {}
        for record in records:
            groups.setdefault(numbers(record, "s", where)[0], []).append(record)
        places = sorted(groups)
        return cls(np.array(places), tuple(Profile.from_records(groups[s], where, "t") for s in places))

    def at(self, s: np.ndarray, t: np.ndarray) -> np.ndarray:
        """Returns the heights at `s`, `t` `[n]` [m]."""
        if len(self.places) == 0:
            return np.zeros_like(s)
        after = np.clip(np.searchsorted(self.places, s, side="right"), 0, len(self.places) - 1)
        before = np.maximum(after - 1, 0)
        span = np.maximum(self.places[after] - self.places[before], 1e-9)
        share = np.clip((s - self.places[before]) / span, 0.0, 1.0)
        height = np.zeros_like(s)
        for index, section in enumerate(self.sections):
            weight = np.where(before == index, 1.0 - share, 0.0) + np.where(after == index, share, 0.0)
            rows = weight > 0.0
            height[rows] += weight[rows] * section.at(t[rows])
        return height
