"""The reference line of an OpenDRIVE road in the plane: line, arc, spiral, poly3, paramPoly3 (room: maps; host).

In: the <planView> of a road. Out: PlanView, which gives position and heading at any s.
Clothoids are integrated with Gauss-Legendre nodes on pieces that turn less than half a radian, exact to nanometres.
"""

import logging
from collections.abc import Callable
from dataclasses import dataclass
from xml.etree.ElementTree import Element

import numpy as np

from semloc_jax.errors import SemlocError
from semloc_jax.maps.io.xml_stream import number, numbers

_log = logging.getLogger(__name__)
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(8)
_MOST_TURN_RAD = 200.0
"""About thirty full turns in one piece: no road."""
_LONGEST_M = 1e5
_MOST_SAMPLES = 1e6
_TABLE_STEP_M = 0.25
_CHORD_ERROR_M = 0.0005
"""A line through samples of the reference line stays this close to it."""
_FARTHEST_JUMP_M = 1000.0
"""A piece that starts this far from the end of the one before belongs to no road; ours."""
_STEPS_M = (0.05, 2.0)

Local = Callable[[np.ndarray], tuple[np.ndarray, np.ndarray, np.ndarray]]
"""ds `[n]` -> u, v, heading relative to the start of the piece."""


@dataclass(frozen=True)
class _Piece:
    s: float
    start: tuple[float, float, float]
    length: float
    local: Local
    step_m: float


@dataclass(frozen=True)
class PlanView:
    """The reference line of one road, made of pieces.

    Attributes:
        pieces: ascending in s.
        length: end of the last piece [m].
    """

    pieces: tuple[_Piece, ...]
    length: float

    @classmethod
    def from_xml(cls, plan_view: Element | None, where: str) -> "PlanView":
        """Returns the reference line in a <planView>.

        Raises:
            SemlocError: no geometry, an unknown one, numbers that no road has, or a jump that parts the road in two.
        """
        records = [] if plan_view is None else plan_view.findall("geometry")
        if not records:
            raise SemlocError(f"{where}: no <geometry> in its <planView>; expected at least one")
        pieces = _connected(sorted((_piece(record, where) for record in records), key=lambda piece: piece.s), where)
        return cls(tuple(pieces), pieces[-1].s + pieces[-1].length)

    def at(self, s: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Returns x, y [m] and heading [rad] at `s` `[n]` [m]."""
        s = np.asarray(s, dtype=np.float64)
        starts = np.array([piece.s for piece in self.pieces])
        owner = np.clip(np.searchsorted(starts, s + 1e-9, side="right") - 1, 0, len(starts) - 1)
        x, y, heading = np.empty_like(s), np.empty_like(s), np.empty_like(s)
        for index in np.unique(owner):
            piece, rows = self.pieces[index], owner == index
            u, v, turn = piece.local(np.clip(s[rows] - piece.s, 0.0, piece.length))
            x0, y0, yaw = piece.start
            x[rows] = x0 + u * np.cos(yaw) - v * np.sin(yaw)
            y[rows] = y0 + u * np.sin(yaw) + v * np.cos(yaw)
            heading[rows] = yaw + turn
        return x, y, heading

    def samples(self, where: str) -> np.ndarray:
        """Returns places along the road, ascending, so dense that chords between them follow it, `float64[n]` [m].

        Raises:
            SemlocError: more than any road needs.
        """
        count = sum(piece.length / piece.step_m for piece in self.pieces)
        if count > _MOST_SAMPLES:
            raise SemlocError(f"{where}: its reference line needs {count:.0f} points; expected less than a million")
        parts = [
            np.linspace(piece.s, piece.s + piece.length, int(np.ceil(piece.length / piece.step_m)) + 1)
            for piece in self.pieces
        ]
        return np.unique(np.concatenate(parts))


def _connected(pieces: list[_Piece], where: str) -> list[_Piece]:
    """Returns the pieces up to the first that starts far from where the road has come to; what is left out is logged.

    Files exist whose last geometry lies at the origin of the grid, thousands of kilometres away.
    """
    for index in range(1, len(pieces)):
        before, piece = pieces[index - 1], pieces[index]
        end = PlanView((before,), before.s + before.length).at(np.array([before.s + before.length]))
        jump_m = float(np.hypot(end[0][0] - piece.start[0], end[1][0] - piece.start[1]))
        if jump_m <= _FARTHEST_JUMP_M:
            continue
        kept_m, left_m = piece.s - pieces[0].s, pieces[-1].s + pieces[-1].length - piece.s
        if left_m > kept_m:
            raise SemlocError(
                f"{where}: its reference line jumps by {1e-3 * jump_m:.0f} km at s = {piece.s:.0f} m, before most of "
                "the road; expected pieces that join; repair the <planView>"
            )
        _log.warning(
            "%s: its reference line jumps by %.0f km at s = %.0f m; the last %.0f m of the road are left out",
            *(where, 1e-3 * jump_m, piece.s, left_m),
        )
        return pieces[:index]
    return pieces


def _piece(record: Element, where: str) -> _Piece:
    s, x, y, hdg = numbers(record, "s x y hdg", where)
    length = number(record, "length", where, None)
    if not 0.0 <= length <= _LONGEST_M:
        raise SemlocError(f"{where}: geometry of length {length:g} m; expected 0 to {_LONGEST_M:g}")
    for shape in record:
        if shape.tag in _SHAPES:
            local, curvature = _SHAPES[shape.tag](shape, length, where)
            step_m = float(np.clip(np.sqrt(8.0 * _CHORD_ERROR_M / max(curvature, 1e-9)), *_STEPS_M))
            return _Piece(s, (x, y, hdg), length, local, step_m)
    kinds = ", ".join(shape.tag for shape in record) or "nothing"
    raise SemlocError(f"{where}: geometry at s = {s:g} is {kinds[:40]}; expected one of {', '.join(_SHAPES)}")


def _line(shape: Element, length: float, where: str) -> tuple[Local, float]:
    return (lambda ds: (ds, np.zeros_like(ds), np.zeros_like(ds))), 0.0


def _arc(shape: Element, length: float, where: str) -> tuple[Local, float]:
    curvature = number(shape, "curvature", where, None, 10.0)
    return _clothoid(curvature, curvature, length, where)


def _spiral(shape: Element, length: float, where: str) -> tuple[Local, float]:
    first, last = (number(shape, key, where, None, 10.0) for key in ("curvStart", "curvEnd"))
    return _clothoid(first, last, length, where)


def _clothoid(first: float, last: float, length: float, where: str) -> tuple[Local, float]:
    """Returns the curve whose curvature goes from `first` to `last` [1/m] in proportion to its length."""
    most = max(abs(first), abs(last))
    if most * length > _MOST_TURN_RAD:
        raise SemlocError(f"{where}: a curve turns {most * length:.0f} rad; expected less than {_MOST_TURN_RAD:.0f}")
    rate = (last - first) / length if length > 0 else 0.0
    panels = int(np.ceil(2.0 * most * length)) + 1

    def heading(ds: np.ndarray) -> np.ndarray:
        return ds * (first + 0.5 * rate * ds)

    knots = np.linspace(0.0, length, panels + 1)
    table = np.concatenate([[0.0], np.cumsum(_integrate(heading, knots[:-1], knots[1:]))])

    def local(ds: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        panel = np.clip(np.searchsorted(knots, ds, side="right") - 1, 0, panels - 1)
        place = table[panel] + _integrate(heading, knots[panel], ds)
        return place.real, place.imag, heading(ds)

    return local, most


def _integrate(heading: Callable[[np.ndarray], np.ndarray], a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Returns the integral of exp(i heading) from `a` to `b` `[n]`, complex."""
    half, middle = 0.5 * (b - a), 0.5 * (a + b)
    return half * (np.exp(1j * heading(middle[:, None] + half[:, None] * _NODES)) @ _WEIGHTS)


def _poly3(shape: Element, length: float, where: str) -> tuple[Local, float]:
    """Returns the curve v(u); u at an arc length is found with Newton's steps."""
    a, b, c, d = numbers(shape, "a b c d", where)

    def speed(u: np.ndarray) -> np.ndarray:
        return np.hypot(1.0, b + u * (2.0 * c + 3.0 * u * d))

    table = np.linspace(0.0, length, int(np.ceil(length / _TABLE_STEP_M)) + 2)
    steps = np.diff(table)
    nodes = table[:-1, None] + 0.5 * steps[:, None] * (1.0 + _NODES)
    along = np.concatenate([[0.0], np.cumsum(0.5 * steps * (speed(nodes) @ _WEIGHTS))])

    def local(ds: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        row = np.clip(np.searchsorted(along, ds, side="right") - 1, 0, len(steps) - 1)
        u = np.interp(ds, along, table)
        for _ in range(3):
            half = 0.5 * (u - table[row])
            inside = table[row][:, None] + half[:, None] * (1.0 + _NODES)
            u = u - (along[row] + half * (speed(inside) @ _WEIGHTS) - ds) / speed(u)
        return u, a + u * (b + u * (c + u * d)), np.arctan(b + u * (2.0 * c + 3.0 * u * d))

    return local, _largest_curvature(local, length)


def _param_poly3(shape: Element, length: float, where: str) -> tuple[Local, float]:
    """Returns the curve u(p), v(p); p is the arc length, or its share of the whole."""
    along_u = np.polynomial.Polynomial(numbers(shape, "aU bU cU dU", where))
    along_v = np.polynomial.Polynomial(numbers(shape, "aV bV cV dV", where))
    du, dv = along_u.deriv(), along_v.deriv()
    scale = 1.0 if shape.get("pRange", "normalized") == "arcLength" else 1.0 / max(length, 1e-9)

    def local(ds: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        p = ds * scale
        return along_u(p), along_v(p), np.arctan2(dv(p), du(p))

    return local, _largest_curvature(local, length)


def _largest_curvature(local: Local, length: float) -> float:
    ds = np.linspace(0.0, length, min(int(length / _TABLE_STEP_M) + 16, 4096))
    return float(np.abs(np.diff(np.unwrap(local(ds)[2]))).max(initial=0.0) / max(ds[1] - ds[0], 1e-6))


_SHAPES = {"line": _line, "arc": _arc, "spiral": _spiral, "poly3": _poly3, "paramPoly3": _param_poly3}
