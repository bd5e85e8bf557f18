"""All areas at once, each on a thread of its own: one that fails or hangs is a line, no end.

What is looked at may be broken in ways that nobody foresaw: a driver that raises its own errors, a
peer that answers a byte a second. The others are told all the same, and the command ends.
"""

from __future__ import annotations

import logging
import queue
import threading
import time
from collections.abc import Callable, Mapping, Sequence

from drone_client.doctor.finding import Check, Finding, judged
from drone_client.errors import ClientError
from rgbd_wire.errors import WireError
from target_pose.errors import TargetError

logger = logging.getLogger(__name__)
LOOK_S = 0.2
"""How often it is shown what is still looked at."""
Look = Callable[[], Sequence[Check]]


def look_at(
    areas: Mapping[str, tuple[Look, float]],
    on_wait: Callable[[Sequence[str]], None] = lambda names: None,
) -> list[Check]:
    """The checks of all areas, in the order of the areas.

    Args:
        areas: by name: what looks at it, and for how long it may [s].
        on_wait: is told some times a second what is still looked at.
    """
    done: queue.SimpleQueue[tuple[str, Sequence[Check]]] = queue.SimpleQueue()
    start_s = time.monotonic()
    for name, (look, _) in areas.items():
        # Daemons: one that hangs for ever must not keep the command from its end
        threading.Thread(
            target=_run, args=(name, look, done), name=f"doctor {name}", daemon=True
        ).start()
    found: dict[str, Sequence[Check]] = {}
    while len(found) < len(areas):
        on_wait([name for name in areas if name not in found])
        now_s = time.monotonic() - start_s
        left_s = min(limit_s - now_s for name, (_, limit_s) in areas.items() if name not in found)
        try:
            name, checks = done.get(timeout=max(0.0, min(left_s, LOOK_S)))
            found.setdefault(name, checks)
        except queue.Empty:
            now_s = time.monotonic() - start_s
            for name, (_, limit_s) in areas.items():
                if name not in found and now_s >= limit_s:
                    found[name] = [_hangs(name, limit_s)]
    return [check for name in areas for check in found[name]]


def _run(name: str, look: Look, done: queue.SimpleQueue[tuple[str, Sequence[Check]]]) -> None:
    checks: Sequence[Check] = ()
    try:
        checks = look()
    except (ClientError, WireError, TargetError) as error:
        checks = [_fault(name, _one_line(error), "correct it as it says")]
    except (Exception, SystemExit) as error:
        # The area's boundary: the others are told all the same
        logger.exception("looking at the %s failed", name)
        checks = [
            _fault(
                name,
                f"{type(error).__name__}: {_one_line(error) or 'no words'}",
                "nobody foresaw this: the traceback above says where; is a driver or a library of "
                "another version?",
            )
        ]
    finally:
        done.put((name, checks))


def _hangs(name: str, limit_s: float) -> Check:
    return _fault(
        name,
        f"no end within {limit_s:g} s",
        "something there neither answers nor refuses: look at cable, driver and peer, or give it "
        "longer with --limit-s",
    )


def _fault(name: str, found: str, advice: str) -> Check:
    return judged(name, name, Finding.FAULT, found, advice)


def _one_line(error: BaseException) -> str:
    return " ".join(str(error).split())
