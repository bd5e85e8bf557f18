"""Question and answer: no step of simulated time before PX4 has answered the last one.

A question is a HIL_SENSOR (with what else is due before it), its answer the HIL_ACTUATOR_CONTROLS
with the same stamp: PX4's clock is the stamp of the newest HIL_SENSOR. While PX4 boots it answers
nothing, and disarmed it need not answer everything, but waits for time to pass: then the clock goes
on without an answer, as fast as a real one. Armed it answers each; one that is missing is waited
for, then counted and left behind, and after a while of silence the flight is over. An answer that
comes after its time was up is flown until there is a better one.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from typing import Final, Protocol

from contact_sim.errors import HilError
from contact_sim.hil.motors import Controls
from contact_sim.hil.reader import Reader, Word
from drone_client.bounds import check_bounds
from rgbd_wire.clock import Clock

MAX_ANSWER_BYTES: Final = 262_144
"""That come while one answer is waited for; a PX4 sends a hundred."""

_BOUNDS: dict[str, tuple[float, float]] = {
    "first_s": (0.0, 600.0),
    "idle_s": (0.0, 600.0),
    "armed_s": (0.001, 600.0),
    "hung_s": (0.01, 3600.0),
    "boot_s": (0.01, 3600.0),
}


@dataclass(frozen=True, slots=True)
class Patience:
    """How long is waited; all of it on the machine's clock.

    Raises:
        ValueError: a value is out of its bounds.
    """

    first_s: float = 1.0
    """For the very first answer: who is up already is in lockstep from the first step on."""
    idle_s: float = 0.004
    """For an answer of who boots, or is disarmed: as long as the step itself."""
    armed_s: float = 1.0
    """For an answer of who flies."""
    hung_s: float = 10.0
    """Who flies and says nothing for so long is lost."""
    boot_s: float = 120.0
    """Who boots, or is disarmed, and says nothing for so long is lost."""

    def __post_init__(self) -> None:
        check_bounds(self, _BOUNDS)


class ByteLine(Protocol):
    """Both directions; see ``Line``."""

    def send(self, data: bytes) -> None:
        """Send all of it."""
        ...

    def receive(self, timeout_s: float) -> bytes:
        """What came; empty: nothing within the time."""
        ...


class Lockstep:
    """The exchange with one peer."""

    def __init__(self, line: ByteLine, patience: Patience, clock: Clock) -> None:
        self.counts: Counter[str] = Counter()
        """``asked``, ``answered``, ``unanswered``; controls that were no answer by their stamp:
        ``late`` (to an earlier question), ``stale`` (older than what is flown), ``ahead`` (to one
        that is yet to come), ``again`` (a second one)."""
        self.reader = Reader()
        self.newest: Controls | None = None
        """What is flown: the newest answer."""
        self.wishes: list[Word] = []
        """What else was said since the last question."""
        self._line = line
        self._patience = patience
        self._clock = clock
        self._heard_ns = clock.now_ns()

    @property
    def armed(self) -> bool:
        """Whether its newest answer says so."""
        return self.newest is not None and self.newest.armed

    def ask(self, t_us: int, data: bytes) -> Controls | None:
        """Send a question and wait for its answer, or not, and say what is flown from now on.

        None: PX4 has not said anything yet.

        Args:
            t_us: stamp of the HIL_SENSOR in it.
            data: the question.

        Raises:
            PeerGoneError: the peer went.
            HilError: it hangs, floods, speaks no MAVLink, or is not in lockstep.
        """
        self.wishes = []
        self._line.send(data)
        self.counts["asked"] += 1
        begun_ns = self._clock.now_ns()
        until_ns = begun_ns + round(self._patience_s() * 1e9)
        answer, size = None, 0
        while answer is None:
            left_ns = until_ns - self._clock.now_ns()
            received = self._line.receive(max(0, left_ns) / 1e9)
            size += len(received)
            if size > MAX_ANSWER_BYTES:
                raise HilError(f"over {MAX_ANSWER_BYTES} bytes came in place of one answer")
            answer = self._answer(t_us, received)
            if answer is None and not received and left_ns <= 0:
                break
            if answer is None and left_ns <= -round(self._patience.armed_s * 1e9):
                break  # it talks and talks, but does not answer
        return self._judged(answer)

    def _patience_s(self) -> float:
        s = self._patience
        if self.armed:
            return s.armed_s
        return s.first_s if self.counts["asked"] == 1 else s.idle_s

    def _answer(self, t_us: int, received: bytes) -> Controls | None:
        """The first answer to this question in what came."""
        answer = None
        for word in self.reader.take(received):
            if not isinstance(word, Controls):
                self.wishes.append(word)
            elif not word.lockstep:
                raise HilError(
                    "this PX4 was built without lockstep; build it as usual: make px4_sitl"
                )
            elif word.t_us < t_us:
                self._take_late(word)
            elif word.t_us > t_us:
                self.counts["ahead"] += 1
            elif answer is not None:
                self.counts["again"] += 1
            else:
                answer = word
        return answer

    def _take_late(self, word: Controls) -> None:
        if self.newest is not None and word.t_us <= self.newest.t_us:
            self.counts["stale"] += 1
        else:
            self.counts["late"] += 1
            self.newest, self._heard_ns = word, self._clock.now_ns()

    def _judged(self, answer: Controls | None) -> Controls | None:
        """What is flown from now on."""
        now_ns = self._clock.now_ns()
        if answer is not None:
            self.counts["answered"] += 1
            self.newest, self._heard_ns = answer, now_ns
            return answer
        self.counts["unanswered"] += 1
        silent_s = (now_ns - self._heard_ns) / 1e9
        s = self._patience
        if silent_s >= (s.hung_s if self.armed else s.boot_s):
            raise HilError(self._silence(silent_s))
        return self.newest

    def _silence(self, silent_s: float) -> str:
        counts = self.counts
        if counts["ahead"] or counts["stale"]:
            why = (
                f"{counts['stale']} controls carried old stamps and {counts['ahead']} stamps that "
                "are yet to come: PX4's clock is not the simulated one"
            )
        elif self.newest is None:
            why = (
                "it never sent HIL_ACTUATOR_CONTROLS: does its airframe give motors to outputs "
                "(PWM_MAIN_FUNC1 to 4 = 101 to 104), as none_iris does?"
            )
        elif self.armed:
            why = "it flew until then: has it crashed, or does a debugger hold it?"
        else:
            why = "it was disarmed: does it still run?"
        return f"no answer to HIL_SENSOR for {silent_s:.1f} s; {why}"
