"""An autopilot over MAVLink: two threads, one line, and the pure parts that say what to do.

The *pacer* sends: a tick every 1/50 s at an absolute deadline, and in each the setpoint that the
order of modes and the dead man agree on. The *listener* reads, and answers TIMESYNC at once. The
control loop only leaves its newest command; whatever happens to it, the pacer's dead man acts.
"""

from __future__ import annotations

import threading
from collections import Counter
from collections.abc import Iterable
from functools import partial
from typing import Any

from pymavlink.dialects.v20 import common as mav

from drone_client.autopilot import VehicleState, VelocityCommand, messages
from drone_client.autopilot.dead_man import (
    Refused,
    Setpoint,
    checked,
    given_up,
    leaving,
    stand_still,
)
from drone_client.autopilot.flavour import Flavour
from drone_client.autopilot.line import Line, Received
from drone_client.autopilot.mode_order import Answer, Ask, Flow, Heard, ModeOrder, Phase
from drone_client.autopilot.parameter_reader import ParameterReader
from drone_client.autopilot.receiver import Receiver
from drone_client.autopilot.sender import Sender
from drone_client.autopilot.settings import AutopilotSettings
from drone_client.autopilot.timesync import Timesync
from drone_client.autopilot.vehicle import Vehicle
from drone_client.odometry import OdometrySample, RangeSample
from rgbd_wire.clock import Clock

READ_TIMEOUT_S = 0.05
JOIN_S = 2.0
HEARTBEAT_NS = 1_000_000_000
TIMESYNC_NS = 200_000_000
ASK_RATES_NS = 2_000_000_000
ASK_RATES = 5
"""So often at most, once its pose comes: some autopilots do not answer."""
"""Rates are asked for again as long as no pose has come for this long."""
PEER_SILENT_NS = 3_000_000_000
"""An autopilot that is heard stays where it is: another address counts only after this silence."""
LEAVE_S = 3.0
"""``close`` waits so long for a vehicle that is being given back."""

_ANSWERS = {
    mav.MAV_RESULT_ACCEPTED: Answer.ACCEPTED,
    mav.MAV_RESULT_UNSUPPORTED: Answer.NEVER,
}


class MavlinkAutopilot:
    """A ``FlyingAutopilot`` that speaks MAVLink 2. Arms nothing."""

    def __init__(
        self, line: Line, flavour: Flavour, clock: Clock, settings: AutopilotSettings
    ) -> None:
        """Begin to listen, and to send heartbeats; setpoints only after ``engage``.

        Args:
            line: open; closed by ``close``.
            flavour: the kind of autopilot at its other end.
            clock: the drone's.
            settings: rates, ids, limits.
        """
        self.refused: Counter[str] = Counter()
        """Commands and samples that were not passed on, by reason."""
        self.errors = 0
        """Exceptions in a thread, none of which ended it."""
        self.setpoints = 0
        """Sent."""
        self.late_ticks = 0
        """Ticks left out because the thread came too late for them."""
        self._line = line
        self.flavour = flavour
        self._clock = clock
        self._settings = settings
        self._receiver = Receiver(
            flavour.autopilot, settings.own_component, settings.system, settings.component
        )
        self._vehicle = Vehicle()
        self._order = ModeOrder(flavour.taking_mode, settings.order)
        self._timesync = Timesync()
        self._parameters = ParameterReader(
            clock, self._ask_parameter, bytewise=flavour.bytewise_parameters
        )
        self._newest: Setpoint | None = None
        self._sent_ns = 0
        self._lock = threading.RLock()
        self._sender = Sender(line, self._receiver, settings)
        self._peer_heard_ns: int | None = None
        self._peer: Any = None
        self._heartbeat_ns: int | None = None
        self._timesync_ns: int | None = None
        self._rates_asked_ns: int | None = None
        self._rates_asked = 0
        self._rates_open = 0
        """Questions of the last time that were not answered yet."""
        self._stopping = threading.Event()
        self._silent = threading.Event()
        self._silent.set()
        self._threads = [
            threading.Thread(target=self._pace, name="autopilot-pacer", daemon=True),
            threading.Thread(target=self._listen, name="autopilot-listener", daemon=True),
        ]
        for thread in self._threads:
            thread.start()

    # --- what the control loop and the person call -----------------------------------------------

    def command(self, command: VelocityCommand) -> None:
        """Take the newest command; never blocks, never raises. A refused one counts as none."""
        with self._lock:
            now_ns = self._clock.now_ns()
            self._give_up_if_late(now_ns)
            newest_ns = None if self._newest is None else self._newest.t_ns
            result = checked(command, now_ns, newest_ns, self._settings.dead_man)
            if isinstance(result, Refused):
                self.refused[f"command_{result.value}"] += 1
            else:
                self._newest = result

    def state(self) -> VehicleState | None:
        """The newest state; None: never heard."""
        now_ns = self._clock.now_ns()
        with self._lock:
            return self._vehicle.state(self._order.phase is Phase.ENGAGED, now_ns)

    def odometry(self) -> OdometrySample | None:
        """The autopilot's own estimate, with covariance and resets; None: it gave none yet."""
        with self._lock:
            return self._vehicle.odometry

    @property
    def phase(self) -> str:
        """Where in the order of modes we are."""
        return self._order.phase.value

    @property
    def reason(self) -> str:
        """Why it is silent, in words, or what it waits for; empty while engaged."""
        return self._order.reason

    @property
    def idle(self) -> bool:
        """Whether it neither asks for the vehicle nor flies it."""
        return self._order.phase is Phase.SILENT

    def clock_offset_ns(self) -> tuple[int, int] | None:
        """Autopilot's clock minus drone's clock, and its error bound [ns]; None: not known yet."""
        with self._lock:
            return self._timesync.offset_ns(self._clock.now_ns())

    def engage(self) -> None:
        """Ask for the mode that takes commands; arms nothing. ``state().obeying`` tells."""
        with self._lock:
            self._order.engage(self._clock.now_ns())
            self._mark_silence()

    def release(self) -> None:
        """Give the vehicle back: zero velocity, the mode that holds its position, then silence."""
        with self._lock:
            self._order.release(self._clock.now_ns())
            self._mark_silence()

    def give_odometry(self, sample: OdometrySample) -> None:
        """Pass the robot's own odometry to the autopilot's estimator."""
        self._give("odometry", lambda: messages.odometry(sample))

    def give_range(self, sample: RangeSample) -> None:
        """Pass a distance to its estimator."""
        self._give("range", lambda: messages.distance_sensor(sample))

    def read_parameters(
        self, names: Iterable[str], timeout_s: float = 5.0
    ) -> dict[str, float | int]:
        """Values of parameters; the ones that do not come in time are missing. Waits, for once.

        Args:
            names: as the autopilot spells them, at most 16 letters each.
            timeout_s: for all together.
        """
        return self._parameters.read(names, timeout_s)

    def counts(self) -> dict[str, int]:
        """What was sent, taken and refused, for logs and ``--json``."""
        with self._lock:
            # Copies: the listener counts what it refuses without the lock
            counts = {f"in_{k.lower()}": n for k, n in dict(self._receiver.accepted).items()}
            for group in (self._receiver.refused, self._vehicle.refused, self.refused):
                for reason, n in dict(group).items():
                    counts[f"refused_{reason}"] = counts.get(f"refused_{reason}", 0) + n
            return counts | {
                "setpoints": self.setpoints,
                "late_ticks": self.late_ticks,
                "not_sent": self._line.dropped,
                "mavlink1": self._receiver.mavlink1,
                "signed": self._receiver.signed,
                "timesync_unused": self._timesync.unused,
                "clock_steps": self._timesync.steps,
                "errors": self.errors,
            }

    def close(self) -> None:
        """Give the vehicle back if it is ours, end the threads, close the line."""
        self.release()
        try:
            self._wait_for_silence()
        finally:
            self._stopping.set()
            for thread in self._threads:
                if thread is not threading.current_thread():
                    thread.join(JOIN_S)
            self._line.close()

    def _wait_for_silence(self) -> None:
        """Until the vehicle is given back, for a while; an interrupt comes after it."""
        give_up_ns = self._clock.now_ns() + round(LEAVE_S * 1e9)
        interrupt = None
        while (left_ns := give_up_ns - self._clock.now_ns()) > 0:
            try:
                self._silent.wait(left_ns / 1e9)
                break
            except KeyboardInterrupt as error:
                interrupt = error
        if interrupt is not None:
            raise interrupt

    # --- the pacer -------------------------------------------------------------------------------

    def _pace(self) -> None:
        period_ns = round(1e9 / self._settings.rate_hz)
        due_ns = self._clock.now_ns()
        while not self._stopping.is_set():
            try:
                self._tick(self._clock.now_ns())
            except Exception:
                # The boundary of this thread: it must go on, for what it sends is the dead man
                self.errors += 1
            due_ns += period_ns
            late_ns = self._clock.now_ns() - due_ns
            if late_ns > 0:
                missed = -(-late_ns // period_ns)
                self.late_ticks += missed
                due_ns += missed * period_ns  # left out, not made up for: no burst
            self._stopping.wait(max(0, due_ns - self._clock.now_ns()) / 1e9)

    def _tick(self, now_ns: int) -> None:
        with self._lock:
            self._give_up_if_late(now_ns)
            step = self._order.step(now_ns)
            setpoint = self._setpoint(step.flow, now_ns)
            self._mark_silence()
        # Outside of the lock, and not later: the setpoint is what is urgent
        if setpoint is not None:
            sent = self._sender.to_vehicle(
                lambda s, c: messages.velocity_setpoint(setpoint, now_ns, s, c)
            )
            if sent:  # one that the line dropped is silence, as far as the autopilot knows
                self.setpoints += 1
                self._sent_ns = now_ns
        if step.ask is not None:
            main, sub = self.flavour.take if step.ask is Ask.TAKE else self.flavour.hold
            self._sender.to_vehicle(lambda s, c: messages.set_mode(main, sub, s, c))
        if _due(self._heartbeat_ns, now_ns, HEARTBEAT_NS):
            self._heartbeat_ns = now_ns
            self._sender.send(messages.heartbeat())
        if _due(self._timesync_ns, now_ns, TIMESYNC_NS):
            self._timesync_ns = now_ns
            self._ask_time()
        self._ask_rates(now_ns)

    def _setpoint(self, flow: Flow, now_ns: int) -> Setpoint | None:
        match flow:
            case Flow.ZERO:
                return stand_still(now_ns)
            case Flow.COMMANDS:
                return leaving(self._flown(), now_ns, self._settings.dead_man)
            case _:
                return None

    def _flown(self) -> Setpoint | None:
        newest, engaged_ns = self._newest, self._order.engaged_ns
        if engaged_ns is not None and (newest is None or newest.t_ns < engaged_ns):
            return stand_still(engaged_ns)  # the control loop's first one is on its way
        return newest

    def _give_up_if_late(self, now_ns: int) -> None:
        if given_up(self._sent_ns, now_ns, self._settings.dead_man):
            self._order.give_up(now_ns, "no setpoint left for too long")
            self._mark_silence()

    def _ask_time(self) -> None:
        with self._lock:
            if self._receiver.system is None:
                return
            ts1_ns = self._timesync.ask(self._clock.now_ns())
        self._sender.send(messages.timesync(0, ts1_ns))

    def _ask_rates(self, now_ns: int) -> None:
        with self._lock:
            sample = self._vehicle.odometry
            flows = sample is not None and now_ns - sample.t_ns < ASK_RATES_NS
            settled = self._rates_open <= 0 or self._rates_asked >= ASK_RATES
            if flows and self._rates_asked_ns is not None and settled:
                return
            if self._peer_heard_ns is None or not _due(self._rates_asked_ns, now_ns, ASK_RATES_NS):
                return
            self._rates_asked_ns = now_ns
            self._rates_asked += 1
            self._rates_open = len(self.flavour.rates_hz)
        for message_id, rate_hz in self.flavour.rates_hz.items():
            self._sender.to_vehicle(partial(messages.message_interval, message_id, rate_hz))

    def _mark_silence(self) -> None:
        if self._order.phase is Phase.SILENT:
            self._silent.set()
        else:
            self._silent.clear()

    # --- the listener ----------------------------------------------------------------------------

    def _listen(self) -> None:
        while not self._stopping.is_set():
            try:
                received = self._line.read(READ_TIMEOUT_S)
                if received is not None:
                    self._take(received, self._clock.now_ns())
            except Exception:
                # The boundary of this thread: whatever came, the next one is listened to
                self.errors += 1
                self._stopping.wait(READ_TIMEOUT_S)

    def _take(self, received: Received, now_ns: int) -> None:
        if received.source != self._peer and self._peer_is_heard(now_ns):
            self._receiver.refused["stranger"] += 1
            return
        if self._receiver.over_budget(now_ns):
            self._receiver.refused["flood"] += 1
            return
        if self._line.is_datagram:
            self._receiver.start_datagram()
        for message in self._receiver.messages(received.data, now_ns):
            # A word of the autopilot itself: whoever sent it is where it is reached
            if received.source != self._peer or self._peer_heard_ns is None:
                self._peer = received.source
                self._line.answer_to(received.source)
            self._peer_heard_ns = now_ns
            self._handle(message, now_ns)

    def _peer_is_heard(self, now_ns: int) -> bool:
        heard_ns = self._peer_heard_ns
        return heard_ns is not None and now_ns - heard_ns < PEER_SILENT_NS

    def _handle(self, message: mav.MAVLink_message, now_ns: int) -> None:  # noqa: C901  # a table
        match message.get_type():
            case "TIMESYNC":
                self._handle_timesync(message, now_ns)
            case "HEARTBEAT":
                mode = self.flavour.mode_name(int(message.custom_mode))
                with self._lock:
                    self._vehicle.heartbeat(message, mode, now_ns)
                    self._order.heard(Heard(now_ns, mode, self._vehicle.armed))
                    self._mark_silence()
            case "COMMAND_ACK":
                self._handle_ack(message)
            case "ODOMETRY":
                with self._lock:
                    t_ns = self._timesync.ours_ns(int(message.time_usec) * 1000, now_ns)
                    self._vehicle.odometry_in(message, t_ns, now_ns)
            case "LOCAL_POSITION_NED":
                with self._lock:
                    t_ns = self._timesync.ours_ns(int(message.time_boot_ms) * 1_000_000, now_ns)
                    self._vehicle.position(message, t_ns, now_ns)
            case "ATTITUDE_QUATERNION":
                with self._lock:
                    t_ns = self._timesync.ours_ns(int(message.time_boot_ms) * 1_000_000, now_ns)
                    self._vehicle.attitude(message, t_ns, now_ns)
            case "BATTERY_STATUS":
                with self._lock:
                    self._vehicle.battery(message)
            case "EXTENDED_SYS_STATE":
                with self._lock:
                    self._vehicle.extended_state(message)
            case "STATUSTEXT":
                with self._lock:
                    self._vehicle.status_text(message, now_ns)
            case "PARAM_VALUE":
                self._parameters.heard(message)
            case _:
                pass

    def _handle_timesync(self, message: mav.MAVLink_message, now_ns: int) -> None:
        if message.tc1 == 0:
            self._sender.send(messages.timesync(self._clock.now_ns(), int(message.ts1)))
            return
        with self._lock:
            self._timesync.answered(int(message.tc1), int(message.ts1), now_ns)

    def _handle_ack(self, message: mav.MAVLink_message) -> None:
        # One that names somebody else answers somebody else's question
        for_us = (message.target_system in (0, self._sender.own_system)) and (
            message.target_component in (0, self._settings.own_component)
        )
        if message.command == mav.MAV_CMD_SET_MESSAGE_INTERVAL and for_us:
            with self._lock:
                self._rates_open -= 1
        if message.command != mav.MAV_CMD_DO_SET_MODE or not for_us:
            return
        if message.result != mav.MAV_RESULT_IN_PROGRESS:
            with self._lock:
                self._order.answered(
                    _ANSWERS.get(message.result, Answer.LATER), self._clock.now_ns()
                )

    # --- sending ---------------------------------------------------------------------------------

    def _give(self, what: str, build: Any) -> None:
        try:
            message = build()
        except Exception:
            # What the caller handed over is no sample; the control loop must not hear of it
            message = None
        if message is None:
            self.refused[f"{what}_sample"] += 1
        else:
            self._sender.send(message)

    def _ask_parameter(self, name: str) -> None:
        self._sender.to_vehicle(lambda s, c: messages.parameter_request(name, s, c))


def _due(last_ns: int | None, now_ns: int, period_ns: int) -> bool:
    return last_ns is None or now_ns - last_ns >= period_ns
