"""The checks of types and shapes that all other tests run under."""

import importlib
import os

import numpy as np
import pytest

pytestmark = pytest.mark.skipif(os.environ.get("SEMLOC_TYPECHECK") == "0", reason="types are not checked")

SOURCE = '''
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float


def product(A: Float[np.ndarray, "n m"], x: Float[np.ndarray, " m"]) -> Float[np.ndarray, " n"]:
    return A @ x if x[0] else x


def both(A: Float[np.ndarray, "n m"]) -> float:
    """Axes are those of one call: the inner one has its own n and m."""
    return product(A.T, np.ones(A.shape[0])).sum().item()


def numbers(n: int) -> Iterator[int]:
    yield from range(n)


@dataclass
class Pair:
    near: Float[np.ndarray, " n"]
    far: Float[np.ndarray, " n"]

    def swapped(self, other: "Pair") -> "Pair":
        return Pair(other.far, self.near)

    @property
    def num(self) -> int:
        return len(self.near) if self.near[0] else "none"

    @classmethod
    def of(cls, n: int) -> "Pair":
        return cls(np.ones(n), np.ones(n))

    @staticmethod
    def half(n: int) -> int:
        return n / 2
'''


@pytest.fixture(scope="module")
def module(tmp_path_factory):
    """A module of the package that exists for this test alone."""
    import semloc_jax

    folder = tmp_path_factory.mktemp("package")
    (folder / "made_for_a_test.py").write_text(SOURCE)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(semloc_jax, "__path__", [*semloc_jax.__path__, str(folder)])
        yield importlib.import_module("semloc_jax.made_for_a_test")


def test_what_fits_goes_through(module):
    assert module.product(np.ones((2, 3)), np.ones(3)).tolist() == [3.0, 3.0]
    assert module.both(np.ones((2, 3))) == 6.0
    assert list(module.numbers(3)) == [0, 1, 2]
    assert module.Pair.of(2).swapped(module.Pair.of(2)).num == 2


@pytest.mark.parametrize(
    "wrong",
    [
        lambda m: m.product(np.ones((2, 3)), np.ones(2)),
        lambda m: m.product(np.ones((2, 3)), np.zeros(3)),
        lambda m: m.product(np.ones((2, 3), int), np.ones(3)),
        lambda m: m.both([[1.0]]),
        lambda m: m.numbers("3"),
        lambda m: m.Pair(np.ones(2), np.ones(3)),
        lambda m: m.Pair.of(2).swapped(3),
        lambda m: m.Pair(np.zeros(2), np.zeros(2)).num,
        lambda m: m.Pair.of(2.0),
        lambda m: m.Pair.half(3),
    ],
    ids=["axis", "axis of the result", "kind of number", "list", "generator", "field", "own class", "property",
         "classmethod", "staticmethod"],
)  # fmt: skip
def test_what_does_not_fit_is_refused(module, wrong):
    with pytest.raises(TypeError, match="violates type hint|Type-check error"):
        wrong(module)


def test_a_call_that_was_refused_leaves_nothing_behind(module):
    with pytest.raises(TypeError) as refused:
        module.product(np.ones((2, 3)), np.ones(2))
    assert refused.value.__notes__[0].splitlines()[1:] == ["n=2", "m=3"]
    assert module.product(np.ones((3, 2)), np.ones(2)).tolist() == [2.0, 2.0, 2.0]
