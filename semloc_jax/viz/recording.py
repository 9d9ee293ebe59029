"""Tracked drives, slots and obstacles as recordings for the Rerun viewer (room: viz).

In: a map, poses over time with status, images, things that are followed. Out: an .rrd file. Needs the extra `viz`.
"""

from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from semloc_jax.errors import SemlocError, install_command
from semloc_jax.maps import SemanticMap
from semloc_jax.storage import writing
from semloc_jax.structs import ElementClass
from semloc_jax.viz.slots import UNSURE
from semloc_jax.viz.style import COLOURS, class_name, rgb


class Moment(NamedTuple):
    """What is recorded of one frame."""

    time_s: float
    T_map_base: np.ndarray | None
    T_map_true: np.ndarray | None
    status: str
    scalars: dict[str, float]
    """Numbers over time by name: sigmas, errors, protection levels; nan is left out."""
    image: np.ndarray | None
    """uint8[h w 3], red green blue."""


def write_recording(path: Path, semantic_map: SemanticMap, moments: Iterable[Moment]) -> Path:
    """Write map, trajectory, images and numbers to an .rrd file, which takes its place when it is whole.

    Raises:
        SemlocError: rerun-sdk is not installed, or the file cannot be written.
    """
    with rerun_stream(path) as stream:
        _log(stream, semantic_map, moments)
    return path


@contextmanager
def rerun_stream(path: Path) -> Iterator[Any]:
    """A stream into an .rrd file, which takes its place when the block ends without an error.

    Raises:
        SemlocError: rerun-sdk is not installed, or the file cannot be written.
    """
    try:
        import rerun as rr
    except ImportError as error:
        raise SemlocError(
            f"recording: rerun-sdk is not installed; run: {install_command('viz')}, or leave out --rrd"
        ) from error
    if not path.parent.is_dir():
        raise SemlocError(f"recording {path}: no folder {path.parent}; give --rrd a path in a folder that exists")
    with writing(path) as partial:
        stream = rr.RecordingStream("semloc_jax")
        stream.save(partial)
        try:
            yield stream
            stream.flush()
        finally:
            stream.disconnect()


def _log(recording: Any, semantic_map: SemanticMap, moments: Iterable[Moment]) -> None:
    import rerun as rr

    for label in ElementClass:
        lines = [_line(element) for element in semantic_map.elements if element.label == label]
        if lines:
            strips = rr.LineStrips3D(lines, colors=[rgb(COLOURS[label])])
            recording.log(f"map/{class_name(label).replace(' ', '_')}", strips, static=True)
    driven: list[np.ndarray] = []
    for moment in moments:
        recording.set_time("time", timestamp=moment.time_s)
        recording.log("status", rr.TextLog(moment.status))
        for name, T in (("vehicle", moment.T_map_base), ("truth", moment.T_map_true)):
            if T is not None:
                recording.log(name, rr.Transform3D(translation=T[:3, 3], mat3x3=T[:3, :3]), rr.TransformAxes3D(2.0))
        if moment.T_map_base is not None:
            driven.append(moment.T_map_base[:3, 3])
            recording.log("path", rr.LineStrips3D([np.array(driven)]))
        for name, value in moment.scalars.items():
            if np.isfinite(value):
                recording.log(f"numbers/{name}", rr.Scalars(value))
        if moment.image is not None:
            recording.log("camera", rr.Image(moment.image).compress(jpeg_quality=75))


def _line(element) -> np.ndarray:
    return np.vstack([element.points, element.points[:1]]) if element.closed else element.points


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
