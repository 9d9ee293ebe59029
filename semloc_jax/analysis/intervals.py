"""Interval arithmetic through any function of JAX (room: analysis; pure JAX).

In: a function of arrays, intervals of its arguments. Out: intervals that hold every value it can take.
The function is traced once and its operations are carried out on lower and upper bounds, so that every camera model
has rigorous bounds without a line of its own. Rounding is not directed: the caller adds a margin to the bounds.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax.extend import core
from jaxtyping import Array, Bool, Float

from semloc_jax.errors import SemlocError


class Interval(NamedTuple):
    """All numbers from `low` to `high`, elementwise."""

    low: Float[Array, "..."] | Bool[Array, "..."]
    high: Float[Array, "..."] | Bool[Array, "..."]

    @classmethod
    def of(cls, value: Any) -> "Interval":
        """The interval that holds one value."""
        return value if isinstance(value, Interval) else cls(jnp.asarray(value), jnp.asarray(value))

    @classmethod
    def about(cls, center: Array, radius: Array) -> "Interval":
        """All numbers at most `radius` from `center`."""
        return cls(center - radius, center + radius)

    def __add__(self, other: Any) -> "Interval":
        other = Interval.of(other)
        return Interval(self.low + other.low, self.high + other.high)

    def __neg__(self) -> "Interval":
        return Interval(-self.high, -self.low)

    def __sub__(self, other: Any) -> "Interval":
        return self + -Interval.of(other)

    def __mul__(self, other: Any) -> "Interval":
        other = Interval.of(other)
        corners = [a * b for a in self for b in other]
        return Interval(_least(corners), _most(corners))

    __radd__, __rmul__ = __add__, __mul__

    def meet(self, other: "Interval") -> "Interval":
        """What both hold; for two intervals that hold the same number."""
        return Interval(jnp.maximum(self.low, other.low), jnp.minimum(self.high, other.high))

    def hull(self, other: "Interval") -> "Interval":
        """The smallest interval that holds both."""
        return Interval(jnp.minimum(self.low, other.low), jnp.maximum(self.high, other.high))

    def widened(self, margin: Array | float) -> "Interval":
        """The interval with a margin on both sides."""
        return Interval(self.low - margin, self.high + margin)


def bounds(function: Callable[..., Any], *arguments: Interval) -> Any:
    """Intervals that hold every value of a function over intervals of its arguments.

    Args:
        function: Of arrays, elementwise in what matters; any structure of arrays may come out.
        arguments: One interval for each argument.

    Raises:
        SemlocError: the function uses an operation that has no bounds here.
    """
    shapes = [jax.ShapeDtypeStruct(a.low.shape, a.low.dtype) for a in arguments]
    traced, tree = jax.make_jaxpr(function, return_shape=True)(*shapes)
    found = _evaluate(traced.jaxpr, traced.consts, list(arguments))
    return jax.tree.unflatten(jax.tree.structure(tree), found)


def _evaluate(jaxpr: Any, consts: list, arguments: list[Interval]) -> list[Interval]:
    known: dict[Any, Interval] = {}

    def read(variable: Any) -> Interval:
        return Interval.of(variable.val) if isinstance(variable, core.Literal) else known[variable]

    known.update(zip(jaxpr.constvars, map(Interval.of, consts), strict=True))
    known.update(zip(jaxpr.invars, arguments, strict=True))
    for equation in jaxpr.eqns:
        found = _apply(equation, [read(variable) for variable in equation.invars])
        known.update(zip(equation.outvars, found, strict=True))
    return [read(variable) for variable in jaxpr.outvars]


def _apply(equation: Any, inputs: list[Interval]) -> list[Interval]:
    name, params = equation.primitive.name, equation.params
    if params.get("name") == "copysign":
        return [_copysign(*inputs)]
    inner = params.get("jaxpr", params.get("call_jaxpr"))
    if inner is not None:
        return _evaluate(inner.jaxpr, inner.consts, inputs)
    if name in _SHAPES:  # nothing but the layout or the type changes
        return [Interval(*(equation.primitive.bind(end, **params) for end in inputs[0]))]
    if name == "integer_pow":
        return [_power(inputs[0], params["y"])]
    if name not in _RULES:
        raise SemlocError(f"interval bounds: no rule for the operation '{name}'; expected arithmetic, min, max, select")
    return [_RULES[name](*inputs)]


def _divide(a: Interval, b: Interval) -> Interval:
    spans_zero = (b.low <= 0) & (b.high >= 0)
    inverse = Interval(1 / jnp.where(spans_zero, 1.0, b.high), 1 / jnp.where(spans_zero, 1.0, b.low))
    found = a * inverse
    return Interval(jnp.where(spans_zero, -jnp.inf, found.low), jnp.where(spans_zero, jnp.inf, found.high))


def _power(a: Interval, exponent: int) -> Interval:
    if exponent < 0:
        return _divide(Interval.of(jnp.ones_like(a.low)), _power(a, -exponent))
    low, high = a.low**exponent, a.high**exponent
    if exponent % 2:
        return Interval(low, high)
    spans_zero = (a.low <= 0) & (a.high >= 0)
    return Interval(jnp.where(spans_zero, 0.0, jnp.minimum(low, high)), jnp.maximum(low, high))


def _absolute(a: Interval) -> Interval:
    low, high = jnp.abs(a.low), jnp.abs(a.high)
    spans_zero = (a.low <= 0) & (a.high >= 0)
    return Interval(jnp.where(spans_zero, 0.0, jnp.minimum(low, high)), jnp.maximum(low, high))


def _rsqrt(a: Interval) -> Interval:
    return Interval(jax.lax.rsqrt(a.high), jnp.where(a.low > 0, jax.lax.rsqrt(jnp.maximum(a.low, 1e-30)), jnp.inf))


def _copysign(size: Interval, sign: Interval) -> Interval:
    size = _absolute(size)
    return Interval(jnp.where(sign.low >= 0, size.low, -size.high), jnp.where(sign.high < 0, -size.low, size.high))


def _select(which: Interval, if_false: Interval, if_true: Interval) -> Interval:
    """`which` holds False and True where the condition is not certain."""
    both = if_false.hull(if_true)
    pick = [
        jnp.where(which.low, t, jnp.where(which.high, b, f)) for f, t, b in zip(if_false, if_true, both, strict=True)
    ]
    return Interval(*pick)


def _least(values: list[Array]) -> Array:
    return jnp.minimum(jnp.minimum(values[0], values[1]), jnp.minimum(values[2], values[3]))


def _most(values: list[Array]) -> Array:
    return jnp.maximum(jnp.maximum(values[0], values[1]), jnp.maximum(values[2], values[3]))


_SHAPES = {"broadcast_in_dim", "convert_element_type", "reshape", "squeeze", "copy"}
_RULES: dict[str, Callable[..., Interval]] = {
    "add": Interval.__add__,
    "add_any": Interval.__add__,
    "sub": Interval.__sub__,
    "mul": Interval.__mul__,
    "neg": Interval.__neg__,
    "div": _divide,
    "abs": _absolute,
    "square": lambda a: _power(a, 2),
    "sqrt": lambda a: Interval(jnp.sqrt(jnp.maximum(a.low, 0.0)), jnp.sqrt(a.high)),
    "rsqrt": _rsqrt,
    "max": lambda a, b: Interval(jnp.maximum(a.low, b.low), jnp.maximum(a.high, b.high)),
    "min": lambda a, b: Interval(jnp.minimum(a.low, b.low), jnp.minimum(a.high, b.high)),
    # Of a condition: low is True where it is certain, high where it is possible.
    "lt": lambda a, b: Interval(a.high < b.low, a.low < b.high),
    "gt": lambda a, b: Interval(a.low > b.high, a.high > b.low),
    "le": lambda a, b: Interval(a.high <= b.low, a.low <= b.high),
    "ge": lambda a, b: Interval(a.low >= b.high, a.high >= b.low),
    "and": lambda a, b: Interval(a.low & b.low, a.high & b.high),
    "or": lambda a, b: Interval(a.low | b.low, a.high | b.high),
    "not": lambda a: Interval(~a.high, ~a.low),
    "select_n": _select,
    # y / x of a line of sight that never points backwards; the plane of the lens is the worst it can be.
    "atan2": lambda y, x: _atan2(y, x),
}


def _atan2(y: Interval, x: Interval) -> Interval:
    """Bounds for y >= 0, where the angle falls with x and is monotone in y; the whole circle else."""
    corners = [jnp.arctan2(a, b) for a in y for b in x]
    known = y.low >= 0
    return Interval(jnp.where(known, _least(corners), -jnp.pi), jnp.where(known, _most(corners), jnp.pi))
