"""Slots and obstacles around a vehicle as a recording for the Rerun viewer (room: viz).

In: frame by frame the pose in odom and the things that are followed. Out: an .rrd file. Needs the extra `viz`.
"""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from semloc_jax.viz.recording import rerun_stream
from semloc_jax.viz.slots import UNSURE
from semloc_jax.viz.style import rgb


class RecordedThing(NamedTuple):
    """One thing that is followed."""

    name: str
    outline_odom: Float[np.ndarray, "k 2"]
    """Its corners [m]."""
    colour: str
    """#rrggbb; what is not confirmed is grey."""
    confirmed: bool
    existence: float


class ObjectRecording:
    """Writes what is followed, frame by frame."""

    def __init__(self, stream: Any):
        """Where it goes."""
        self._stream, self._driven = stream, []

    def add(self, time_s: float, T_odom_base: Float[np.ndarray, "4 4"], things: Sequence[RecordedThing]) -> None:
        """The vehicle and the things of one frame.

        Args:
            time_s: of the frame.
            T_odom_base: pose of the vehicle.
            things: all that are followed then; those of the frame before are gone.
        """
        import rerun as rr

        stream, place = self._stream, T_odom_base[:3, 3]
        self._driven.append(place)
        stream.set_time("time", timestamp=time_s)
        stream.log("vehicle", rr.Transform3D(translation=place, mat3x3=T_odom_base[:3, :3]), rr.TransformAxes3D(2.0))
        stream.log("path", rr.LineStrips3D([np.array(self._driven)]))
        outlines = [_closed(thing.outline_odom, place[2]) for thing in things]
        colours = [rgb(thing.colour if thing.confirmed else UNSURE) for thing in things]
        stream.log("things", rr.LineStrips3D(outlines, colors=colours, labels=[thing.name for thing in things]))
        for thing in things:
            stream.log(f"existence/{thing.name.replace(' ', '_')}", rr.Scalars(thing.existence))


@contextmanager
def object_recording(path: Path | None) -> Iterator[ObjectRecording | None]:
    """A recording in its place when the block ends, no file where it fails; None where nobody wants one.

    Raises:
        SemlocError: rerun-sdk is not installed, or the file cannot be written.
    """
    if path is None:
        yield None
        return
    with rerun_stream(path) as stream:
        yield ObjectRecording(stream)


def _closed(outline: np.ndarray, z_m: float) -> Float[np.ndarray, "n 3"]:
    places = np.concatenate([outline, outline[:1]])
    return np.column_stack([places, np.full(len(places), z_m)])
