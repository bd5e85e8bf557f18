"""A worker's sessions: who holds which, how many there may be, when they end. Pure bookkeeping."""

from __future__ import annotations

from dataclasses import dataclass, field

from rgbd_wire.tunnel.bucket import Bucket
from rgbd_wire.tunnel.channel import Channel
from rgbd_wire.tunnel.datagrams import Way
from rgbd_wire.tunnel.handshake import COOKIE_AGE_NS

MAX_SESSIONS = 256
MAX_PER_DRONE = 4
IDLE_NS = 10_000_000_000
"""A drone says something four times a second."""
UNCONFIRMED_NS = 5_000_000_000
MAX_HELLOS_PER_DRONE = 32
"""New sessions of one drone in the life of a cookie: each costs a key exchange."""
DATAGRAMS_HZ, DATAGRAMS_BURST = 8000.0, 8192
"""Of one drone: about 70 Mbit/s of frames, and one frame of the largest size at once."""
MESSAGES_HZ, MESSAGES_BURST = 150.0, 60
"""Of one drone: three times what frames and probes together come to."""


class DroneQuota:
    """What one drone may have handled, over all of its sessions."""

    def __init__(self, now_ns: int, messages_hz: float = MESSAGES_HZ) -> None:
        burst = round(MESSAGES_BURST * messages_hz / MESSAGES_HZ)
        self.datagrams = Bucket(DATAGRAMS_HZ, DATAGRAMS_BURST, now_ns)
        self.messages = Bucket(messages_hz, burst, now_ns)


@dataclass(eq=False, slots=True)
class WorkerSession:
    """One session with a drone."""

    drone: str
    key: bytes = field(repr=False)
    """The drone's key when it was made."""
    way: Way
    """Of its newest authentic datagram: answers take it back."""
    welcome: bytes = field(repr=False)
    """The answer to its HELLO, given again when that is repeated."""
    quota: DroneQuota
    made_ns: int
    channel: Channel = field(init=False)
    confirmed: bool = False
    """Something sealed came in it: the drone has its keys."""
    goodbye_ns: int = 0


class Sessions:
    """All sessions of a worker; changed on one thread, looked at from any.

    Args:
        max_sessions: of all drones together.
        messages_hz: of one drone; those of 0.4 s may come at once.
    """

    def __init__(self, max_sessions: int = MAX_SESSIONS, messages_hz: float = MESSAGES_HZ) -> None:
        self._max = max_sessions
        self._messages_hz = messages_hz
        self._by_id: dict[int, WorkerSession] = {}
        self._current: dict[str, WorkerSession] = {}
        self._quotas: dict[str, DroneQuota] = {}
        self._hellos: dict[bytes, tuple[WorkerSession, int]] = {}

    def __len__(self) -> int:
        """How many there are."""
        return len(self._by_id)

    def get(self, session: int) -> WorkerSession | None:
        """A session by its id."""
        return self._by_id.get(session)

    def all(self) -> tuple[WorkerSession, ...]:
        """All of them."""
        return tuple(self._by_id.values())

    def current(self, drone: str) -> WorkerSession | None:
        """The session in which a drone was heard last."""
        return self._current.get(drone)

    def currents(self) -> tuple[WorkerSession, ...]:
        """The session of each drone in which it was heard last."""
        return tuple(self._current.values())

    def quota(self, drone: str, now_ns: int) -> DroneQuota:
        """What a drone has left; forgotten with its last session."""
        return self._quotas.setdefault(drone, DroneQuota(now_ns, self._messages_hz))

    def of_hello(self, hello: bytes) -> tuple[bool, WorkerSession | None]:
        """Whether a HELLO was answered before, and its session unless that has ended."""
        known = self._hellos.get(hello)
        if known is None:
            return False, None
        return True, self._by_id.get(known[0].channel.session)

    def make_room(self, drone: str) -> bool:
        """Room for one more session of a drone; False: there is none.

        The drone's oldest one goes if it has its number; otherwise one that never was confirmed.
        """
        if sum(s.drone == drone for s, _ in self._hellos.values()) >= MAX_HELLOS_PER_DRONE:
            return False
        own = [s for s in self._by_id.values() if s.drone == drone]
        if len(own) >= MAX_PER_DRONE:
            self.end(min(own, key=lambda s: s.channel.heard_ns))
        if len(self._by_id) >= self._max:
            unconfirmed = [s for s in self._by_id.values() if not s.confirmed]
            victims = [s for s in own if s.channel.session in self._by_id] or unconfirmed
            if not victims:
                return False
            self.end(min(victims, key=lambda s: s.channel.heard_ns))
        return True

    def add(self, session: WorkerSession, hello: bytes) -> None:
        """A new session, and the HELLO that made it."""
        self._by_id[session.channel.session] = session
        # As long as its cookie is good, so that it makes no second session when replayed
        self._hellos[hello] = (session, session.made_ns + COOKIE_AGE_NS)

    def heard(self, session: WorkerSession) -> None:
        """A new authentic datagram came in a session."""
        session.confirmed = True
        self._current[session.drone] = session

    def end(self, session: WorkerSession) -> None:
        """Forget a session."""
        self._by_id.pop(session.channel.session, None)
        if self._current.get(session.drone) is session:
            own = [s for s in self._by_id.values() if s.drone == session.drone and s.confirmed]
            if own:
                self._current[session.drone] = max(own, key=lambda s: s.channel.heard_ns)
            else:
                del self._current[session.drone]

    def expire(self, now_ns: int) -> None:
        """End what is idle or never was confirmed, forget old HELLOs."""
        for session in self.all():
            limit_ns = IDLE_NS if session.confirmed else UNCONFIRMED_NS
            if now_ns - session.channel.heard_ns > limit_ns:
                self.end(session)
        self._hellos = {h: known for h, known in self._hellos.items() if known[1] > now_ns}
        present = {s.drone for s in self._by_id.values()}
        self._quotas = {d: q for d, q in self._quotas.items() if d in present}
