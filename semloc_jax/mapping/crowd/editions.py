"""What cars are told of a map that many drives keep alive (room: mapping; host).

In: the edition before, the map as more drives make it. Out: Edition. What a merge knows, it remembers by its drives.
What cars hold is an edition: an element is written again only where that is news, see `edition_news`, and stays as it
was published, to the bit, where it is none. How all of the map has moved is told apart, by its datum.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float
from scipy.optimize import linear_sum_assignment
from scipy.spatial import cKDTree

from semloc_jax.evaluation.map_shapes import is_line, kind_of, thing_of
from semloc_jax.mapping.crowd.edition_lines import line_pairs, spliced
from semloc_jax.mapping.crowd.edition_news import News, coarse, newcomer
from semloc_jax.mapping.crowd.elements import on_grid
from semloc_jax.mapping.crowd.frame_motion import frame_motion, told_motion
from semloc_jax.mapping.crowd.merged import Known
from semloc_jax.maps import Belief, MapElement
from semloc_jax.maps.versions.datum import CELL_MM, STILL, Datum

FIRST_DRIVES = 4
"""Fewer drives are told as they are."""
_STANDS = 8
"""So many editions stand while the number of drives doubles; ours."""
_SAME_M = 0.28
"""What lies nearer to something of its kind under another name is it: as far as sights of one thing may be apart."""
_CELL_M = CELL_MM / 1000.0


@dataclass(frozen=True)
class Edition:
    """A map as cars hold it.

    Attributes:
        published: elements as they were published, and how sure they were then.
        datum: how the frame has moved since.
    """

    published: tuple[Known, ...]
    datum: Datum = STILL

    @property
    def now(self) -> list[Known]:
        """The elements where they lie by now."""
        if self.datum.is_still:
            return list(self.published)
        return [(replace(e, points=self.datum.moved(e.points)), belief) for e, belief in self.published]


def prefixes(num_drives: int) -> list[int]:
    """After how many drives, in the order of time, the editions stand that each next one follows from; and the last.

    4, 5, 6 ... 16, 18, 20 ... 32, 36 ...: between two of them all editions follow from the same one, so that what one
    of these tells for nothing the next one takes back. A stand comes for each eighth of the drives that there are.
    """
    stands, num = [], FIRST_DRIVES
    while num < num_drives:
        stands.append(num)
        num += max(1, 2 ** (num.bit_length() - 1) // _STANDS)
    return [*stands, num_drives]


def next_edition(before: Edition | None, made: Sequence[Known], sigma_m: float) -> Edition:
    """What cars are told of a map, when they hold an edition.

    Args:
        before: what they hold; None for nothing.
        made: the map by now.
        sigma_m: how far all of it may be off.
    """
    if before is None:
        return Edition(tuple((element, coarse(belief)) for element, belief in made))
    old, back, datum = before.published, list(made), before.datum
    pairs = _named(old, made)
    for _ in range(2):  # by names alone at first: what lies beside what, the frame must say
        datum = frame_motion([(old[i], made[j]) for i, j in pairs], [e for e, _ in [*old, *made]])
        back = [(replace(e, points=_back(e.points, datum)), belief) for e, belief in made]
        pairs = _pairs(old, back)
    old_of = {j: old[i] for i, j in pairs}
    news = News.of([(one, back[j]) for j, one in old_of.items()])
    names = {element.id for element, _ in old_of.values()}
    beside = _nearest_held(old, {j: e for j, (e, _) in enumerate(back) if j not in old_of})
    published: list[Known] = []
    for j, (element, belief) in enumerate(back):
        if j in old_of:
            published.append(_told(old_of[j], (element, belief), news))
            continue
        name, k = element.id, 1
        while name in names:  # it has become the name of another part of its line
            name, k = f"{element.id}+{k}", k + 1
        names.add(name)
        published.append((replace(element, id=name), newcomer(belief, beside.get(j))))
    # Elements lie in the frame as it is; how it has moved is told when that is news.
    return Edition(tuple(published), told_motion(before.datum, datum, published, sigma_m))


def _nearest_held(old: Sequence[Known], new: dict[int, MapElement]) -> dict[int, Belief]:
    """What cars hold of the element that is nearest to each new one."""
    if not old or not new:
        return {}
    tree = cKDTree([e.points[0, :2] for e, _ in old])
    return {j: old[int(tree.query(e.points[0, :2])[1])][1] for j, e in new.items()}


def _told(old: Known, new: Known, news: News) -> Known:
    """What cars hold of an element after an edition."""
    (e, _), (f, belief) = old, new
    if is_line(f):
        f = replace(f, points=spliced(e.points, f.points, news.aside_m(belief), belief.sigma_along_m))
    else:
        f = news.told(e, new)
    return news.after(old, (replace(f, points=on_grid(f.points, _CELL_M)), belief))


def _back(points: Float[np.ndarray, "n 3"], datum: Datum) -> Float[np.ndarray, "n 3"]:
    """Where points would have been published, on the grid of what is."""
    found = points
    for _ in range(2):
        found = points - (datum.moved(found) - np.rint(found * 1000.0) / 1000.0)
    return on_grid(found, _CELL_M)


def _named(before: Sequence[Known], made: Sequence[Known]) -> list[tuple[int, int]]:
    """Which thing is which by its name: that of the first drive that saw it. Parts of lines change their names."""
    row = {(e.id, kind_of(e)): k for k, (e, _) in enumerate(before) if not is_line(e)}
    found = [(row.get((e.id, kind_of(e))), j) for j, (e, _) in enumerate(made) if not is_line(e)]
    return [(i, j) for i, j in found if i is not None]


def _pairs(before: Sequence[Known], made: Sequence[Known]) -> list[tuple[int, int]]:
    """Which element is which, in one frame: lines by where they run, things by name, then by kind and place."""
    rows, columns = ([k for k, (e, _) in enumerate(side) if is_line(e)] for side in (before, made))
    beside = line_pairs([before[k][0] for k in rows], [made[k][0] for k in columns])
    pairs = [(rows[i], columns[j]) for i, j in beside] + _named(before, made)
    rows, columns = (
        [k for k, (e, _) in enumerate(side) if k not in {pair[which] for pair in pairs} and not is_line(e)]
        for which, side in enumerate((before, made))
    )
    near = _beside([before[k][0] for k in rows], [made[k][0] for k in columns])
    return pairs + [(rows[i], columns[j]) for i, j in near]


def _beside(before: Sequence[MapElement], made: Sequence[MapElement]) -> list[tuple[int, int]]:
    """Things of a kind that lie so close that they are one."""
    pairs = []
    for kind in sorted({kind_of(e) for e in made}):
        rows, columns = ([k for k, e in enumerate(side) if kind_of(e) == kind] for side in (before, made))
        a, b = (
            np.array([thing_of(side[k]).centre for k in own]).reshape(-1, 2)
            for side, own in ((before, rows), (made, columns))
        )
        apart_m = np.linalg.norm(a[:, None] - b[None], axis=2)
        chosen = linear_sum_assignment(np.minimum(apart_m, _SAME_M))
        pairs += [(rows[i], columns[j]) for i, j in zip(*chosen, strict=True) if apart_m[i, j] < _SAME_M]
    return pairs
