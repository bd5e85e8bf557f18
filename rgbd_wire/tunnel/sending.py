"""The sending half of a session: what goes out, in which order, how fast, how often again."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

from rgbd_wire.tunnel.errors import Counters, Refusal
from rgbd_wire.tunnel.inner import Nack, Ping, Report, Word, pack_word
from rgbd_wire.tunnel.pacing import Pacer
from rgbd_wire.tunnel.parity import ParityControl
from rgbd_wire.tunnel.seal import Sealer
from rgbd_wire.tunnel.shards import MAX_MESSAGE_BYTES, MESSAGE_IDS, Outgoing, symbols_of

MAX_WAITING = 2
"""Messages that wait for the pacer; a third one pushes out the oldest that has not begun."""
MAX_KEPT = 8
MAX_KEPT_BYTES = 3 * MAX_MESSAGE_BYTES
COPY_AFTER_NS = 3_000_000
"""A second copy of a small message leaves so much later: past most bursts of losses."""
LOSSY_FOR_NS = 10_000_000_000
MAX_BATCH = 54
"""Datagrams sealed at a time: while the next ones are sealed, the other end opens these."""
SHORT_WAY_NS = 1_500_000
"""Round trip under which parity waits for the report that makes it needless."""
MAX_COPIES = 64
PAUSE_NS = 500_000
"""A sender that comes so much too late has paused, as far as the measured rate goes."""


@dataclass(frozen=True, slots=True)
class LinkState:
    """What one side knows of the way to the other."""

    goodput_bps: float
    """Rate at which trains of datagrams arrived; 0: nothing known yet."""
    rate_bps: float
    """Rate at which datagrams leave at most."""
    loss: float
    """Share of datagrams that is lost, of late."""
    parity: float
    """Repair symbols over data of the last message."""
    srtt_ns: int
    """Smoothed round trip, 0: none measured yet."""


class Sending:
    """Seals what goes out of one side of a session. Pure: whoever calls it sends what it returns.

    Args:
        sealer: of this direction.
        counters: where a message that is pushed out is counted.
        now_ns: own clock.
    """

    def __init__(self, sealer: Sealer, counters: Counters, now_ns: int) -> None:
        self._sealer = sealer
        self._counters = counters
        self._pacer = Pacer(now_ns)
        self._parity = ParityControl()
        self._waiting: deque[Outgoing] = deque()
        self._kept: dict[int, Outgoing] = {}
        self._copies: deque[tuple[int, bytes]] = deque()
        self._next_id = 0
        self._lossy_until_ns = 0
        self._peer_number = 0
        self._peer_count = 0
        self._loss = 0.0
        self.srtt_ns = 0

    @property
    def used_up(self) -> bool:
        """No more can be sealed with these keys."""
        return self._sealer.used_up

    @property
    def sealed(self) -> int:
        """How many datagrams were sealed with these keys."""
        return self._sealer.number

    def state(self) -> LinkState:
        """What is known of the way."""
        return LinkState(
            self._pacer.goodput_bps,
            self._pacer.rate_bps,
            self._loss,
            self._parity.rate,
            self.srtt_ns,
        )

    def submit(self, message: bytes, budget_ns: int, now_ns: int) -> None:
        """Hand in a frame; ``burst`` gives its datagrams."""
        outgoing = self._outgoing(message, budget_ns, now_ns, crowded=self._pacer.crowded)
        self._pacer.on_message(outgoing.symbols + outgoing.parity, now_ns)
        if len(self._waiting) >= MAX_WAITING:
            for old in self._waiting:
                if not old.begun:
                    self._waiting.remove(old)
                    self._counters.count(Refusal.NOT_SENT)
                    break
        self._waiting.append(outgoing)

    def burst(self, now_ns: int) -> list[bytes]:
        """Datagrams that may leave now, at most 64; to be called until it gives none."""
        while self._waiting:
            outgoing = self._waiting[0]
            if not outgoing.left:
                self._waiting.popleft()
                continue
            count = min(self._pacer.packets(now_ns), outgoing.left, MAX_BATCH)
            if outgoing.data_left:  # parity comes by itself: its encoding holds no data up
                count = min(count, outgoing.data_left)
            elif now_ns < outgoing.parity_ns:
                return []
            if count == 0:
                return []
            self._note_departure(outgoing, now_ns)
            self._pacer.spend(count)
            shards = outgoing.take(count)
            outgoing.left_ns = now_ns
            if not outgoing.data_left and 0 < self.srtt_ns < SHORT_WAY_NS:
                outgoing.parity_ns = outgoing.parity_ns or now_ns + 2 * self.srtt_ns + 1_000_000
            return self._sealer.seal_all(shards)
        return []

    def urgent(self, message: bytes, budget_ns: int, now_ns: int) -> list[bytes]:
        """All datagrams of a small message, to leave at once, past every frame."""
        outgoing = self._outgoing(message, budget_ns, now_ns, crowded=False)
        shards = outgoing.take(outgoing.symbols)
        if outgoing.symbols > 1:
            shards += outgoing.take(outgoing.parity)
        elif now_ns < self._lossy_until_ns and len(self._copies) < MAX_COPIES:
            self._copies.append((now_ns + COPY_AFTER_NS, shards[0]))
        self._pacer.spend(len(shards))
        return self._sealer.seal_all(shards)

    def copies(self, now_ns: int) -> list[bytes]:
        """Second copies that are due."""
        if not self._copies:
            return []
        due: list[bytes] = []
        while self._copies and self._copies[0][0] <= now_ns:
            due.append(self._copies.popleft()[1])
        return self._sealer.seal_all(due)

    def due_ns(self) -> int | None:
        """When ``burst`` or ``copies`` have something next; None: nothing waits."""
        times: list[int] = []
        if self._copies:
            times.append(self._copies[0][0])
        left = sum(outgoing.left for outgoing in self._waiting)
        if left:
            first = next(o for o in self._waiting if o.left)
            not_before_ns = 0 if first.data_left else first.parity_ns
            times.append(self._pacer.ready_ns(left, not_before_ns))
        else:
            self._pacer.nothing_waits()
        return min(times, default=None)

    def word(self, word: Word) -> bytes:
        """A datagram with one of the tunnel's own words."""
        return self._sealer.seal(pack_word(word))

    def on_nack(self, nack: Nack, now_ns: int) -> list[bytes]:
        """Fresh symbols, if they can still come in time; each round is answered once."""
        outgoing = self._kept.get(nack.message_id)
        if outgoing is None or nack.round <= outgoing.rounds:
            return []
        if now_ns - outgoing.sent_ns + self.srtt_ns // 2 > outgoing.budget_ns:
            self._counters.count(Refusal.LATE)
            return []
        # What has not left, or cannot have been there when it was asked for, is not sent again
        under_way = outgoing.left > 0 or now_ns - outgoing.left_ns < self.srtt_ns
        wanted = nack.wanted - (nack.expected if under_way else 0)
        wanted = min(wanted, outgoing.symbols + 8)
        if wanted <= 0:
            return []
        outgoing.rounds = nack.round
        self._lossy_until_ns = now_ns + LOSSY_FOR_NS
        shards = outgoing.take_fresh(wanted)
        self._pacer.spend(len(shards))
        return self._sealer.seal_all(shards)

    def on_report(self, report: Report, now_ns: int) -> None:
        """What the receiver saw of one message."""
        self._parity.on_report(report.received, report.lost)
        outgoing = self._kept.get(report.message_id)
        restarts: list[tuple[int, int]] = []
        if outgoing is not None and report.whole and not report.lost:  # else its end may be missing
            restarts = outgoing.restarts(report.received)
        self._pacer.on_report(report.received, report.train_bytes, report.train_us, restarts)
        if outgoing is not None and report.whole:
            outgoing.drop_rest()
        if report.lost:
            self._lossy_until_ns = now_ns + LOSSY_FOR_NS

    def on_numbers(self, ping: Ping, now_ns: int) -> None:
        """How many of the datagrams that were sealed here arrived, by the other side's count."""
        sent, came = ping.next_number - self._peer_number, ping.count - self._peer_count
        if sent <= 0 or came < 0:
            return  # overtaken by a newer one
        self._peer_number, self._peer_count = ping.next_number, ping.count
        lost = min(max(0.0, 1 - came / sent), 1.0)
        self._loss += (lost - self._loss) * min(1.0, sent / 256)
        if lost:
            self._lossy_until_ns = now_ns + LOSSY_FOR_NS

    def _note_departure(self, outgoing: Outgoing, now_ns: int) -> None:
        """Before symbols leave: whether they are the first ones, or come after a pause."""
        departures = outgoing.departures
        if not departures:
            outgoing.was_path_free = self._pacer.is_path_free(now_ns)
        parity_waited = outgoing.parity_ns > 0 and not outgoing.data_left
        paused = parity_waited or self._pacer.late_ns >= PAUSE_NS
        if not departures or (paused and now_ns > outgoing.left_ns):
            departures.append((now_ns, outgoing.next_symbol))

    def _outgoing(self, message: bytes, budget_ns: int, now_ns: int, *, crowded: bool) -> Outgoing:
        if not 0 < len(message) <= MAX_MESSAGE_BYTES:
            raise ValueError(f"a message of {len(message)} bytes, not 1 to {MAX_MESSAGE_BYTES}")
        symbols = symbols_of(len(message))
        parity = self._parity.symbols(symbols, crowded=crowded) if symbols > 1 else 0
        outgoing = Outgoing(message, self._next_id, parity, now_ns, budget_ns)
        self._next_id = (self._next_id + 1) % MESSAGE_IDS
        if symbols > 1:
            self._kept[outgoing.message_id] = outgoing
            while len(self._kept) > MAX_KEPT or (
                len(self._kept) > 1
                and sum(len(o.message) for o in self._kept.values()) > MAX_KEPT_BYTES
            ):
                del self._kept[next(iter(self._kept))]
        return outgoing
