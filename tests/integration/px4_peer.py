"""A PX4-like peer for tests: a process of its own that keeps PX4's rules, and none of our code.

It knows pymavlink alone. It has its own clock (with an offset to the machine's), its modes, its
rules for OFFBOARD and its failsafe, and it flies a point mass whose velocity follows late. All that
it sees goes into a JSON report, and what breaks a rule into ``violations``.

Commands come by its standard input, one a line: ``mode POSCTL``, ``arm``, ``disarm``,
``battery 12``, ``report``, ``quit``; each is answered by a line on its standard output.
"""

from __future__ import annotations

import argparse
import collections
import contextlib
import json
import math
import os
import select
import socket
import struct
import sys
import termios
import time
import tty

from pymavlink.dialects.v20 import common as m

MODES = {
    "MANUAL": (1, 0),
    "ALTCTL": (2, 0),
    "POSCTL": (3, 0),
    "OFFBOARD": (6, 0),
    "AUTO.LOITER": (4, 3),
    "AUTO.RTL": (4, 5),
    "AUTO.LAND": (4, 6),
}
NAMES = {v: k for k, v in MODES.items()}
MASK = 1479
LOSS_S = 0.5
WARM_S = 1.0
RATE_MIN_HZ = 2.0
LAG_S = 0.3
RTT_MAX_S = 0.010


class Peer:
    def __init__(self, options):
        self.options = options
        self.mav = m.MAVLink(None, srcSystem=options.system, srcComponent=1)
        self.mav.robust_parsing = True
        self.mode = "POSCTL"
        self.armed = True
        self.failsafe = False
        self.battery = 87
        self.out = None
        self.peer = None
        self.position = [0.0, 0.0, -1.5]  # NED
        self.velocity = [0.0, 0.0, 0.0]
        self.yaw = 0.3
        self.wanted = ([0.0, 0.0, 0.0], 0.0)
        self.setpoint_times = collections.deque(maxlen=4096)
        self.timesync = {"count": 0, "offset_us": 0.0}
        self.violations = []
        self.report = {
            "setpoints": 0,
            "moving_setpoints": 0,
            "set_mode_requests": [],
            "mode_changes": [],
            "heartbeats": [],
            "odometry": [],
            "ranges": [],
            "bad_data": 0,
            "intervals": {},
            "timeline": [],
        }
        self.next = dict.fromkeys(("heartbeat", "odometry", "slow", "timesync"), 0.0)
        self.heartbeat_s = 1.0

    # clock: its own, with an offset to the machine's
    def now(self):
        return time.monotonic() + self.options.clock_offset

    def stamp(self):
        return round(time.monotonic(), 6)

    def violation(self, text):
        if len(self.violations) < 200:
            self.violations.append([self.stamp(), text])

    def set_mode(self, mode, why):
        self.mode = mode
        self.report["mode_changes"].append([self.stamp(), mode, why])
        self.wanted = ([0.0, 0.0, 0.0], 0.0)

    def send(self, message):
        message.pack(self.mav)
        self.mav.seq = (self.mav.seq + 1) % 256
        self.out(bytes(message.get_msgbuf()))

    # rules
    def rate_hz(self):
        now = self.now()
        return sum(1 for t in self.setpoint_times if now - t <= 1.0)

    def streaming(self):
        """Setpoints for more than a second, above 2 Hz the whole time."""
        now = self.now()
        recent = [t for t in self.setpoint_times if now - t <= WARM_S + 0.5]
        if not recent or now - recent[0] < WARM_S or now - recent[-1] > LOSS_S:
            return False
        gaps = [b - a for a, b in zip(recent, recent[1:], strict=False)]
        return max(gaps, default=9.0) < 1.0 / RATE_MIN_HZ

    def handle(self, message):
        kind = message.get_type()
        if kind == "BAD_DATA":
            self.report["bad_data"] += 1
            return
        if message.get_msgbuf()[0] != 0xFD:
            self.violation(f"{kind} as MAVLink 1")
        if message.get_srcComponent() != 191:
            self.violation(f"{kind} from component {message.get_srcComponent()}")
        handler = getattr(self, "on_" + kind.lower(), None)
        if handler is None:
            self.violation(f"unexpected {kind}")
        else:
            handler(message)

    def on_heartbeat(self, message):
        if message.type != m.MAV_TYPE_ONBOARD_CONTROLLER or message.autopilot != 8:
            self.violation("heartbeat is not an onboard controller's")
        self.report["heartbeats"].append(self.stamp())

    def on_set_position_target_local_ned(self, message):
        if message.type_mask != MASK:
            self.violation(f"type_mask {message.type_mask}")
        if message.coordinate_frame != m.MAV_FRAME_LOCAL_NED:
            self.violation(f"coordinate_frame {message.coordinate_frame}")
        if (message.target_system, message.target_component) != (self.options.system, 1):
            self.violation("setpoint for another")
        v = [message.vx, message.vy, message.vz]
        if not all(math.isfinite(c) for c in [*v, message.yaw_rate]):
            self.violation("setpoint is not finite")
            return
        if math.dist(v, [0, 0, 0]) > 2.001 or abs(message.yaw_rate) > 2.001:
            self.violation("setpoint is too fast")
        moving = any(v) or message.yaw_rate != 0.0
        self.report["setpoints"] += 1
        self.report["moving_setpoints"] += moving
        if moving and self.mode != "OFFBOARD":
            self.report["moving_outside"] = self.report.get("moving_outside", 0) + 1
        self.setpoint_times.append(self.now())
        if len(self.report["timeline"]) < 20000:
            self.report["timeline"].append(
                [message.time_boot_ms, self.mode, *v, message.yaw_rate, self.stamp()]
            )
        if self.mode == "OFFBOARD":
            self.wanted = (v, message.yaw_rate)

    def on_command_long(self, message):
        if message.command == m.MAV_CMD_DO_SET_MODE:
            self.do_set_mode(message)
        elif message.command == m.MAV_CMD_SET_MESSAGE_INTERVAL and self.options.lose_rates > 0:
            self.options.lose_rates -= 1
        elif message.command == m.MAV_CMD_SET_MESSAGE_INTERVAL:
            self.report["intervals"][str(int(message.param1))] = message.param2
            if int(message.param1) == m.MAVLINK_MSG_ID_HEARTBEAT:
                self.heartbeat_s = message.param2 / 1e6
            self.ack(message, m.MAV_RESULT_ACCEPTED)
        else:
            self.violation(f"command {message.command}")
            self.ack(message, m.MAV_RESULT_UNSUPPORTED)

    def do_set_mode(self, message):
        name = NAMES.get((int(message.param2), int(message.param3)))
        result = m.MAV_RESULT_ACCEPTED
        if int(message.param1) & 1 == 0 or name is None:
            self.violation(f"DO_SET_MODE {message.param1} {message.param2} {message.param3}")
            result = m.MAV_RESULT_DENIED
        elif name == "OFFBOARD" and not self.streaming():
            self.violation("OFFBOARD asked for without setpoints")
            result = m.MAV_RESULT_TEMPORARILY_REJECTED
        elif self.options.refuse > 0:
            self.options.refuse -= 1
            result = m.MAV_RESULT_TEMPORARILY_REJECTED
        self.report["set_mode_requests"].append([self.stamp(), str(name), int(result)])
        self.ack(message, result)
        if result == m.MAV_RESULT_ACCEPTED and name != self.mode:
            self.failsafe = False
            self.set_mode(name, "command")

    def ack(self, message, result):
        if self.options.lose_acks > 0:
            self.options.lose_acks -= 1
            return
        self.send(
            m.MAVLink_command_ack_message(
                message.command,
                result,
                target_system=message.get_srcSystem(),
                target_component=message.get_srcComponent(),
            )
        )

    def on_timesync(self, message):
        now = self.now()
        if message.tc1 == 0:
            self.send(m.MAVLink_timesync_message(int(now * 1e9), message.ts1))
            return
        rtt = now - message.ts1 / 1e9
        self.report.setdefault("timesync_answers", 0)
        self.report["timesync_answers"] += 1
        if rtt < RTT_MAX_S:
            # Their clock to ours, as PX4 has it; the least round trip is the best sample
            offset_us = (message.ts1 / 1e3 + now * 1e6 - 2 * message.tc1 / 1e3) / 2
            if rtt <= self.timesync.get("rtt", 1.0):
                self.timesync.update(rtt=rtt, offset_us=offset_us)
            self.timesync["count"] += 1

    def on_odometry(self, message):
        if message.frame_id != m.MAV_FRAME_LOCAL_FRD or message.child_frame_id != 12:
            self.violation(f"odometry frames {message.frame_id} {message.child_frame_id}")
        if message.estimator_type != m.MAV_ESTIMATOR_TYPE_VIO:
            self.violation(f"odometry estimator {message.estimator_type}")
        if abs(math.hypot(*message.q) - 1.0) > 1e-3:
            self.violation("odometry quaternion")
        synced_us = message.time_usec + self.timesync["offset_us"]
        self.report["odometry"].append(
            {
                "age_s": self.now() - synced_us / 1e6,
                "synced": self.timesync["count"],
                "p": [message.x, message.y, message.z],
                "q": list(message.q),
                "v": [message.vx, message.vy, message.vz],
                "resets": message.reset_counter,
                "quality": message.quality,
                "variance": [
                    None if math.isnan(message.pose_covariance[i]) else message.pose_covariance[i]
                    for i in (0, 6, 11, 15, 18, 20)
                ],
            }
        )

    def on_distance_sensor(self, message):
        self.report["ranges"].append(
            [
                message.current_distance,
                message.min_distance,
                message.max_distance,
                message.orientation,
                message.signal_quality,
            ]
        )

    def on_param_request_read(self, message):
        name = message.param_id
        known = {"EKF2_EV_CTRL": (9, 6), "COM_OF_LOSS_T": (0.5, 9), "EKF2_HGT_REF": (1, 6)}
        if name in known:
            value, kind = known[name]
            raw = value
            if kind == 6:
                raw = struct.unpack("<f", struct.pack("<i", value))[0]
            self.send(m.MAVLink_param_value_message(name.encode(), raw, kind, len(known), 0))

    # flight
    def fly(self, dt):
        if self.mode == "OFFBOARD":
            last = self.setpoint_times[-1] if self.setpoint_times else -9.0
            if self.now() - last > LOSS_S:
                self.failsafe = True
                self.set_mode("AUTO.LOITER", "failsafe: no setpoints")
        goal, yaw_rate = self.wanted if self.armed else ([0.0, 0.0, 0.0], 0.0)
        share = 1.0 - math.exp(-dt / LAG_S)
        for i in range(3):
            self.velocity[i] += (goal[i] - self.velocity[i]) * share
            self.position[i] += self.velocity[i] * dt
        self.yaw += yaw_rate * dt

    def telemetry(self):
        now = self.now()
        if now >= self.next["heartbeat"]:
            self.next["heartbeat"] = now + self.heartbeat_s
            main, sub = MODES[self.mode]
            self.send(
                m.MAVLink_heartbeat_message(
                    m.MAV_TYPE_QUADROTOR,
                    m.MAV_AUTOPILOT_PX4,
                    m.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED
                    | (m.MAV_MODE_FLAG_SAFETY_ARMED if self.armed else 0),
                    main << 16 | sub << 24,
                    m.MAV_STATE_CRITICAL if self.failsafe else m.MAV_STATE_ACTIVE,
                    3,
                )
            )
        if now >= self.next["odometry"]:
            self.next["odometry"] = now + 0.02
            nan = math.nan
            self.send(
                m.MAVLink_odometry_message(
                    int(now * 1e6),
                    m.MAV_FRAME_LOCAL_NED,
                    m.MAV_FRAME_LOCAL_NED,
                    *self.position,
                    [math.cos(self.yaw / 2), 0.0, 0.0, math.sin(self.yaw / 2)],
                    *self.velocity,
                    nan,
                    nan,
                    nan,
                    # PX4 sends the variances alone (streams/ODOMETRY.hpp)
                    [1e-4 if i in (0, 6, 11, 15, 18, 20) else math.nan for i in range(21)],
                    [nan] * 21,
                    7,
                    m.MAV_ESTIMATOR_TYPE_AUTOPILOT,
                    100,
                )
            )
        if now >= self.next["slow"]:
            self.next["slow"] = now + 0.5
            charge = m.MAV_BATTERY_CHARGE_STATE_OK
            if self.battery < 15:
                charge = m.MAV_BATTERY_CHARGE_STATE_CRITICAL
            self.send(
                m.MAVLink_battery_status_message(
                    0, 0, 1, 2500, [0xFFFF] * 10, -1, -1, -1, self.battery, 0, charge
                )
            )
            landed = m.MAV_LANDED_STATE_IN_AIR if self.armed else m.MAV_LANDED_STATE_ON_GROUND
            self.send(m.MAVLink_extended_sys_state_message(0, landed))
        if now >= self.next["timesync"]:
            self.next["timesync"] = now + 0.1
            self.send(m.MAVLink_timesync_message(0, int(now * 1e9)))

    def command(self, line):
        words = line.split()
        match words:
            case ["mode", mode]:
                self.failsafe = False
                self.set_mode(mode, "pilot")
            case ["arm"]:
                self.armed = True
            case ["disarm"]:
                self.armed = False
            case ["battery", percent]:
                self.battery = int(percent)
            case ["report"]:
                print(json.dumps(self.full_report()), flush=True)
                return True
            case ["quit"]:
                return False
            case _:
                print("unknown", flush=True)
                return True
        print("ok", flush=True)
        return True

    def full_report(self):
        return self.report | {
            "violations": self.violations,
            "mode": self.mode,
            "failsafe": self.failsafe,
            "position_ned": self.position,
            "velocity_ned": self.velocity,
            "yaw_ned": self.yaw,
            "rate_hz": self.rate_hz(),
            "timesync_good": self.timesync["count"],
            "now": self.stamp(),
            "clock_offset_s": self.options.clock_offset,
        }


def serial_ends(path):
    fd = os.open(path, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
    tty.setraw(fd, termios.TCSANOW)
    return fd, (lambda data: _quietly(os.write, fd, data)), (lambda: os.read(fd, 4096))


def udp_ends(peer, target):
    host, _, port = target.rpartition(":")
    sock = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    sock.setblocking(False)
    sock.bind(("127.0.0.1", 0))
    address = (host, int(port))
    return sock.fileno(), (lambda d: _quietly(sock.sendto, d, address)), (lambda: sock.recv(4096))


def _quietly(call, *arguments):
    with contextlib.suppress(OSError):
        call(*arguments)


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("--udp")
    parser.add_argument("--serial")
    parser.add_argument("--system", type=int, default=1)
    parser.add_argument("--boot-age", type=float, default=1000.0)
    parser.add_argument("--refuse", type=int, default=0)
    parser.add_argument("--lose-acks", type=int, default=0)
    parser.add_argument("--lose-rates", type=int, default=0)
    options = parser.parse_args()
    options.clock_offset = options.boot_age - time.monotonic()
    peer = Peer(options)
    if options.serial:
        fd, peer.out, read = serial_ends(options.serial)
    else:
        fd, peer.out, read = udp_ends(peer, options.udp)
    last = peer.now()
    print("ready", flush=True)
    while True:
        ready, _, _ = select.select([fd, sys.stdin], [], [], 0.002)
        if fd in ready:
            try:
                data = read()
            except OSError:
                data = b""
            for message in peer.mav.parse_buffer(data) or []:
                peer.handle(message)
        if sys.stdin in ready:
            line = sys.stdin.readline()
            if not line or not peer.command(line):
                return
        now = peer.now()
        peer.fly(now - last)
        last = now
        peer.telemetry()


if __name__ == "__main__":
    main()
