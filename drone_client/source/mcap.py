"""MCAP files with ROS 2 messages, read from front to back: also those that were cut off.

A recorder that lost power leaves a file without index and end. The records before the cut are
whole, so nothing but the file's order is relied upon; where there is an index, topics and counts
come from it, otherwise from one pass through the file.
"""

from __future__ import annotations

import re
import struct
from collections import Counter
from collections.abc import Collection, Iterable, Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

import lz4.frame  # type: ignore[import-untyped]
import zstandard
from mcap.exceptions import McapError
from mcap.reader import SeekingReader
from mcap.records import Channel, Chunk, McapRecord, Message, Schema
from mcap.stream_reader import StreamReader, breakup_chunk

from drone_client.errors import SourceError
from drone_client.source.bag_file import Decoder, RawMessage, TopicInfo

MAX_RECORD_BYTES: Final = 256 * 1024 * 1024
"""A chunk, before and after it is unpacked; recorders write 1 to 4 MiB and a few pictures."""
MAX_TOPICS: Final = 10_000
_DAMAGE: Final = (
    McapError,
    struct.error,
    zstandard.ZstdError,
    ValueError,  # checksums, text that is none
    RuntimeError,  # lz4
    OSError,
    EOFError,
    KeyError,
    OverflowError,
    MemoryError,
)


class McapFile:
    """One or several MCAP files of one recording, as a ``BagFile``.

    Raises:
        SourceError: no MCAP, or not one message could be read.
    """

    def __init__(self, paths: Iterable[Path]) -> None:
        self.notes: list[str] = []
        self._paths = sorted(paths, key=_in_order)
        self._decoder = Decoder(ros1=False)
        self._topics: dict[str, TopicInfo] = {}
        for path in self._paths:
            for topic, info in self._topics_of(path).items():
                known = self._topics.get(topic, TopicInfo(info.kind, 0))
                self._topics[topic] = replace(known, count=known.count + info.count)
        if not any(info.count for info in self._topics.values()):
            said = f": {self.notes[0]}" if self.notes else ""
            raise SourceError(f"{self._paths[0]}: holds no message of ROS 2{said}")

    @property
    def topics(self) -> Mapping[str, TopicInfo]:
        """What the files hold."""
        return self._topics

    def decode(self, message: RawMessage) -> Any:
        """The message's fields; raises ValueError."""
        return self._decoder.decode(message.kind, message.data)

    def messages(self, topics: Collection[str]) -> Iterator[RawMessage]:
        """Messages in the files' order; a cut ends it, with a note."""
        for path in self._paths:
            yield from self._messages_of(path, frozenset(topics))

    def _messages_of(self, path: Path, topics: frozenset[str] | None) -> Iterator[RawMessage]:
        schemas: dict[int, Schema] = {}
        channels: dict[int, RawMessage] = {}
        """By channel: topic and type."""
        count = 0
        try:
            with path.open("rb") as file:
                for record in _records(
                    StreamReader(file, emit_chunks=True, record_size_limit=MAX_RECORD_BYTES)
                ):
                    if isinstance(record, Schema):
                        schemas[record.id] = record
                    elif isinstance(record, Channel) and len(channels) < MAX_TOPICS:
                        _add_channel(channels, record, schemas.get(record.schema_id))
                    elif isinstance(record, Message):
                        count += 1
                        of = channels.get(record.channel_id)
                        if of is not None and (topics is None or of.topic in topics):
                            yield replace(of, data=record.data)
        except _DAMAGE as error:
            self._note(
                f"{path}: damaged or cut off after {count} messages "
                f"({' '.join(str(error).split()) or type(error).__name__})"
            )

    def _topics_of(self, path: Path) -> dict[str, TopicInfo]:
        indexed = _topics_of_index(path)
        if indexed is not None:
            return indexed
        counts: Counter[str] = Counter()
        kinds: dict[str, str] = {}
        for message in self._messages_of(path, None):
            counts[message.topic] += 1
            kinds[message.topic] = message.kind
        return {topic: TopicInfo(kind, counts[topic]) for topic, kind in kinds.items()}

    def _note(self, text: str) -> None:
        if text not in self.notes:
            self.notes.append(text)


def _records(reader: StreamReader) -> Iterator[McapRecord]:
    """All records in order, chunks unpacked one at a time."""
    for record in reader.records:
        if not isinstance(record, Chunk):
            yield record
            continue
        size = max(record.uncompressed_size, _unpacked_bytes(record))
        if size > MAX_RECORD_BYTES:
            raise ValueError(f"a chunk of {size} bytes")
        yield from breakup_chunk(record, validate_crc=True)


def _unpacked_bytes(chunk: Chunk) -> int:
    """What the packed data themselves say, which need not be what the chunk says."""
    if chunk.compression == "zstd":
        return int(zstandard.frame_content_size(chunk.data))
    if chunk.compression == "lz4":
        return int(lz4.frame.get_frame_info(chunk.data)["content_size"])
    return len(chunk.data)


def _add_channel(channels: dict[int, RawMessage], channel: Channel, schema: Schema | None) -> None:
    """Only those with ROS 2's encoding; others are not ours to read."""
    if schema is not None and channel.message_encoding == "cdr":
        channels[channel.id] = RawMessage(channel.topic, schema.name, b"")


def _topics_of_index(path: Path) -> dict[str, TopicInfo] | None:
    """Topics and counts by the index at the file's end; None: there is none that can be used."""
    try:
        with path.open("rb") as file:
            summary = SeekingReader(file, record_size_limit=MAX_RECORD_BYTES).get_summary()
    except FileNotFoundError as error:
        raise SourceError(f"{path}: {error.strerror}") from None
    except _DAMAGE:
        return None
    if summary is None or summary.statistics is None or not summary.channels:
        return None
    channels: dict[int, RawMessage] = {}
    for channel in summary.channels.values():
        _add_channel(channels, channel, summary.schemas.get(channel.schema_id))
    counts: Counter[str] = Counter()
    for number, of in channels.items():
        counts[of.topic] += summary.statistics.channel_message_counts.get(number, 0)
    return {of.topic: TopicInfo(of.kind, counts[of.topic]) for of in channels.values()}


def _in_order(path: Path) -> tuple[int, str]:
    """Files of one recording end in _0, _1, ... _10."""
    number = re.search(r"_(\d+)$", path.stem)
    return (int(number.group(1)) if number else -1, path.name)
