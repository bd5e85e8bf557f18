"""A recording of ROS messages, whatever its container: topics, and messages one after another."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass
from typing import Any, Protocol

_TF_MESSAGE = ("geometry_msgs/TransformStamped[] transforms", "tf2_msgs/msg/TFMessage")


@dataclass(frozen=True, slots=True)
class TopicInfo:
    """One topic of a bag."""

    kind: str
    """Type of its messages, such as ``sensor_msgs/msg/Image``."""
    count: int
    """Messages."""


@dataclass(frozen=True, slots=True)
class RawMessage:
    """A message as it lies in the bag."""

    topic: str
    kind: str
    data: bytes


class BagFile(Protocol):
    """Gives a bag's messages; never holds more of them than one chunk."""

    notes: list[str]
    """What could not be read, as far as that is known by now."""

    @property
    def topics(self) -> Mapping[str, TopicInfo]:
        """What the bag holds."""
        ...

    def messages(self, topics: Collection[str]) -> Iterator[RawMessage]:
        """Messages of some topics in the order of the recording.

        Damage ends it early and leaves a note, and never an exception.
        """
        ...

    def decode(self, message: RawMessage) -> Any:
        """The message's fields.

        Raises:
            ValueError: it is damaged, or of a type that is not known here.
        """
        ...


class Decoder:
    """Decodes the standard messages by their own, fixed definitions.

    Definitions that come with a bag are not used: nobody's file brings code along.
    """

    def __init__(self, *, ros1: bool) -> None:
        from rosbags.serde import SerdeError  # the extra "bags" is needed from here on
        from rosbags.typesys import Stores, get_types_from_msg, get_typestore

        store = get_typestore(Stores.ROS1_NOETIC if ros1 else Stores.ROS2_HUMBLE)
        if ros1:  # there it is no standard message
            store.register(get_types_from_msg(*_TF_MESSAGE))
        self._known = store.fielddefs
        self._read = store.deserialize_ros1 if ros1 else store.deserialize_cdr
        self._damage: tuple[type[Exception], ...] = (
            SerdeError,
            ValueError,  # also: no text where a text should be
            IndexError,
            OverflowError,
            MemoryError,
        )

    def decode(self, kind: str, data: bytes) -> Any:
        """A message's fields.

        Raises:
            ValueError: it is damaged, or of a type that is not known here.
        """
        if kind not in self._known:
            raise ValueError(f"no definition of {kind[:80]}")
        try:
            return self._read(data, kind)
        except self._damage as error:
            raise ValueError(f"damaged {kind}: {error}") from None
