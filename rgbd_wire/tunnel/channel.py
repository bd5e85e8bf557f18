"""One end of one session: both halves, a lock, and a way to send datagrams."""

from __future__ import annotations

import threading
from collections.abc import Callable, Sequence
from enum import Enum

from rgbd_wire.tunnel.errors import Counters, Refusal, TunnelError
from rgbd_wire.tunnel.handshake import SessionKeys
from rgbd_wire.tunnel.inner import Goodbye, Inner, Nack, Ping, Report, parse_word
from rgbd_wire.tunnel.packet import Type
from rgbd_wire.tunnel.partials import Partials
from rgbd_wire.tunnel.seal import Opener, Sealer
from rgbd_wire.tunnel.sending import LinkState, Sending

_SHARD = int(Inner.SHARD)


class Side(Enum):
    """Which end."""

    DRONE = Type.UP
    WORKER = Type.DOWN


class Channel:
    """Sends from any thread; receives and ticks on one.

    Args:
        keys: of the session.
        side: which end this is.
        transmit: sends datagrams at once, never raises; how many left.
        counters: where refusals are counted.
        now_ns: own clock.
    """

    def __init__(
        self,
        keys: SessionKeys,
        side: Side,
        transmit: Callable[[Sequence[bytes]], int],
        counters: Counters,
        now_ns: int,
    ) -> None:
        self.session = keys.session
        up, down = (Type.UP, keys.up), (Type.DOWN, keys.down)
        (out_type, out_key), (in_type, in_key) = (up, down) if side is Side.DRONE else (down, up)
        self._opener = Opener(in_type, keys.session, keys.cipher, in_key)
        self._sending = Sending(
            Sealer(out_type, keys.session, keys.cipher, out_key), counters, now_ns
        )
        self._partials = Partials(counters)
        self._counters = counters
        self._transmit = transmit
        self._lock = threading.Lock()
        self.heard_ns = now_ns
        """When the last authentic datagram came."""
        self.said_goodbye = False
        """The worker drains."""

    @property
    def newest_number(self) -> int:
        """Highest packet number received, -1: none."""
        return self._opener.window.newest

    @property
    def received(self) -> int:
        """How many authentic datagrams came."""
        return self._opener.window.count

    @property
    def in_pieces(self) -> bool:
        """A message has begun to arrive: ``tick`` is wanted."""
        return self._partials.deadline_ns is not None

    @property
    def packets(self) -> int:
        """How many datagrams were sealed with one of these keys, either way."""
        return max(self._sending.sealed, self.newest_number + 1)

    def state(self) -> LinkState:
        """What is known of the way to the other end."""
        with self._lock:
            return self._sending.state()

    def send(self, message: bytes, budget_ns: int, now_ns: int) -> int | None:
        """Send a frame as far as the pacer lets it; when ``pump`` is due for the rest, if ever."""
        with self._lock:
            if self._sending.used_up:
                self._counters.count(Refusal.NOT_SENT)
                return None
            self._sending.submit(message, budget_ns, now_ns)
            return self._pump(now_ns)

    def send_urgent(self, message: bytes, budget_ns: int, now_ns: int) -> int | None:
        """Send a small message at once; when ``pump`` is due for a copy, if ever."""
        with self._lock:
            if self._sending.used_up:
                self._counters.count(Refusal.NOT_SENT)
                return None
            self._send(self._sending.urgent(message, budget_ns, now_ns))
            return self._sending.due_ns()

    def pump(self, now_ns: int) -> int | None:
        """Send what is due; when to come back, None: nothing waits."""
        with self._lock:
            return self._pump(now_ns)

    def ping(self, now_ns: int) -> None:
        """Ask for a sign of life; also keeps the way through a NAT open."""
        self._say(self._ping(back=False, stamp_ns=now_ns))

    def goodbye(self) -> None:
        """Tell the drone to go elsewhere."""
        self._say(Goodbye())

    def receive(self, data: memoryview, segment: int, now_ns: int) -> list[bytes]:
        """Open datagrams that came at once; the messages that are whole now.

        Hand them on, then call ``settle``: an answer leaves before the words of the tunnel.

        Args:
            data: the datagrams.
            segment: length of each, but the last.
            now_ns: own clock, when they were here.
        """
        messages: list[bytes] = []
        partials = self._partials
        inners = self._opener.open_all(data, segment, self._counters)
        if not inners:
            return messages
        self.heard_ns = now_ns
        index, count = partials.add_run(inners, 0, now_ns), len(inners)
        while index < count:
            inner = inners[index]
            index += 1
            if inner[0] == _SHARD:
                message = partials.add(inner, now_ns)
                if message is not None:
                    messages.append(message)
                elif index < count:
                    index = partials.add_run(inners, index, now_ns)
            else:
                try:
                    self._on_word(inner, now_ns)
                except TunnelError as error:
                    self._counters.count(error.reason)
        return messages

    def settle(self, now_ns: int) -> None:
        """After ``receive``: report what is whole, see when to ask for what is not."""
        self._partials.settle(now_ns)
        self._say_words()

    def tick(self, now_ns: int) -> int | None:
        """Ask for what lacks; when to come back, None: nothing is in pieces."""
        due_ns = self._partials.deadline_ns
        if due_ns is not None and due_ns <= now_ns:
            self._partials.tick(now_ns)
            self._say_words()
            due_ns = self._partials.deadline_ns
        return due_ns

    def _on_word(self, inner: bytes, now_ns: int) -> None:
        match parse_word(inner):
            case Nack() as nack:
                with self._lock:
                    self._send(self._sending.on_nack(nack, now_ns))
            case Report() as report:
                with self._lock:
                    self._sending.on_report(report, now_ns)
            case Ping(back=False) as ping:
                with self._lock:
                    self._sending.on_numbers(ping, now_ns)
                    if ping.srtt_us:
                        self._set_srtt(ping.srtt_us * 1000)
                self._say(self._ping(back=True, stamp_ns=ping.stamp_ns))
            case Ping(back=True) as pong:
                round_trip_ns = now_ns - pong.stamp_ns
                with self._lock:
                    self._sending.on_numbers(pong, now_ns)
                    if round_trip_ns >= 0:
                        old = self._sending.srtt_ns or round_trip_ns
                        self._set_srtt(max(1000, old + (round_trip_ns - old) // 8))
            case Goodbye():
                self.said_goodbye = True

    def _ping(self, *, back: bool, stamp_ns: int) -> Ping:
        window = self._opener.window
        srtt_us = self._sending.srtt_ns // 1000
        return Ping(back, stamp_ns, srtt_us, window.newest + 1, window.count)

    def _set_srtt(self, srtt_ns: int) -> None:
        self._sending.srtt_ns = srtt_ns
        self._partials.srtt_ns = srtt_ns

    def _say(self, word: Nack | Report | Ping | Goodbye) -> None:
        with self._lock:
            if not self._sending.used_up:
                self._send([self._sending.word(word)])

    def _say_words(self) -> None:
        words = self._partials.words
        if words:
            with self._lock:
                if not self._sending.used_up:
                    self._send([self._sending.word(word) for word in words])
            words.clear()

    def _pump(self, now_ns: int) -> int | None:
        self._send(self._sending.copies(now_ns))
        while burst := self._sending.burst(now_ns):
            self._send(burst)
        return self._sending.due_ns()

    def _send(self, datagrams: list[bytes]) -> None:
        if datagrams:
            sent = self._transmit(datagrams)
            if sent < len(datagrams):
                self._counters.count(Refusal.NOT_SENT, len(datagrams) - sent)
