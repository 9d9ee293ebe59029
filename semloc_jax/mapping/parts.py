"""Finished parts of the work on a map, on disk: memory holds one part at a time (room: mapping; host).

In: frames in their order, what looks at them or counts; revisits. Out: the same as without parts; after a kill it goes
on behind the last one that is whole. Who opens a folder of parts again sees to it that the inputs are the same.
"""

import json
import shutil
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from semloc_jax.errors import SemlocError
from semloc_jax.mapping.existence import Counting
from semloc_jax.mapping.found_loops import FoundLoop
from semloc_jax.mapping.looking import Gatherer
from semloc_jax.mapping.revisits import Revisit
from semloc_jax.mapping.uprights import UprightCounting
from semloc_jax.storage import append_line, making, npz_arrays, reading, whole_lines, write_npz

PART_FRAMES = 40
"""Frames in a part: what is in memory at a time, and what a kill takes back."""
_LOOKS, _COUNTS, _LOOPS = "looks", "counts", "loops.jsonl"
_POSES = "refined.npz"


@dataclass(frozen=True)
class Rest:
    """Frames that no part holds yet, in order; going on to the next one says that all before it is done."""

    frames: Sequence[int]
    done: int
    store: Callable[[int], None]

    def __len__(self) -> int:
        return len(self.frames) - self.done

    def __iter__(self) -> Iterator[int]:
        for count, frame in enumerate(self.frames[self.done :], start=self.done + 1):
            yield frame
            if count % PART_FRAMES == 0 or count == len(self.frames):
                self.store(count)


class Parts:
    """Parts in a folder, which is made where it is not there."""

    def __init__(self, folder: Path):
        """Nothing is read before it is asked for."""
        self.folder = folder
        folder.mkdir(exist_ok=True)

    def gathered(self, gatherer: Gatherer, frames: Sequence[int]) -> Rest:
        """The frames to look at; what is gathered of them goes to disk part by part.

        Args:
            gatherer: empty; the parts that are there are taken in.
            frames: all of them, in order.

        Raises:
            SemlocError: a part is missing or damaged.
        """
        paths = sorted(self.folder.glob(f"{_LOOKS}_*"))
        if len(paths) != -(-_done(paths) // PART_FRAMES):
            raise SemlocError(f"{self.folder}: {len(paths)} parts of {_done(paths)} frames; some are gone: begin anew")
        for path in paths:
            gatherer.attach(path)
        return Rest(frames, _done(paths), lambda count: gatherer.store(self.folder / f"{_LOOKS}_{count:06d}"))

    def counted(self, paint: Counting, uprights: UprightCounting, frames: Sequence[int]) -> Rest:
        """The frames to count; arguments as for `gathered`."""
        paths = sorted(self.folder.glob(f"{_COUNTS}_*"))
        for path in paths[-1:]:
            paint.restore(path / "paint.npz")
            uprights.restore(path / "uprights.npz")

        def store(count: int) -> None:
            with making(self.folder / f"{_COUNTS}_{count:06d}") as part:
                part.mkdir()
                paint.save(part / "paint.npz")
                uprights.save(part / "uprights.npz")
            for path in sorted(self.folder.glob(f"{_COUNTS}_*"))[:-1]:
                shutil.rmtree(path)

        return Rest(frames, _done(paths), store)

    def way(self, solve: Callable[[], dict[str, np.ndarray]]) -> dict[str, np.ndarray]:
        """The arrays of a way that a solve gives; where it was done before, what it gave then.

        Raises:
            SemlocError: what is there is none: poses `Ts_map_base[n 4 4]`, places `xy_map[k 2]` and their sigmas.
        """
        path = self.folder / _POSES
        if not path.exists():
            write_npz(path, solve())
        held = npz_arrays(path, f"poses {path}")
        ends = {"Ts_map_base": (4, 4), "xy_map": (2,), "place_m": (), "turn_rad": ()}
        is_way = held.keys() == ends.keys() and all(held[name].shape[1:] == end for name, end in ends.items())
        if not is_way or len({len(held[name]) for name in ("xy_map", "place_m", "turn_rad")}) != 1:
            raise SemlocError(f"poses {path}: holds no way; begin anew with another --out")
        return held

    def once(self, revisit: Revisit, search: Callable[[], FoundLoop | None]) -> FoundLoop | None:
        """What a search for a loop gives; where it was searched before, what it gave then."""
        path = self.folder / _LOOPS
        key = [int(revisit.is_second_look), int(revisit.a), int(revisit.b), *map(int, revisit.frames)]
        with reading(f"searched revisits {path}"):
            for line in map(json.loads, whole_lines(path)):
                if line["revisit"] == key:
                    return _loop(line["loop"])
        found = search()
        line = {"revisit": key, "loop": None if found is None else found._asdict()}
        append_line(path, json.dumps(line, default=lambda value: np.asarray(value).tolist()))
        return found


def _done(paths: list[Path]) -> int:
    return int(paths[-1].stem.rpartition("_")[2]) if paths else 0


def _loop(held: dict | None) -> FoundLoop | None:
    if held is None:
        return None
    arrays = {name: np.array(held[name], dtype=np.float64) for name in ("T_a_b", "covariance")}
    return FoundLoop(**{**held, **arrays, "reasons": tuple(held["reasons"])})
