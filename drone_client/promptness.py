"""How soon a thread runs when it should: what Python and the system allow for the control loop."""

from __future__ import annotations

import os
import sys
import threading

SWITCH_INTERVAL_S = 5e-4
"""A thread that computes gives the interpreter up after so long when another waits. Python's own
5 ms would make a tick late by as much, each time that a picture is being coded."""
PRIORITY = 10
"""Of SCHED_FIFO: over everything ordinary, under the kernel's own threads."""


def yield_soon() -> None:
    """Let every thread of this process give way quickly; for the whole process."""
    sys.setswitchinterval(min(sys.getswitchinterval(), SWITCH_INTERVAL_S))


def first_in_line() -> bool:
    """Put the calling thread before all ordinary ones; False where the system forbids it.

    Needs CAP_SYS_NICE or an rtprio limit (``ulimit -r``), and Linux.
    """
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(PRIORITY))
    except (AttributeError, OSError):
        return False
    return True


def may_be_first() -> bool:
    """Whether ``first_in_line`` would be granted; tried in a thread that ends."""
    answers: list[bool] = []
    asking = threading.Thread(target=lambda: answers.append(first_in_line()))
    asking.start()
    asking.join()
    return answers == [True]
