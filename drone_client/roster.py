"""What a drone knows of its workers, and which of them it goes to.

A worker is left when it is gone (its token or session is down), when it drains, or when it is
suspect: several replies in a row missed, frames acknowledged and never answered, or answers that
turn frames away; and one that is full is not gone to. A lease would
notice a hung worker or a black hole after seconds; replies are due every few tens of milliseconds,
so missing ones tell within a few hundred (docs/freshness.md). A suspect is still probed, and
trusted again after several replies in a row.

Pure: time is an argument. Not thread-safe.
"""

from __future__ import annotations

import hashlib
from collections.abc import Collection
from dataclasses import dataclass
from enum import StrEnum

from drone_client.worker_choice import ranked
from rgbd_wire.messages import Status

REMEMBERED_STARTS = 8
MAX_REMEMBERED = 64
DEFAULT_ROUND_TRIP_NS = 20_000_000
LATELY_NS = 1_000_000_000
"""A worker that replied so lately is there."""
"""Of a worker that was not measured yet: neither the best nor the worst."""


class Standing(StrEnum):
    """Whether a drone would go to a worker."""

    WILLING = "willing"
    DRAINING = "draining"
    """About to stop, by its own word."""
    SUSPECT = "suspect"
    """Alive as far as the link knows, but it does not answer."""
    FULL = "full"
    """It has as many drones as it may, and this one is not among them."""
    GONE = "gone"


@dataclass(frozen=True, slots=True)
class RosterSettings:
    """When a worker is left, and for whom."""

    misses: int = 3
    """Replies missed in a row that make a worker suspect."""
    replies: int = 3
    """Replies in a row that clear it."""
    result_cooldown_ns: int = 5_000_000_000
    """A worker that acknowledges but never answers, or turns frames away, is not asked for so
    long: its echoes say nothing of that."""
    better_ratio: float = 1.5
    """A worker that works is left for one whose expected delay is so many times smaller ..."""
    better_by_ns: int = 10_000_000
    """... and smaller by this much ..."""
    better_for_ns: int = 1_000_000_000
    """... for so long, and up to as long again, by the drone's name: a fleet does not move as
    one."""


class _Worker:
    __slots__ = (
        "boot_id",
        "boot_ids",
        "draining",
        "heard_ns",
        "missed",
        "overdue",
        "refused",
        "replied",
        "round_trip_ns",
        "service_ns",
        "status",
        "suspect",
        "until_ns",
    )

    def __init__(self, boot_ids: tuple[int, ...] = ()) -> None:
        self.boot_ids = boot_ids
        """Of the starts that were heard of, the newest last."""
        self.draining = False
        self.suspect = False
        self.until_ns = 0
        """Not trusted before this time, whatever it replies."""
        self.missed = 0
        """Replies missed since the last one that came."""
        self.overdue = 0
        """Frames it acknowledged and left without a result since the last result."""
        self.refused = 0
        """Answers in a row that turned a frame away."""
        self.replied = 0
        """Replies since it became suspect, in a row."""
        self.heard_ns: int | None = None
        """When its last reply came."""
        self.boot_id: int | None = None
        self.status: Status | None = None
        self.round_trip_ns = DEFAULT_ROUND_TRIP_NS
        self.service_ns = 0
        """What a frame takes there, by its word; 0: it never said."""


class Roster:
    """The workers that a drone knows of; a few dozen at most, as the link bounds them."""

    def __init__(self, drone: str, settings: RosterSettings | None = None) -> None:
        self._drone = drone
        self._settings = settings or RosterSettings()
        self._workers: dict[str, _Worker] = {}
        self._current: str | None = None
        self._same_name: set[str] = set()
        self._went_draining: set[str] = set()
        """Workers that are gone after they had said that they would: they answer what they have."""
        self._better_since_ns: int | None = None
        digest = hashlib.blake2b(drone.encode(), digest_size=8).digest()
        self._patience_ns = self._settings.better_for_ns + (
            int.from_bytes(digest, "big") % self._settings.better_for_ns
        )

    @property
    def current(self) -> str | None:
        """The worker chosen last."""
        return self._current

    @property
    def same_name(self) -> list[str]:
        """Names under which two workers say how they are; each takes the other's frames."""
        return sorted(self._same_name)

    def see(self, live: Collection[str]) -> None:
        """Take over who is alive as far as the link knows; one that comes back starts afresh."""
        for name in [n for n in self._workers if n not in live]:
            if self._workers.pop(name).draining and len(self._went_draining) < MAX_REMEMBERED:
                self._went_draining.add(name)
        self._went_draining.difference_update(live)
        for name in live:
            self._workers.setdefault(name, _Worker())

    def standing(self, worker: str) -> Standing:
        """Whether this drone would go to a worker."""
        w = self._workers.get(worker)
        if w is None:
            return Standing.GONE
        if w.draining:
            return Standing.DRAINING
        if w.suspect:
            return Standing.SUSPECT
        full = w.status is not None and w.status.drones >= w.status.max_drones
        return Standing.FULL if full and worker != self._current else Standing.WILLING

    def keeps_its_frames(self, worker: str) -> bool:
        """Whether a worker that is left still answers what it has: it drains, or works."""
        standing = self.standing(worker)
        if standing is Standing.GONE:
            return worker in self._went_draining
        return standing is not Standing.SUSPECT

    def standings(self) -> dict[str, str]:
        """All of them, for people to read."""
        return {name: self.standing(name).value for name in sorted(self._workers)}

    def replied(self, worker: str, now_ns: int, round_trip_ns: int | None = None) -> None:
        """A reply of any kind came: an ack, an echo or a result.

        Args:
            worker: whose it is.
            now_ns: drone's clock.
            round_trip_ns: of the empty way to it, where this reply tells; never that of a frame,
                which waits behind itself and would make every idle worker look faster.
        """
        if (w := self._workers.get(worker)) is None:
            return
        if round_trip_ns is not None:
            w.round_trip_ns += (round_trip_ns - w.round_trip_ns) // 4
        w.missed, w.heard_ns = 0, now_ns
        if not w.suspect:
            return
        w.replied += 1
        if w.replied >= self._settings.replies and now_ns >= w.until_ns:
            w.suspect = False
            w.overdue = w.refused = 0

    def answered(self, worker: str) -> None:
        """A result came that turned nothing away: the part that looks at pictures runs."""
        if (w := self._workers.get(worker)) is not None:
            w.overdue = w.refused = 0

    def refused(self, worker: str, now_ns: int) -> bool:
        """A result turned a frame away; True: that made the worker suspect."""
        if (w := self._workers.get(worker)) is None:
            return False
        w.overdue = 0
        w.refused += 1
        if w.suspect or w.refused < self._settings.misses:
            return False
        self._distrust(w, now_ns)
        return True

    def missed(self, worker: str) -> bool:
        """A reply that was due did not come; True: that made the worker suspect."""
        if (w := self._workers.get(worker)) is None:
            return False
        w.missed += 1
        w.replied = 0
        if w.suspect or w.missed < self._settings.misses:
            return False
        w.suspect = True
        return True

    def overdue(self, worker: str, now_ns: int) -> bool:
        """An acknowledged frame got no result; True: that made the worker suspect."""
        if (w := self._workers.get(worker)) is None:
            return False
        w.overdue += 1
        if w.suspect or w.overdue < self._settings.misses:
            return False
        self._distrust(w, now_ns)
        return True

    def take_status(self, status: Status) -> None:
        """A worker says how it is. It is no reply: a black hole on the way up lets it through."""
        if (w := self._workers.get(status.worker)) is None:
            return
        if w.boot_id != status.worker_boot_id:
            if status.worker_boot_id in w.boot_ids:
                # No worker goes back to an earlier start: there are two of that name
                self._same_name.add(status.worker)
            else:
                known = (*w.boot_ids, status.worker_boot_id)[-REMEMBERED_STARTS:]
                # Another start is another worker; of the first one heard of, it is known already
                w = _Worker(known) if w.boot_id is not None else w
                w.boot_ids = known
                self._workers[status.worker] = w
        w.boot_id = status.worker_boot_id
        w.status = status
        w.service_ns = status.service_p50_ns or w.service_ns
        w.draining = status.draining

    def drains(self, worker: str) -> None:
        """A result says that its worker is about to stop."""
        if (w := self._workers.get(worker)) is not None:
            w.draining = True

    def expected_delay_ns(self, worker: str) -> int:
        """From sending a frame to its result, by what is known of the worker."""
        w = self._workers.get(worker)
        if w is None:
            return DEFAULT_ROUND_TRIP_NS
        # One that served nobody lately says 0: it takes as long as it last did, or as others do
        service_ns = w.service_ns or max((o.service_ns for o in self._workers.values()), default=0)
        waiting = 0 if w.status is None else min(w.status.waiting, 64)
        return w.round_trip_ns + service_ns * (1 + waiting)

    def choose(self, now_ns: int) -> str | None:
        """The worker to send to; None if none is alive.

        The current one as long as it is willing and no other is much better for long: a change of
        worker costs frames. A suspect is asked only where there is no other: one that
        still replies, and rather one that turns frames away than one that leaves them, before the
        one heard of last; a full or a draining one when there is nobody else at all.
        """
        willing = self._with(Standing.WILLING)
        if self._current not in willing:
            self._better_since_ns = None
            self._current = self._best(willing) or self._least_suspect(now_ns)
            return self._current
        best = min(willing, key=self.expected_delay_ns)
        if self._is_much_better(best):
            since_ns = now_ns if self._better_since_ns is None else self._better_since_ns
            self._better_since_ns = since_ns
            if now_ns - since_ns >= self._patience_ns:
                self._better_since_ns = None
                self._current = best
        else:
            self._better_since_ns = None
        return self._current

    def runner_up(self) -> str | None:
        """Whom a second copy would go to: the best willing one but the current; None: nobody."""
        return self._best([w for w in self._with(Standing.WILLING) if w != self._current])

    def _distrust(self, w: _Worker, now_ns: int) -> None:
        w.suspect, w.replied = True, 0
        w.until_ns = now_ns + self._settings.result_cooldown_ns

    def _with(self, standing: Standing) -> list[str]:
        return [name for name in self._workers if self.standing(name) is standing]

    def _best(self, names: list[str]) -> str | None:
        weights = {name: 1e9 / max(1_000_000, self.expected_delay_ns(name)) for name in names}
        return ranked(self._drone, weights)[0] if weights else None

    def _least_suspect(self, now_ns: int) -> str | None:
        suspects = self._with(Standing.SUSPECT)
        if not suspects:
            return self._best(self._with(Standing.FULL)) or self._best(
                self._with(Standing.DRAINING)
            )

        def hope(name: str) -> tuple[bool, bool, int, bool, str]:
            w, is_current = self._workers[name], name == self._current
            heard_ns = -1 if w.heard_ns is None else w.heard_ns
            replies = w.heard_ns is not None and now_ns - w.heard_ns <= LATELY_NS
            looks = w.overdue < self._settings.misses
            # of those that reply, the last word says nothing: each has it in turn
            return replies, replies and looks, -1 if replies else heard_ns, is_current, name

        return max(suspects, key=hope)

    def _is_much_better(self, best: str) -> bool:
        assert self._current is not None
        now_ns, then_ns = self.expected_delay_ns(self._current), self.expected_delay_ns(best)
        s = self._settings
        return now_ns > s.better_ratio * then_ns and now_ns - then_ns > s.better_by_ns
