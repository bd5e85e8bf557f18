"""The one-slot mailbox: newest wins, nothing vanishes."""

import threading

from hypothesis import given
from hypothesis import strategies as st

from drone_client.newest import Newest


@given(st.lists(st.booleans(), max_size=50))
def test_each_item_is_taken_or_displaced_exactly_once(is_put):
    """Any order of puts and takes: the newest is taken, each other comes back to who put."""
    slot: Newest[int] = Newest()
    inside: int | None = None
    for number, put in enumerate(is_put):
        if put:
            assert slot.put(number) == inside
            inside = number
        else:
            assert slot.take(timeout_s=0) == inside
            inside = None


def produce(slot: Newest[tuple[int, int]], thread: int, displaced: list[tuple[int, int]]) -> None:
    for number in range(500):
        if (loser := slot.put((thread, number))) is not None:
            displaced.append(loser)


def consume(slot: Newest[tuple[int, int]], taken: list[tuple[int, int]]) -> None:
    while (item := slot.take(timeout_s=10)) is not None:
        taken.append(item)


def test_across_threads_each_item_is_taken_or_displaced_exactly_once():
    """Four threads put, two take; the sum of what was taken and displaced is what was put."""
    slot: Newest[tuple[int, int]] = Newest()
    displaced: list[tuple[int, int]] = []
    taken: list[list[tuple[int, int]]] = [[], []]
    producers = [threading.Thread(target=produce, args=(slot, i, displaced)) for i in range(4)]
    consumers = [threading.Thread(target=consume, args=(slot, mine)) for mine in taken]
    for thread in [*consumers, *producers]:
        thread.start()
    for thread in producers:
        thread.join(10)
    slot.close()
    for thread in consumers:
        thread.join(10)
    every = sorted((i, n) for i in range(4) for n in range(500))
    assert sorted([*displaced, *taken[0], *taken[1]]) == every
    for mine in taken:
        for i in range(4):
            numbers = [n for thread, n in mine if thread == i]
            assert numbers == sorted(numbers)  # never an older one after a newer one


def test_closing_wakes_whoever_waits():
    """A take without a time limit worth speaking of ends when the slot is closed."""
    slot: Newest[int] = Newest()
    got: list[int | None] = []
    thread = threading.Thread(target=lambda: got.append(slot.take(timeout_s=60)), daemon=True)
    thread.start()
    slot.close()
    thread.join(10)
    assert got == [None]


def test_what_is_in_a_closed_slot_can_still_be_taken():
    """Closing loses nothing."""
    slot: Newest[str] = Newest()
    slot.put("last")
    slot.close()
    assert slot.take(timeout_s=0) == "last"
    assert slot.take(timeout_s=60) is None
