"""The cockpit in a terminal: a question before it flies, one moving line while it does."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial

from rich.console import Console, Group
from rich.live import Live
from rich.table import Table
from rich.text import Text

from drone_client.control import Decision
from drone_client.fly.cockpit import View

STATUS_STYLE = {"inactive": "green", "active": "yellow", "max_hdot": "yellow", "stale": "red"}


class TerminalCockpit:
    """Shows on a console, which is stderr: stdout belongs to the summary."""

    def __init__(self, console: Console, *, ask: bool) -> None:
        """Take over a console.

        Args:
            console: to show on.
            ask: before the vehicle is taken; else it is taken without a question.
        """
        self._console = console
        self._ask = ask
        self._live = Live(console=console, refresh_per_second=10, transient=True)
        self._started = False

    def may_fly(self, view: View) -> bool:
        """Show the vehicle and what is seen, and ask; any answer but yes is no."""
        self._console.print(vehicle_table(view))
        if not self._ask:
            return True
        self._console.print(
            "The client does not arm and does not take off: the drone should hover now, with a "
            "pilot at the sticks, whose mode switch ends this at any time.",
            soft_wrap=True,
        )
        try:
            answer = self._console.input("Take the vehicle and fly to contact? Type yes: ")
        except EOFError:
            return False
        return answer.strip().lower() == "yes"

    def show(self, view: View) -> None:
        """Refresh the moving lines; nothing where nobody looks."""
        if self._console.quiet or not self._console.is_terminal:
            return
        if not self._started:
            self._started = True
            self._say(self._live.start)
        self._live.update(Group(*flight_lines(view)))

    def tell(self, sentence: str) -> None:
        """Print what has happened, above the moving lines."""
        self._say(
            partial(self._console.print, sentence, markup=False, highlight=False, soft_wrap=True)
        )

    def close(self) -> None:
        """Leave the terminal as it was."""
        if self._started:
            self._started = False
            self._say(self._live.stop)

    def _say(self, say: Callable[[], None]) -> None:
        """A terminal that has gone does not end a flight: nothing is shown any more."""
        try:
            say()
        except (Exception, SystemExit):
            # rich exits on a broken pipe, and its moving lines are not made to fail half way
            self._console.quiet = True


def vehicle_table(view: View) -> Table:
    """What a person should look at before the vehicle is taken."""
    table = Table("", "", title="before the flight", show_header=False)
    vehicle, decision = view.vehicle, view.decision
    if vehicle is not None:
        table.add_row("vehicle", _vehicle_line(view))
        if vehicle.failsafe:
            table.add_row("failsafe", Text(vehicle.failsafe, "red"))
    table.add_row("workers", ", ".join(view.workers) or Text("none", "red"))
    accepted = view.tally.verdicts["accepted"]
    total = sum(view.tally.verdicts.values())
    table.add_row("results", f"{accepted} of {total} accepted")
    seen = view.tally.outcomes["target"]
    table.add_row("target", f"seen {seen} times" if seen else Text("not seen yet", "yellow"))
    if decision is not None and decision.tip_target is not None:
        table.add_row("tip", _tip(decision))
    return table


def flight_lines(view: View) -> list[Text]:
    """Two lines: the mission, and what it rests on."""
    decision = view.decision
    mission = None if decision is None else decision.mission
    first = Text(f"{'waiting' if mission is None else mission.phase.value:9}", "bold")
    if decision is not None and decision.tip_target is not None:
        first.append(f" tip {_tip(decision)}")
    if decision is not None:
        speed = math.sqrt(float(decision.command.velocity_world @ decision.command.velocity_world))
        first.append(f"  commanded {speed:.2f} m/s")
    second = Text(" " * 10)
    if decision is not None and (safe := decision.safe) is not None:
        status = safe.status.value
        second.append(status, STATUS_STYLE.get(status, "red"))
        second.append(f"  h {safe.h_robust:+.3f} m  ball {1e3 * safe.delta_m:.0f} mm")
    if decision is not None and decision.age_ns is not None:
        source = "" if decision.source is None else f" by {decision.source.value}"
        second.append(f"  known {decision.age_ns / 1e6:.0f} ms ago{source}")
    second.append(f"  {_vehicle_line(view)}")
    return [first, second]


def _vehicle_line(view: View) -> str:
    vehicle = view.vehicle
    if vehicle is None:
        return "no vehicle"
    battery = (
        "" if vehicle.battery_fraction is None else f", battery {vehicle.battery_fraction:.0%}"
    )
    armed = "armed" if vehicle.armed else "disarmed"
    ours = "flies our commands" if vehicle.obeying else "not ours"
    return f"{vehicle.mode}, {armed}, {ours}{battery}"


def _tip(decision: Decision) -> str:
    assert decision.tip_target is not None
    x, y, z = decision.tip_target
    return f"{x:+.3f} m before the board, {1e3 * y:+.0f} mm right, {1e3 * z:+.0f} mm up"
