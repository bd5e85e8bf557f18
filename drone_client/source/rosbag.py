"""Bags of ROS 2 in SQLite files, and those of ROS 1."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

import apsw
from rosbags.rosbag1 import Reader as Ros1Reader
from rosbags.rosbag1 import ReaderError as Ros1Error
from rosbags.rosbag2 import Reader as Ros2Reader
from rosbags.rosbag2 import ReaderError as Ros2Error

from drone_client.errors import SourceError
from drone_client.source.bag_file import Decoder, RawMessage, TopicInfo

_DAMAGE: Final = (
    Ros1Error,
    Ros2Error,
    apsw.Error,
    ValueError,
    KeyError,
    IndexError,
    TypeError,  # a column that holds another kind of value
    AssertionError,  # the readers' own checks of what they read
    EOFError,
    OSError,
    OverflowError,
    MemoryError,
)


class RosbagFile:
    """A bag folder, a .db3 file or a .bag file of ROS 1, as a ``BagFile``.

    Raises:
        SourceError: no bag, or one that cannot be read at all.
    """

    def __init__(self, path: Path) -> None:
        self.notes: list[str] = []
        ros1 = path.suffix == ".bag" and path.is_file()
        self._decoder = Decoder(ros1=ros1)
        self._make = Ros1Reader if ros1 else Ros2Reader
        self._paths = [path] if ros1 else self._readable(path)
        self._topics: dict[str, TopicInfo] = {}
        for part in self._paths:
            self._add_topics(part)
        if not any(info.count for info in self._topics.values()):
            said = f": {self.notes[-1]}" if self.notes else ""
            raise SourceError(f"{path}: holds no message{said}")

    @property
    def topics(self) -> Mapping[str, TopicInfo]:
        """What the bag holds."""
        return self._topics

    def decode(self, message: RawMessage) -> Any:
        """The message's fields; raises ValueError."""
        return self._decoder.decode(message.kind, message.data)

    def messages(self, topics: Collection[str]) -> Iterator[RawMessage]:
        """Messages in the order in which they were received; damage ends it, with a note."""
        for part in self._paths:
            yield from self._messages_of(part, topics)

    def _messages_of(self, path: Path, topics: Collection[str]) -> Iterator[RawMessage]:
        count = 0
        try:
            with ExitStack() as stack:
                reader: Any = stack.enter_context(self._make(path))
                wanted = [c for c in reader.connections if c.topic in topics]
                if not wanted:  # to the reader, none would mean all
                    return
                for connection, _, data in reader.messages(connections=wanted):
                    count += 1
                    yield RawMessage(connection.topic, connection.msgtype, bytes(data))
        except _DAMAGE as error:
            self._note(f"{path}: damaged or cut off after {count} messages ({_line(error)})")

    def _readable(self, path: Path) -> list[Path]:
        """The folder if it is whole; otherwise its files, each by itself."""
        if path.is_file():
            return [path]
        try:
            with Ros2Reader(path):
                return [path]
        except _DAMAGE as error:
            parts = sorted(path.glob("*.db3"), key=lambda p: (len(p.name), p.name))
            if not parts:
                raise SourceError(f"{path}: no bag that can be read ({_line(error)})") from None
            self._note(f"{path}: each file is read by itself ({_line(error)})")
            return parts

    def _add_topics(self, path: Path) -> None:
        try:
            with ExitStack() as stack:
                reader: Any = stack.enter_context(self._make(path))
                for c in reader.connections:
                    known = self._topics.get(c.topic, TopicInfo(c.msgtype, 0))
                    self._topics[c.topic] = replace(known, count=known.count + c.msgcount)
        except _DAMAGE as error:
            self._note(f"{path}: cannot be read ({_line(error)})")

    def _note(self, text: str) -> None:
        if text not in self.notes:
            self.notes.append(text)


def _line(error: BaseException) -> str:
    return " ".join(str(error).split()) or type(error).__name__
