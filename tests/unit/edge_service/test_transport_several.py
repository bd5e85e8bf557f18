"""Several transports as one: heard on all, answered where the drone is, closed to the last."""

from __future__ import annotations

import pytest

from edge_service.errors import AddressError
from edge_service.transport import several
from edge_service.transport.memory import MemoryTransport
from edge_service.transport.several import SeveralTransports
from rgbd_wire.messages import Ack, Status, seal_ack, seal_status

ACK = seal_ack(Ack("d1", 1, 2, "w1", 3))
STATUS = seal_status(Status("w1", 3, 1, 0, 0, 64, 0, 0, "m", draining=False))


@pytest.fixture
def both():
    """Two transports, and the one made of them, open and started."""
    parts = MemoryTransport(), MemoryTransport()
    whole = SeveralTransports(parts)
    whole.open()
    whole.heard = []
    whole.start(lambda *message: whole.heard.append(message))
    return whole, *parts


def test_a_drone_is_answered_where_it_was_last_heard(both):
    """On the first network, then on the second one: never on the one that it has left."""
    whole, one, two = both
    one.deliver("d1", b"a", 5)
    assert whole.send("d1", ACK)
    two.deliver("d1", b"b", 6)
    assert whole.send("d1", ACK)
    assert whole.send("d1", ACK)
    assert whole.heard == [("d1", b"a", 5), ("d1", b"b", 6)]
    assert (len(one.sent), len(two.sent)) == (1, 2)


def test_who_was_never_heard_is_sent_to_on_all(both):
    """One of the networks may know the drone; nobody else takes what is for it."""
    whole, one, two = both
    assert whole.send("d9", ACK)
    assert (len(one.sent), len(two.sent)) == (1, 1)
    two.close()
    assert whole.send("d9", ACK)
    one.close()
    assert not whole.send("d9", ACK)


def test_a_message_of_nobody_is_passed_on():
    """It is no drone's, so no network is remembered for it."""
    part = MemoryTransport()
    whole, heard = SeveralTransports([part]), []
    whole.open()
    whole.start(lambda *message: heard.append(message))
    part.deliver(None, b"", 5)
    assert heard == [(None, b"", 5)]
    assert not whole._heard


def test_an_answer_that_its_network_does_not_take_is_not_sent(both):
    """It is not sent elsewhere: the drone is not there."""
    whole, one, two = both
    one.deliver("d1", b"a", 5)
    one.close()
    assert not whole.send("d1", ACK)
    assert two.sent == []


def test_announcements_and_statuses_go_everywhere(both):
    """Up, down and how it is: on every network."""
    whole, one, two = both
    whole.announce()
    whole.publish(STATUS)
    assert one.announced
    assert two.announced
    assert len(one.published) == len(two.published) == 1
    whole.withdraw()
    assert not one.announced
    assert not two.announced


def test_it_is_open_while_all_are(both):
    """A worker that has lost one of its networks is not ready."""
    whole, one, two = both
    assert whole.is_open
    two.is_open = False
    assert not whole.is_open
    whole.close()
    assert not one.is_open


class Broken(MemoryTransport):
    """Neither opens nor closes."""

    def open(self):
        raise AddressError("taken")

    def close(self):
        raise RuntimeError("stuck")


def test_what_cannot_be_opened_leaves_none_open():
    """The error goes up, and the ports that were opened before it are free again."""
    first = MemoryTransport()
    with pytest.raises(AddressError, match="taken"):
        SeveralTransports([first, Broken()]).open()
    assert not first.is_open


def test_all_are_closed_whatever_becomes_of_one():
    """An error while closing keeps none of the others open."""
    one, two = MemoryTransport(), MemoryTransport()
    for transport in (one, two):
        transport.open()
    with pytest.raises(RuntimeError, match="stuck"):
        SeveralTransports([one, Broken(), two]).close()
    assert not one.is_open
    assert not two.is_open


def test_memory_is_bounded_whatever_names_come(both, monkeypatch):
    """Names past the bound push out the oldest, who is then answered on all networks."""
    monkeypatch.setattr(several, "MAX_DRONES", 3)
    whole, one, two = both
    for n in range(5):
        one.deliver(f"d{n}", b"", 0)
    for n in range(5):
        assert whole.send(f"d{n}", ACK)
    assert [drone for drone, _ in two.sent] == ["d0", "d1"]
