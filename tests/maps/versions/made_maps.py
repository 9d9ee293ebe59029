"""Maps that hypothesis makes up, and changes of them, for the tests of versions."""

from dataclasses import replace

import numpy as np
from hypothesis import strategies as st

from semloc_jax.maps import Belief, BeliefMap, GeoOrigin, MapElement, SemanticMap
from semloc_jax.maps.versions.datum import STILL, Datum
from semloc_jax.maps.versions.state import MapState

_LABELS = ("lane_marking", "pole", "crosswalk", "sign", "curb")
_WORDS = st.text(st.characters(codec="utf-8", exclude_categories=("Cs",)), min_size=1, max_size=6)
_VALUES = st.one_of(
    st.integers(-(2**53), 2**53), st.floats(allow_nan=False, allow_infinity=False), st.booleans(), _WORDS, st.none(),
    st.lists(st.integers(-5, 5), max_size=3),
)  # fmt: skip


@st.composite
def elements(draw, name: str) -> MapElement:
    """An element with odd numbers, whole millimetres or any float, and properties of all kinds."""
    label = draw(st.sampled_from(_LABELS))
    closed = label in ("crosswalk", "sign")
    num = 2 if label == "pole" else draw(st.integers(3 if closed else 2, 6))
    whole = draw(st.booleans())
    number = st.integers(-90_000, 90_000).map(lambda k: k / 1000) if whole else st.floats(-90.0, 90.0)
    points = np.array(draw(st.lists(number, min_size=3 * num, max_size=3 * num))).reshape(-1, 3)
    points[:, :2] += draw(st.sampled_from([0.0, 400.0, -512.0]))  # in other tiles
    normal = np.array([0.0, draw(st.sampled_from([-1.0, 1.0])), 0.0]) if label == "sign" else None
    return MapElement(
        name,
        label,
        points,
        closed=closed,
        width_m=draw(st.sampled_from([0.0, 0.15, 0.1 + 0.2])),
        style=draw(st.sampled_from(["solid", "dashed", ""])),
        normal=normal,
        true_ends=(draw(st.booleans()), draw(st.booleans())),
        has_height=draw(st.booleans()),
        attributes=draw(st.dictionaries(st.sampled_from(["num_seen", "+num_seen", "a.b", "x"]), _VALUES, max_size=3)),
    )


_SHIFT = st.integers(-60, 60).map(lambda k: 5 * k)
_NODE = st.tuples(st.integers(-9, 9), st.integers(-3, 3))
DATUMS = st.one_of(st.just(STILL), st.dictionaries(_NODE, st.tuples(_SHIFT, _SHIFT, _SHIFT), max_size=40).map(Datum))


@st.composite
def states(draw) -> MapState:
    """A version of a map with up to eight elements in any order."""
    names = draw(st.lists(_WORDS, unique=True, min_size=1, max_size=8))
    origin = draw(st.sampled_from([None, GeoOrigin(48.1, 11.6, 500.0)]))
    held = SemanticMap(tuple(draw(elements(name)) for name in names), origin, draw(_WORDS))
    return MapState(held, draw(st.integers(1, 5)), draw(st.integers(0, 3)), draw(DATUMS))


@st.composite
def changed(draw, state: MapState) -> MapState:
    """Another version of a map: some removed, some changed, some added, some in another order."""
    kept = []
    for element in state.map.elements:
        what = draw(st.sampled_from(["same", "same", "gone", "moved", "seen", "new"]))
        if what == "moved":
            element = element.with_points(element.points + draw(st.integers(-300, 300)) / 1000)
        elif what == "seen":
            element = replace(element, attributes={**element.attributes, "num_seen": draw(_VALUES)})
        elif what == "new":
            element = draw(elements(element.id))
        if what != "gone":
            kept.append(element)
    have = {element.id for element in kept}
    names = [name for name in draw(st.lists(_WORDS, unique=True, max_size=3)) if name not in have]
    kept += [draw(elements(name)) for name in names]
    if not kept:
        kept = [draw(elements("only"))]
    if draw(st.booleans()):
        kept = draw(st.permutations(kept))
    held = replace(state.map, elements=tuple(kept), name=draw(st.sampled_from([state.map.name, "other"])))
    datum = draw(st.one_of(st.just(state.datum), DATUMS))
    return MapState(held, state.version + draw(st.integers(0, 2)), state.num_drives, datum)


def road(num: int, seen: int = 3, shift_m: float = 0.0) -> SemanticMap:
    """A plain map: dashes along a road, every one with a belief."""
    points = np.array([[0.0, 0.0, 0.0], [3.0, 0.0, 0.0]])
    dashes = [
        MapElement(f"dash_{k:03d}", "lane_marking", points + [9.0 * k, shift_m, 0.0], width_m=0.15, style="dashed")
        for k in range(num)
    ]
    belief = Belief(0.02, 0.1, 4.0, seen, 0, 1.0, 2.0, "a drive")
    return BeliefMap(SemanticMap(tuple(dashes), None, "road"), {dash.id: belief for dash in dashes}).as_map()
