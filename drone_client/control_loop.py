"""The thread that flies: at ``control_hz`` it looks at what is known, decides, and commands.

Whatever happens elsewhere, it goes on: it waits for no disk and no network, and an error in a tick
is a tick that commands to stand still.
"""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from drone_client.airframe import Airframe
from drone_client.autopilot import Autopilot
from drone_client.control import ControlSettings, Decision, OnMission, decide, stop_command
from drone_client.ledger import Ledger
from drone_client.mission import MissionState, Senses
from drone_client.promptness import first_in_line
from drone_client.records import decision_record
from drone_client.tally import Tally
from drone_client.target import TargetEstimate
from rgbd_wire.clock import Clock
from rgbd_wire.geometry import Pose

logger = logging.getLogger(__name__)
BEHIND_PERIODS = 5
"""A loop that has fallen behind by more does not catch up with a burst of ticks."""
JOIN_S = 5.0


@dataclass(frozen=True, slots=True)
class Knowledge:
    """What the loop asks for at each tick; every one answers at once, from memory."""

    estimate: Callable[[int], TargetEstimate | None]
    """Of the target, to fly by now; None: never seen."""
    world_from_body: Callable[[int], Pose | None]
    """Where the drone is now; None: it does not know."""
    senses: Callable[[int], Senses] = lambda now_ns: Senses()
    """What there is to notice beside the target; asked only on a mission."""


class ControlLoop:
    """Owns the control thread and the mission's state."""

    def __init__(
        self,
        settings: ControlSettings,
        airframe: Airframe,
        autopilot: Autopilot,
        knowledge: Knowledge,
        clock: Clock,
        ledger: Ledger,
        tally: Tally,
        *,
        reply_timeout_ns: int,
        mission: MissionState | None = None,
        on_decision: Callable[[Decision], None] = lambda decision: None,
    ) -> None:
        self.prompt = False
        """The system runs this thread before ordinary ones."""
        self._settings = settings
        self._airframe = airframe
        self._autopilot = autopilot
        self._knowledge = knowledge
        self._clock = clock
        self._ledger = ledger
        self._tally = tally
        self._reply_timeout_ns = reply_timeout_ns
        self._mission = mission
        self._on_decision = on_decision
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=self._run, name="control", daemon=True)

    def start(self) -> None:
        """Start ticking."""
        self._thread.start()

    def stop(self) -> None:
        """Stop; the last command is to stand still."""
        self._stopping.set()
        if self._thread.is_alive():
            self._thread.join(timeout=JOIN_S)

    def decide(self, now_ns: int) -> Decision:
        """What would be commanded now; changes nothing."""
        # The order is intended: a jump of the odometry shows in the pose, and voids what the other
        # two would have told before it.
        world_from_body = self._knowledge.world_from_body(now_ns)
        estimate = self._knowledge.estimate(now_ns)
        on_mission = None
        if self._mission is not None:
            on_mission = OnMission(self._mission, self._knowledge.senses(now_ns))
        return decide(
            now_ns,
            estimate,
            world_from_body,
            self._airframe,
            self._settings,
            on_mission,
        )

    def _run(self) -> None:
        self.prompt = first_in_line()
        period_ns = round(self._settings.filter.period_s * 1e9)
        due_ns = self._clock.now_ns()
        well = True
        while not self._stopping.is_set():
            now_ns = self._clock.now_ns()
            decided: dict[str, Any] = {}
            try:
                decided = self._tick(now_ns, now_ns - due_ns)
                well = True
            except Exception:
                # Last line of defence: whatever went wrong, the drone stands still, and it is told.
                self._tally.control_errors += 1
                if well:  # once, not at every tick that fails like the one before
                    logger.exception("control tick failed: commanding a stop")
                well = False
                self._stand_still()
            self._ledger.close_unanswered(now_ns - self._reply_timeout_ns, decided)
            due_ns += period_ns
            now_ns = self._clock.now_ns()
            if due_ns < now_ns - BEHIND_PERIODS * period_ns:
                due_ns = now_ns
            self._stopping.wait(max(0, due_ns - now_ns) / 1e9)
        self._stand_still()

    def _tick(self, now_ns: int, late_ns: int) -> dict[str, Any]:
        """Decide, command, write it down; returns what the ledger says of the decision."""
        decision = self.decide(now_ns)
        self._autopilot.command(decision.command)
        self._mission = decision.mission

        status = decision.known if decision.safe is None else decision.safe.status
        self._tally.statuses[status.value] += 1
        record = decision_record(decision)
        self._ledger.tick({"t_ns": now_ns, "late_us": late_ns // 1000} | record)
        self._on_decision(decision)
        return record

    def _stand_still(self) -> None:
        try:
            self._autopilot.command(stop_command(self._clock.now_ns()))
        except Exception:
            # It is the autopilot itself that fails, and its own dead man is all that is left.
            self._tally.control_errors += 1
