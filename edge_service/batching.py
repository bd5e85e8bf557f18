"""Which frames go through the detector together, and how long the first waits for more.

A batch is begun so early that by all that is expected it is answered before the tightest budget in
it is over. Nobody is let in who would break that, and nobody waits for it to be broken.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeAlias, TypeVar

T = TypeVar("T")


@dataclass(frozen=True, slots=True)
class BatchLimits:
    """How many frames go together at most, and how long the first one waits for the others."""

    max_size: int
    wait_ns: int


TakeMore: TypeAlias = Callable[[int, Callable[[T], bool]], T | None]
"""Gives one more frame that the condition takes, waiting for it at most so long [ns]; None: none
came, or none will."""


def wait_for_more_ns(tightest_ns: int, expected_ns: int, give_up_ns: int, now_ns: int) -> int:
    """How long a batch may wait for one more frame; below 0: it has no time even for one at hand.

    Args:
        tightest_ns: when the first budget in the batch is over.
        expected_ns: what the batch would take with one frame more.
        give_up_ns: when it has waited long enough.
        now_ns: now; all of the worker's clock.
    """
    slack_ns = tightest_ns - expected_ns - now_ns
    return min(slack_ns, max(0, give_up_ns - now_ns))


def gather(
    first: T,
    take_more: TakeMore[T],
    deadline_ns: Callable[[T], int],
    expected_ns: Callable[[int], int],
    limits: BatchLimits,
    now_ns: Callable[[], int],
) -> list[T]:
    """A batch that begins with ``first``.

    Args:
        first: whose turn it is.
        take_more: gives further ones in their turns.
        deadline_ns: when a frame's budget is over, worker's clock.
        expected_ns: what a batch of that size would take; never falls with the size.
        limits: of size and time.
        now_ns: the worker's clock.
    """
    batch = [first]
    tightest_ns = deadline_ns(first)
    give_up_ns = now_ns() + limits.wait_ns
    while len(batch) < limits.max_size:
        larger_ns = expected_ns(len(batch) + 1)
        wait_ns = wait_for_more_ns(tightest_ns, larger_ns, give_up_ns, now_ns())
        if wait_ns < 0:
            break

        # Both are looked at again: the wait may have lasted longer than it was meant to
        def accept(item: T, done_in_ns: int = larger_ns, due_ns: int = tightest_ns) -> bool:
            return now_ns() + done_in_ns <= min(due_ns, deadline_ns(item))

        another = take_more(wait_ns, accept)
        if another is None:
            break
        batch.append(another)
        tightest_ns = min(tightest_ns, deadline_ns(another))
    return batch
