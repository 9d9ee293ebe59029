"""Values as tokens and numbers: what goes in comes out, whatever it is; anything else is refused."""

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from semloc_jax.maps.versions.terse import from_terse, terse_bytes

pytestmark = pytest.mark.filterwarnings("ignore:Do not use the `random` module")
FEW = settings(max_examples=100, deadline=None, suppress_health_check=list(HealthCheck))
NUMBERS = st.one_of(
    st.integers(-(2**70), 2**70),
    st.floats(allow_nan=False, allow_infinity=False),
    st.integers(-9000, 9000).map(lambda k: k / 1000),
    st.binary(max_size=5),
)
WORDS = st.one_of(st.text(max_size=4), st.sampled_from(["#6", "points", "crowd", "canonical"]))
VALUES = st.recursive(
    st.one_of(NUMBERS, WORDS, st.none(), st.booleans()),
    lambda inner: st.one_of(
        st.lists(inner, max_size=4),
        st.lists(st.integers(-50, 50).map(lambda k: 5 * k), max_size=6),
        st.lists(st.lists(st.integers(-300, 300), min_size=3, max_size=3), max_size=3),
        st.dictionaries(WORDS, inner, max_size=3),
    ),
    max_leaves=20,
)


@FEW
@given(value=VALUES)
def test_what_goes_in_comes_out(value):
    again = from_terse(terse_bytes(value))
    assert repr(again) == repr(value)  # 1 is not 1.0, 0.0 is not -0.0


@FEW
@given(value=VALUES, data=st.data())
def test_a_content_that_is_cut_is_refused(value, data):
    content = terse_bytes([value, [1, 2, 3]])
    with pytest.raises((ValueError, IndexError)):
        from_terse(content[: data.draw(st.integers(0, len(content) - 1))])


def test_numbers_take_few_bytes():
    rows = [[5 * k, -5 * k, 3] for k in range(40)]
    assert len(terse_bytes(rows)) < 200 < 0.6 * len(repr(rows).replace(" ", ""))
    assert len(terse_bytes([0.023] * 9)) < 16 and len(terse_bytes([0.00098, 0.0011])) < 12
    assert len(terse_bytes(["points", ["mm", [5, 10, 15]]])) < 16


@FEW
@given(junk=st.binary(max_size=60))
def test_junk_is_refused_or_is_a_value(junk):
    try:
        value = from_terse(junk)
    except (ValueError, IndexError):
        return
    assert repr(from_terse(terse_bytes(value))) == repr(value)


def test_lists_within_lists_have_an_end():
    deep = []
    for _ in range(100):
        deep = [deep]
    with pytest.raises(ValueError, match="without end"):
        from_terse(terse_bytes(deep))
