"""An open bag: its topics, its messages in time order, single messages by time (room: datasets; host).

In: a .bag, .db3 or .mcap file or the folder of a ROS 2 bag. Out: messages.
"""

import logging
import struct
import weakref
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from semloc_jax.errors import SemlocError, install_command

_LOG = logging.getLogger(__name__)
_LAST_NS = 2**63 - 2
"""Formats keep a time in 64 bits with a sign, and a message is looked up by its time and the nanosecond after it."""


def rosbags_module() -> Any:
    """The library that reads and writes bags.

    Raises:
        SemlocError: it is not installed.
    """
    try:
        import rosbags.highlevel
        import rosbags.typesys
    except ImportError as error:
        raise SemlocError(f"bag: the library rosbags is not installed; run: {install_command('bags')}") from error
    return rosbags


class BagStore:
    """A bag that stays open as long as something refers to it.

    Attributes:
        path: file or folder.
        types: message type of each topic, e.g. `sensor_msgs/msg/Imu`.
        counts: number of messages of each topic.
    """

    def __init__(self, path: Path) -> None:
        """Open a bag.

        Raises:
            SemlocError: the library is missing, or the file is damaged or no bag.
        """
        rosbags = rosbags_module()
        self.path = path
        self._errors = (rosbags.highlevel.AnyReaderError, OSError, ValueError, KeyError, AssertionError, struct.error)
        self._errors += (RuntimeError, TypeError, IndexError, AttributeError, EOFError, MemoryError, OverflowError)
        try:
            distro = rosbags.typesys.Stores.ROS2_HUMBLE
            self._reader = rosbags.highlevel.AnyReader([path], default_typestore=rosbags.typesys.get_typestore(distro))
            self._reader.open()
        except Exception as error:  # the library passes on whatever its storage formats raise
            raise SemlocError(
                f"bag {path}: cannot be opened ({_first_line(error)}); expected a complete .bag, .db3, .mcap or folder "
                "with metadata.yaml; was the recording cut off? (try `ros2 bag reindex` or `rosbag reindex`)"
            ) from error
        weakref.finalize(self, _close, self._reader)
        for connection in self._reader.connections:
            self._require_topic(connection)
        self.types = {connection.topic: connection.msgtype for connection in self._reader.connections}
        self.counts = {topic: 0 for topic in self.types}
        for connection in self._reader.connections:
            self.counts[connection.topic] += connection.msgcount

    def topics_of(self, *types: str) -> list[str]:
        """Topics of any of the given message types that hold messages, sorted."""
        return sorted(topic for topic, kind in self.types.items() if kind in types and self.counts[topic])

    def messages(self, topics: list[str]) -> Iterator[tuple[str, int, bytes]]:
        """Topic, time of recording [ns] and raw message of the given topics, in the order of recording.

        Raises:
            SemlocError: the bag is damaged.
        """
        yield from self._read(topics, None, None)

    def at(self, topic: str, recorded_ns: int) -> bytes:
        """Raw message of a topic that was recorded at a time [ns].

        Raises:
            SemlocError: the bag is damaged.
        """
        for _, _, raw in self._read([topic], recorded_ns, recorded_ns + 1):
            return raw
        raise SemlocError(
            f"bag {self.path}: {topic} has no message at {recorded_ns} ns any more; was the file changed?"
        )

    def decoded(self, topic: str, raw: bytes) -> Any:
        """Message of a topic with its fields as attributes.

        Raises:
            SemlocError: it is not a message of that type.
        """
        try:
            return self._reader.deserialize(raw, self.types[topic])
        except self._errors as error:
            raise SemlocError(
                f"bag {self.path}: {topic}: a message is no {self.types[topic]} ({_first_line(error)}); record it again"
            ) from error

    def stamp_ns(self, raw: bytes, recorded_ns: int) -> int:
        """Time in the header of a raw message [ns]; that of recording where the header says nothing."""
        try:
            if self._reader.is2:
                second, nanosecond = struct.unpack_from("<iI" if raw[1] & 1 else ">iI", raw, 4)
            else:
                second, nanosecond = struct.unpack_from("<II", raw, 4)
        except (struct.error, IndexError):
            return recorded_ns
        return second * 1_000_000_000 + nanosecond if second > 0 or nanosecond > 0 else recorded_ns

    def _read(self, topics: list[str], start: int | None, stop: int | None) -> Iterator[tuple[str, int, bytes]]:
        connections = [c for c in self._reader.connections if c.topic in topics]
        if not connections:
            return
        try:
            for connection, recorded_ns, raw in self._reader.messages(connections, start, stop):
                self._require_message(connection.topic, recorded_ns, raw)
                yield connection.topic, recorded_ns, bytes(raw)
        except SemlocError:
            raise
        except Exception as error:
            raise SemlocError(
                f"bag {self.path}: damaged ({_first_line(error)}); repair it (`ros2 bag reindex`, `rosbag reindex`) or "
                "copy it again"
            ) from error

    def _require_topic(self, connection: Any) -> None:
        """The library passes on what a format holds in the place of these: SQLite has no fixed types."""
        given = (connection.topic, connection.msgtype, connection.msgcount)
        if not (isinstance(given[0], str) and isinstance(given[1], str) and _is_whole(given[2])):
            said = ", ".join(repr(value)[:60] for value in given)
            raise SemlocError(
                f"bag {self.path}: a topic with name, type and number of messages ({said}); expected two words and a "
                "whole number; copy it again or repair it (`ros2 bag reindex`, `rosbag reindex`)"
            )

    def _require_message(self, topic: str, recorded_ns: Any, raw: Any) -> None:
        """A number in the place of the content would be taken as a count of zero bytes, so both are looked at."""
        if not (_is_whole(recorded_ns) and recorded_ns <= _LAST_NS):
            raise SemlocError(
                f"bag {self.path}: {topic}: a message was recorded at {repr(recorded_ns)[:60]}; expected whole "
                "nanoseconds since 1970; copy the bag again or repair it (`ros2 bag reindex`, `rosbag reindex`)"
            )
        if not isinstance(raw, bytes | bytearray | memoryview):
            raise SemlocError(
                f"bag {self.path}: {topic}: a message holds {type(raw).__name__}; expected bytes; copy the bag "
                "again or record it again"
            )


def _is_whole(value: Any) -> bool:
    """Whether a value is a whole number of 0 or more."""
    return isinstance(value, int) and value >= 0


def _close(reader: Any) -> None:
    try:
        reader.close()
    except Exception as error:  # closing may come after the file is gone
        _LOG.debug("bag: not closed: %s", error)


def _first_line(error: BaseException) -> str:
    lines = str(error).strip().splitlines()
    return lines[0][:160] if lines else type(error).__name__
