"""The client, or its service, on a clock that waits for whoever is late: ours but for the clock.

    px4_hil_clock.py FILE client ARGUMENTS     drone-client ARGUMENTS
    px4_hil_clock.py FILE service ARGUMENTS    edge-service ARGUMENTS

``drone-client fly --sim ... --hil`` lives on the machine's clock: on a machine that is too slow for
it answers and poses grow old, and the mission brakes, as it must. Here time passes as on a machine
that is never too slow: not faster than the real one, and not on while physics, pictures, answers,
poses or decisions are overdue. The client moves the clock, and the service reads it in FILE.
"""

from __future__ import annotations

import mmap
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final

real_now_ns = time.monotonic_ns
BYTES: Final = 8
START_NS: Final = 1_000_000_000_000
STEP_NS: Final = 8_000_000
"""Time passes in steps of so much at most: the whole process may have been put aside."""
PATIENCE_NS: Final = 5_000_000_000
"""Real time; who is overdue for longer is not waited for: it has ended, or will not come."""
SHORTEST_S: Final = 0.001
LONGEST_S: Final = 0.02
"""Real time from one look at the clock to the next, of who waits."""
AHEAD_NS: Final = {
    "physics": 12_000_000,
    "pose": 80_000_000,
    "decision": 40_000_000,
    "picture": 85_000_000,
    "answer": 130_000_000,
}
"""How far the clock may run ahead of the newest, or oldest open, of each kind."""


class SharedTime:
    """A number in a file that two processes see."""

    def __init__(self, path: Path) -> None:
        with path.open("r+b") as file:
            self._memory = mmap.mmap(file.fileno(), BYTES)
        self._numbers = memoryview(self._memory).cast("q")

    @staticmethod
    def create(path: Path) -> None:
        path.write_bytes(START_NS.to_bytes(BYTES, sys.byteorder))

    def now_ns(self) -> int:
        return int(self._numbers[0])

    def set(self, now_ns: int) -> None:
        self._numbers[0] = now_ns


class WaitingClock:
    """Stands still while somebody is overdue; from any thread."""

    def __init__(self, shared: SharedTime) -> None:
        self._shared = shared
        self._lock = threading.Lock()
        self._real_ns = self._moved_ns = real_now_ns()
        self._marks: dict[tuple[str, int], int] = {}
        self._over = False

    def now_ns(self) -> int:
        with self._lock:
            real_ns = real_now_ns()
            step_ns = min(real_ns - self._real_ns, STEP_NS)
            self._real_ns = real_ns
            now_ns = self._shared.now_ns()
            limits = {key: t_ns + AHEAD_NS[key[0]] for key, t_ns in self._marks.items()}
            to_ns = min(now_ns + step_ns, *limits.values()) if limits else now_ns + step_ns
            if to_ns > now_ns:
                self._moved_ns = real_ns
                self._shared.set(to_ns)
                return to_ns
            if real_ns - self._moved_ns > PATIENCE_NS:
                for key, limit_ns in limits.items():
                    if limit_ns <= now_ns:
                        del self._marks[key]
            return now_ns

    def mark(self, kind: str, t_ns: int, number: int = 0) -> None:
        """Something of this kind is done up to a time, or begun then and now open."""
        with self._lock:
            if not self._over:
                self._marks[kind, number] = t_ns

    def wait_no_more(self) -> None:
        """For nobody: the flight is over, and the threads end one after the other."""
        with self._lock:
            self._over = True
            self._marks.clear()

    def done(self, kind: str, number: int = 0) -> None:
        """It is waited for no more."""
        with self._lock:
            self._marks.pop((kind, number), None)


def paced_by(clock: WaitingClock) -> type[threading.Event]:
    """Events whose time-outs are the clock's: a loop that waits for its turn comes when it is."""

    class Paced(threading.Event):
        def wait(self, timeout: float | None = None) -> bool:
            if timeout is None:
                return super().wait()
            until_ns = clock.now_ns() + round(timeout * 1e9)
            while (left_ns := until_ns - clock.now_ns()) > 0:
                if super().wait(min(max(left_ns / 1e9, SHORTEST_S), LONGEST_S)):
                    return True
            return self.is_set()

    return Paced


def watch(clock: WaitingClock) -> None:
    """Tell the clock what the client does; nothing of what it does is changed."""
    from contact_sim.flight.camera import SimulatedCamera
    from contact_sim.flight.live import LiveSimulation
    from contact_sim.hil.outside import Outside
    from drone_client.ledger import Ledger

    def after(owner: Any, name: str, look: Callable[..., None]) -> None:
        real = getattr(owner, name)

        def wrapped(*arguments: Any, **options: Any) -> Any:
            result = real(*arguments, **options)
            look(result, *arguments)
            return result

        setattr(owner, name, wrapped)

    def on_state(state: Any) -> None:
        if state is not None and state.t_pose_ns is not None:
            clock.mark("pose", state.t_pose_ns)

    def on_outside(_: object, outside: Outside, *__: object) -> None:
        vehicle = outside.vehicle
        after(vehicle, "state", on_state)
        after(vehicle, "command", lambda _, command: clock.mark("decision", command.t_ns))

    def on_live(live: LiveSimulation, *_: object) -> None:
        on_turn = live._on_turn

        def looked(simulation: Any, now_ns: int) -> None:
            on_turn(simulation, now_ns)
            clock.mark("physics", now_ns)

        live._on_turn = looked
        after(live, "snapshot", lambda taken: clock.mark("picture", taken[0].t_ns + taken[1]))

    after(SimulatedCamera, "stop", lambda *_: clock.wait_no_more())
    after(Outside, "__init__", on_outside)
    after(Outside, "live", on_live)
    after(
        Ledger,
        "captured",
        lambda _, __, entry: clock.mark("answer", entry.t_capture_ns, entry.sequence),
    )
    after(Ledger, "close_frame", lambda _, __, sequence, *___: clock.done("answer", sequence))


def main() -> None:
    path, who, *arguments = sys.argv[1:]
    sys.argv = [who, *arguments]
    shared = SharedTime(Path(path))
    if who == "service":
        time.monotonic_ns = shared.now_ns
        from edge_service.cli import main as run
    else:
        clock = WaitingClock(shared)
        time.monotonic_ns = clock.now_ns
        threading.Event = paced_by(clock)  # type: ignore[misc]  # whoever waits, waits by it
        watch(clock)
        from drone_client.cli import main as run
    run()


if __name__ == "__main__":
    main()
