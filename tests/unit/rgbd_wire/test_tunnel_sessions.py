"""The worker's table of sessions: room, replays, quotas, ends."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from rgbd_wire.tunnel.channel import Channel, Side
from rgbd_wire.tunnel.datagrams import Way
from rgbd_wire.tunnel.errors import Counters
from rgbd_wire.tunnel.handshake import COOKIE_AGE_NS, SessionKeys
from rgbd_wire.tunnel.seal import Cipher, DirectionKey
from rgbd_wire.tunnel.sessions import (
    IDLE_NS,
    MAX_HELLOS_PER_DRONE,
    MAX_PER_DRONE,
    UNCONFIRMED_NS,
    Sessions,
    WorkerSession,
)

KEY = DirectionKey(bytes(32), bytes(7))


def make(sessions: Sessions, drone: str, number: int, now_ns: int = 0) -> WorkerSession | None:
    """What a transport does with an authentic HELLO that is new."""
    if not sessions.make_room(drone):
        return None
    quota = sessions.quota(drone, now_ns)
    session = WorkerSession(drone, b"k", Way(("192.0.2.7", number)), b"welcome", quota, now_ns)
    keys = SessionKeys(number, Cipher.AES_256_GCM, KEY, KEY)
    session.channel = Channel(keys, Side.WORKER, len, Counters(), now_ns)
    sessions.add(session, b"hello %d" % number)
    return session


def test_the_current_session_is_where_the_drone_was_heard_last() -> None:
    """A new session counts from its first datagram, and the older one takes over when it ends."""
    sessions = Sessions()
    first, second = make(sessions, "a", 1), make(sessions, "a", 2)
    assert first is not None
    assert second is not None
    assert sessions.current("a") is None
    sessions.heard(first)
    assert sessions.current("a") is first
    sessions.heard(second)
    assert sessions.currents() == (second,)
    sessions.end(second)
    assert sessions.current("a") is first
    sessions.end(first)
    assert sessions.current("a") is None


def test_a_drone_has_few_sessions_and_the_silent_one_goes() -> None:
    """The fifth session of a drone ends the one that was not heard for longest."""
    sessions = Sessions()
    made = [make(sessions, "a", i) for i in range(MAX_PER_DRONE)]
    assert all(made)
    for i, session in enumerate(made):
        session.channel.heard_ns = 100 - i
    assert make(sessions, "a", 99)
    assert sessions.get(MAX_PER_DRONE - 1) is None
    assert len(sessions) == MAX_PER_DRONE


def test_a_full_table_takes_nobody_from_whom_it_heard() -> None:
    """Sessions in use stay; one that was never used makes room."""
    sessions = Sessions(max_sessions=2)
    used, unused = make(sessions, "a", 1), make(sessions, "b", 2)
    assert used is not None
    assert unused is not None
    sessions.heard(used)
    assert make(sessions, "c", 3) is not None
    assert sessions.get(1) is used
    assert sessions.get(2) is None
    sessions.heard(sessions.get(3))
    assert make(sessions, "d", 4) is None


def test_a_hello_is_remembered_as_long_as_its_cookie() -> None:
    """The same HELLO finds its session, or that this one has ended, until its cookie is too old."""
    sessions = Sessions()
    session = make(sessions, "a", 1)
    assert session is not None
    assert sessions.of_hello(b"hello 1") == (True, session)
    sessions.end(session)
    assert sessions.of_hello(b"hello 1") == (True, None)
    sessions.expire(COOKIE_AGE_NS)
    assert sessions.of_hello(b"hello 1") == (False, None)


def test_a_drone_makes_few_sessions_in_a_while() -> None:
    """32 HELLOs in the life of a cookie; others are not held up by it."""
    sessions = Sessions()
    made = [make(sessions, "a", i) for i in range(MAX_HELLOS_PER_DRONE + 5)]
    assert sum(session is not None for session in made) == MAX_HELLOS_PER_DRONE
    assert make(sessions, "b", 100)
    sessions.expire(COOKIE_AGE_NS)
    assert make(sessions, "a", 101)


@pytest.mark.parametrize(("confirmed", "limit_ns"), [(True, IDLE_NS), (False, UNCONFIRMED_NS)])
def test_silence_ends_a_session(confirmed: bool, limit_ns: int) -> None:
    """10 s after the last sign of life; 5 s after the welcome if there was none."""
    sessions = Sessions()
    session = make(sessions, "a", 1)
    assert session is not None
    if confirmed:
        sessions.heard(session)
    sessions.expire(limit_ns)
    assert len(sessions) == 1
    sessions.expire(limit_ns + 1)
    assert len(sessions) == 0
    assert sessions.current("a") is None


def test_the_quota_is_the_drones_over_all_of_its_sessions() -> None:
    """A second session brings no second quota."""
    sessions = Sessions()
    first, second, other = (make(sessions, d, i) for i, d in enumerate(["a", "a", "b"]))
    assert first.quota is second.quota
    assert first.quota is not other.quota


@given(st.lists(st.tuples(st.sampled_from("abcdef"), st.booleans(), st.integers(0, 10**10))))
def test_no_sequence_of_hellos_grows_the_table(steps: list[tuple[str, bool, int]]) -> None:
    """Whatever comes: bounded sessions, bounded by drone, and the current one is in the table."""
    sessions, now_ns = Sessions(max_sessions=8), 0
    for number, (drone, heard, step_ns) in enumerate(steps):
        now_ns += step_ns
        session = make(sessions, drone, number, now_ns)
        if session is not None and heard:
            sessions.heard(session)
        assert len(sessions) <= 8
        for name in "abcdef":
            own = [s for s in sessions.all() if s.drone == name]
            assert len(own) <= MAX_PER_DRONE
            current = sessions.current(name)
            assert current is None or current in own
        if number % 7 == 0:
            sessions.expire(now_ns)
    sessions.expire(now_ns + IDLE_NS + COOKIE_AGE_NS + 1)
    assert len(sessions) == 0
    assert not sessions._hellos
    assert not sessions._quotas
