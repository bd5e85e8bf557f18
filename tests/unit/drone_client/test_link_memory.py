"""The link without a network."""

from drone_client.link.memory import MemoryLink
from rgbd_wire.clock import ManualClock


def test_delivers_each_answer_at_once_with_the_time_of_its_arrival():
    """Both answers of a frame, in order, stamped by the drone's clock."""
    clock = ManualClock(5)
    link = MemoryLink(clock, lambda worker, frame: (worker.encode(), frame[::-1]))
    got: list[tuple[bytes, int]] = []
    link.start(lambda message, t4_ns: got.append((message, t4_ns)), lambda: None)
    link.send("w1", b"abc", 0)
    clock.advance(3)
    link.send("w2", b"de", 0)
    assert got == [(b"w1", 5), (b"cba", 5), (b"w2", 8), (b"ed", 8)]


def test_is_silent_before_it_starts_and_after_it_closes():
    """Nobody listens: answers vanish."""
    got: list[bytes] = []
    link = MemoryLink(ManualClock(), lambda worker, frame: (frame,), workers=("a", "b"))
    link.send("a", b"early", 0)
    link.start(lambda message, t4_ns: got.append(message), lambda: None)
    link.close()
    link.send("a", b"late", 0)
    assert got == []
    assert link.workers() == ("a", "b")
