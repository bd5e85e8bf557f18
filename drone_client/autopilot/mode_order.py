"""The order into the mode that takes commands, and out of it. Pure: time is an argument.

::

                engage()             warm, heartbeat fresh           in the mode
    SILENT ───────────────→ WARMING ───────────────────────→ ASKING ────────────→ ENGAGED
      ↑                        │                               │                     │ release()
      │  released, refused,    │                               │  pilot, disarmed,   ↓
      └── pilot's switch ──────┴───────────────────────────────┴──no heartbeat──── LEAVING

PX4 takes OFFBOARD only from who has been sending setpoints for a while, so the setpoints come first
and the question after them. Whoever else changes the mode is obeyed at once: silence, and no other
question until a person calls ``engage`` again.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

NS_PER_MS = 1_000_000


class Phase(StrEnum):
    """Where in the order we are."""

    SILENT = "silent"
    """Nothing is sent but heartbeats and what the estimator is given."""
    WARMING = "warming"
    """Zero velocities flow; the mode is not asked for yet."""
    ASKING = "asking"
    ENGAGED = "engaged"
    """The commands are flown."""
    LEAVING = "leaving"
    """Zero velocities flow, and the mode that holds the position is asked for, if the vehicle is
    in the one that was taken: a question that is still under way may take it yet."""


class Flow(StrEnum):
    """Which setpoints flow."""

    NOTHING = "nothing"
    ZERO = "zero"
    COMMANDS = "commands"


class Ask(StrEnum):
    """Which mode is asked for."""

    TAKE = "take"
    """The one that takes commands."""
    HOLD = "hold"


class Answer(StrEnum):
    """What the autopilot said to a question for a mode."""

    ACCEPTED = "accepted"
    LATER = "later"
    """Not now, or it failed: ask again."""
    NEVER = "never"
    """It does not know such a thing."""


@dataclass(frozen=True, slots=True)
class OrderSettings:
    """Times and counts.

    Raises:
        ValueError: a value is out of its bounds.
    """

    warm_ms: float = 1200.0
    """Setpoints flow for so long before the mode is asked for; PX4 wants more than 1000 ms."""
    retry_ms: float = 500.0
    """Between two questions at least."""
    ask_within_ms: float = 100.0
    """A question follows a heartbeat that says the mode from before, no later than this: what a
    pilot has done since that heartbeat, a question would undo."""
    accepted_ms: float = 2500.0
    """After a question was accepted nothing is asked any more; so long the mode may take."""
    tries: int = 6
    """Questions at most, in each direction."""
    heartbeat_lost_ms: float = 3000.0
    """Without a heartbeat for so long the autopilot counts as gone. It sends one a second."""
    wait_ms: float = 10_000.0
    """How long ``engage`` waits for a first heartbeat."""

    def __post_init__(self) -> None:
        for name, low, high in (
            ("warm_ms", 1000.0, 10_000.0),
            ("retry_ms", 100.0, 5000.0),
            ("ask_within_ms", 40.0, 500.0),
            ("accepted_ms", 1000.0, 10_000.0),
            ("tries", 1, 20),
            ("heartbeat_lost_ms", 1500.0, 10_000.0),
            ("wait_ms", 1000.0, 60_000.0),
        ):
            value = getattr(self, name)
            if not low <= value <= high:
                raise ValueError(f"OrderSettings.{name} = {value} is not in [{low:g}, {high:g}]")


@dataclass(frozen=True, slots=True)
class Heard:
    """What the last heartbeat said."""

    t_ns: int
    """Drone's clock."""
    mode: str
    armed: bool


@dataclass(frozen=True, slots=True)
class Step:
    """What to do in one tick."""

    flow: Flow
    ask: Ask | None = None


class ModeOrder:
    """The order; one per vehicle. Not thread-safe."""

    def __init__(self, taking_mode: str, settings: OrderSettings) -> None:
        """Begin in silence.

        Args:
            taking_mode: name of the mode that takes commands.
            settings: times and counts.
        """
        self.phase = Phase.SILENT
        self.reason = "not engaged"
        """Why it is silent, in words, or what it waits for."""
        self.engaged_ns: int | None = None
        """When the mode was entered last, drone's clock."""
        self._mode = taking_mode
        self._settings = settings
        self._heard: Heard | None = None
        self._since_ns = 0
        self._asked_ns: int | None = None
        self._asked = 0
        self._mode_before: str | None = None
        self._was_armed = False
        self._never = False
        self._accepted_ns: int | None = None

    def engage(self, now_ns: int) -> None:
        """A person wants the vehicle to fly our commands."""
        if self.phase in (Phase.SILENT, Phase.LEAVING):
            self._enter(Phase.WARMING, now_ns, "setpoints flow before the mode is asked for")

    def release(self, now_ns: int) -> None:
        """Give the vehicle back."""
        if self.phase in (Phase.SILENT, Phase.LEAVING):
            return
        took = self._heard is not None and self._heard.mode == self._mode
        if took or (self.phase is Phase.ASKING and self._asked):
            self._enter(Phase.LEAVING, now_ns, "gives the vehicle back")
        else:
            self._enter(Phase.SILENT, now_ns, "released")

    def heard(self, heard: Heard) -> None:
        """Take a heartbeat; a switch that was not ours ends everything here and now."""
        before, self._heard = self._heard, heard
        in_mode = heard.mode == self._mode
        match self.phase:
            case Phase.WARMING if not in_mode and before is not None and heard.mode != before.mode:
                self._enter(Phase.SILENT, heard.t_ns, f"the pilot switched to {heard.mode}")
            case Phase.ASKING if in_mode:
                self.engaged_ns = heard.t_ns
                self._was_armed = heard.armed
                self._enter(Phase.ENGAGED, heard.t_ns, "")
            case Phase.ASKING if not in_mode and heard.mode != self._mode_before:
                self._enter(Phase.SILENT, heard.t_ns, f"the pilot switched to {heard.mode}")
            case Phase.ENGAGED if not in_mode:
                self._enter(Phase.SILENT, heard.t_ns, f"the mode was changed to {heard.mode}")
            case Phase.ENGAGED if self._was_armed and not heard.armed:
                self._enter(Phase.SILENT, heard.t_ns, "disarmed")
            case Phase.ENGAGED:
                self._was_armed = heard.armed
            case Phase.LEAVING if not in_mode and before is not None and heard.mode != before.mode:
                self._enter(Phase.SILENT, heard.t_ns, f"released: {heard.mode}")
            case _:
                pass

    def give_up(self, now_ns: int, reason: str) -> None:
        """What should fly the vehicle is gone: silence, and its failsafe acts."""
        if self.phase is Phase.ENGAGED:
            self._enter(Phase.SILENT, now_ns, reason)

    def answered(self, answer: Answer, now_ns: int) -> None:
        """Take the answer to the last question."""
        if self.phase not in (Phase.ASKING, Phase.LEAVING) or not self._asked:
            return
        match answer:
            case Answer.ACCEPTED:
                self._accepted_ns = now_ns
            case Answer.NEVER:
                self._never = True
            case Answer.LATER:
                self.reason = "the autopilot refuses for now; asks again"

    def step(self, now_ns: int) -> Step:
        """What to do now; to be called in each tick."""
        match self.phase:
            case Phase.WARMING:
                return self._warm(now_ns)
            case Phase.ASKING:
                return self._ask_to_take(now_ns)
            case Phase.ENGAGED:
                if not self._fresh(now_ns):
                    return self._fall_silent(now_ns, "no heartbeat of the autopilot")
                return Step(Flow.COMMANDS)
            case Phase.LEAVING:
                return self._ask_to_hold(now_ns)
            case _:
                return Step(Flow.NOTHING)

    def _warm(self, now_ns: int) -> Step:
        waited_ns = now_ns - self._since_ns
        if not self._fresh(now_ns):
            if waited_ns > self._settings.wait_ms * NS_PER_MS:
                return self._fall_silent(now_ns, "no heartbeat of the autopilot")
            return Step(Flow.ZERO)
        if waited_ns < self._settings.warm_ms * NS_PER_MS:
            return Step(Flow.ZERO)
        assert self._heard is not None
        self._mode_before = self._heard.mode
        self._enter(Phase.ASKING, now_ns, f"asks for {self._mode}")
        return Step(Flow.ZERO)

    def _ask_to_take(self, now_ns: int) -> Step:
        if self._never:
            return self._fall_silent(now_ns, f"the autopilot does not take {self._mode}")
        if not self._fresh(now_ns):
            return self._fall_silent(now_ns, "no heartbeat of the autopilot")
        if self._overdue(now_ns):
            return self._fall_silent(now_ns, f"{self._mode} was accepted, but did not last")
        if not self._may_ask(now_ns):
            return Step(Flow.ZERO)
        if self._asked == self._settings.tries:
            return self._fall_silent(now_ns, f"{self._mode} was refused {self._asked} times")
        return Step(Flow.ZERO, self._question(Ask.TAKE, now_ns))

    def _ask_to_hold(self, now_ns: int) -> Step:
        heard = self._heard
        if heard is not None and heard.mode != self._mode:
            # Never ours, or not any more: whatever it flies is somebody else's, and is not asked
            # to hold. What was asked for before has been answered by now
            if heard.t_ns - self._since_ns >= self._settings.retry_ms * NS_PER_MS:
                return self._fall_silent(now_ns, "released")
            if not self._fresh(now_ns):
                return self._fall_silent(now_ns, "no heartbeat of the autopilot")
            return Step(Flow.ZERO)
        if self._overdue(now_ns) or not self._fresh(now_ns):
            return self._fall_silent(now_ns, "no answer to hold: left to the autopilot's failsafe")
        if not self._may_ask(now_ns):
            return Step(Flow.ZERO)
        if self._never or self._asked == self._settings.tries:
            return self._fall_silent(now_ns, "no answer to hold: left to the autopilot's failsafe")
        return Step(Flow.ZERO, self._question(Ask.HOLD, now_ns))

    def _may_ask(self, now_ns: int) -> bool:
        """Right after a heartbeat of this phase: later, a pilot may have switched meanwhile."""
        heard = self._heard
        if heard is None or heard.t_ns < self._since_ns or self._accepted_ns is not None:
            return False
        if now_ns - heard.t_ns > self._settings.ask_within_ms * NS_PER_MS:
            return False
        if self._asked_ns is None:
            return True
        retry_ns = self._settings.retry_ms * NS_PER_MS
        return now_ns - self._asked_ns >= retry_ns and heard.t_ns > self._asked_ns

    def _overdue(self, now_ns: int) -> bool:
        accepted_ns = self._accepted_ns
        limit_ns = self._settings.accepted_ms * NS_PER_MS
        return accepted_ns is not None and now_ns - accepted_ns > limit_ns

    def _question(self, ask: Ask, now_ns: int) -> Ask:
        self._asked += 1
        self._asked_ns = now_ns
        return ask

    def _fresh(self, now_ns: int) -> bool:
        lost_ns = self._settings.heartbeat_lost_ms * NS_PER_MS
        return self._heard is not None and now_ns - self._heard.t_ns <= lost_ns

    def _fall_silent(self, now_ns: int, reason: str) -> Step:
        self._enter(Phase.SILENT, now_ns, reason)
        return Step(Flow.NOTHING)

    def _enter(self, phase: Phase, now_ns: int, reason: str) -> None:
        self.phase = phase
        self.reason = reason
        self._since_ns = now_ns
        self._asked_ns = None
        self._asked = 0
        self._never = False
        self._accepted_ns = None
