"""A stand-in for PX4's simulator_mavlink, and for all that flies behind it: none of our code.

It knows pymavlink and the standard library. It connects as PX4 does, says HEARTBEAT and asks for
HIL_STATE_QUATERNION, and answers every HIL_SENSOR with HIL_ACTUATOR_CONTROLS of the same stamp.
From HIL_SENSOR and ODOMETRY alone it estimates where it is (NED, FRD), arms itself, climbs, and
holds its place with a cascade of its own: place, velocity, attitude, rates, PX4's motors 1 to 4.

``--fault`` makes it one of the peers that nobody wants. At its end it prints a report as JSON.
"""

from __future__ import annotations

import argparse
import json
import math
import random
import socket
import sys
import time

from pymavlink.dialects.v20 import common as m

G = 9.81
MASS, ARM, MAX_N, DRAG_M = 3.3, 0.23, 16.5, 0.03
INERTIA = (0.045, 0.052, 0.088)
ARMED, CUSTOM = 128, 1
FAULTS = (
    "none",
    "hangs",
    "leaves",
    "nan",
    "wild",
    "old_stamps",
    "future_stamps",
    "twice",
    "no_lockstep",
    "garbage_between",
    "garbage_only",
    "halves",
    "flood",
    "silent",
    "disarms",
)


def cross(a, b):
    return (
        a[1] * b[2] - a[2] * b[1],
        a[2] * b[0] - a[0] * b[2],
        a[0] * b[1] - a[1] * b[0],
    )


def dot(a, b):
    return sum(x * y for x, y in zip(a, b, strict=True))


def add(a, b, k=1.0):
    return tuple(x + k * y for x, y in zip(a, b, strict=True))


def unit(a):
    n = math.sqrt(dot(a, a))
    return tuple(x / n for x in a)


def clip(x, most):
    return max(-most, min(most, x))


def matrix(q):
    """Rotation matrix rows of a quaternion wxyz, by the textbook."""
    w, x, y, z = q
    return (
        (1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)),
        (2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)),
        (2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)),
    )


def times(rows, v):
    return tuple(dot(row, v) for row in rows)


def back(rows, v):
    return tuple(sum(rows[i][j] * v[i] for i in range(3)) for j in range(3))


def turned(q, rates, dt):
    """A quaternion after a turn in the body, to first order and normalised."""
    w, x, y, z = q
    p, r, s = (0.5 * dt * c for c in rates)
    return unit(
        (
            w - x * p - y * r - z * s,
            x + w * p + y * s - z * r,
            y + w * r + z * p - x * s,
            z + w * s + x * r - y * p,
        )
    )


class Estimate:
    """Strapdown by the IMU; a share of what the VIO says at every ODOMETRY."""

    def __init__(self):
        self.p = self.v = self.rates = (0.0, 0.0, 0.0)
        self.q = None
        self.last_us = None

    def imu(self, message):
        dt = 0.004 if self.last_us is None else (message.time_usec - self.last_us) * 1e-6
        self.last_us = message.time_usec
        self.rates = (message.xgyro, message.ygyro, message.zgyro)
        if self.q is None:
            return
        self.q = turned(self.q, self.rates, dt)
        force = times(matrix(self.q), (message.xacc, message.yacc, message.zacc))
        self.v = add(self.v, add(force, (0.0, 0.0, G)), dt)
        self.p = add(self.p, self.v, dt)

    def vio(self, message):
        if self.q is None:
            self.q = tuple(message.q)
            self.p = (message.x, message.y, message.z)
            return
        sign = 1.0 if dot(self.q, message.q) >= 0.0 else -1.0
        self.q = unit(
            tuple(0.95 * a + 0.05 * sign * b for a, b in zip(self.q, message.q, strict=True))
        )
        v = times(matrix(message.q), (message.vx, message.vy, message.vz))
        self.p = add(self.p, add((message.x, message.y, message.z), self.p, -1.0), 0.15)
        self.v = add(self.v, add(v, self.v, -1.0), 0.2)


class Pilot:
    """Holds a place, or flies a velocity where there is none to hold, and a heading, in NED."""

    def __init__(self):
        self.goal = None
        self.goal_v = (0.0, 0.0, 0.0)
        self.yaw = 0.0
        self.lift = (0.0, 0.0, 0.0)

    def motors(self, e, dt):
        rows = matrix(e.q)
        off = (0.0, 0.0, 0.0) if self.goal is None else add(self.goal, e.p, -1.0)
        wanted = tuple(clip(1.2 * c, 0.6) for c in off)
        miss = add(add(wanted, self.goal_v), e.v, -1.0)
        self.lift = tuple(clip(i + 0.6 * dt * c, 2.0) for i, c in zip(self.lift, miss, strict=True))
        acc = tuple(clip(2.5 * c, 3.0) + i for c, i in zip(miss, self.lift, strict=True))
        force = add(acc, (0.0, 0.0, -G))  # what the rotors must give, per mass
        z_body = tuple(row[2] for row in rows)
        thrust = clip(-MASS * dot(force, z_body), 4 * MAX_N * 0.9)
        aim = back(rows, unit(tuple(-c for c in force)))  # where z of the body should be
        tilt = cross((0.0, 0.0, 1.0), aim)
        heading = math.atan2(rows[1][0], rows[0][0])
        turn = (self.yaw - heading + math.pi) % (2 * math.pi) - math.pi
        rates = (5.0 * tilt[0], 5.0 * tilt[1], clip(1.5 * turn, 0.5))
        gains = (12.0, 12.0, 4.0)
        roll, pitch, yaw = (
            i * k * (want - have)
            for i, k, want, have in zip(INERTIA, gains, rates, e.rates, strict=True)
        )
        a, b, c = roll / (4 * ARM), pitch / (4 * ARM), clip(yaw / (4 * DRAG_M), 2.0)
        # front right, rear left (both counter-clockwise), front left, rear right
        forces = (
            thrust / 4 - a + b + c,
            thrust / 4 + a - b + c,
            thrust / 4 + a + b - c,
            thrust / 4 - a - b - c,
        )
        return [max(0.0, min(1.0, f / MAX_N)) for f in forces]


class Peer:
    def __init__(self, options):
        self.options = options
        host, _, port = options.connect.rpartition(":")
        give_up = time.monotonic() + 120.0
        while True:
            try:
                self.socket = socket.create_connection((host, int(port)), timeout=60.0)
                break
            except ConnectionRefusedError:  # PX4 asks again and again, too
                if time.monotonic() > give_up:
                    raise
                time.sleep(0.05)
        self.socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self.mav = m.MAVLink(None, srcSystem=1, srcComponent=1)
        self.mav.robust_parsing = True
        self.estimate, self.pilot = Estimate(), Pilot()
        self.random = random.Random(1)
        self.armed_us = None
        self.answers = 0
        self.report = {
            "counts": {},
            "stamps_in_order": True,
            "sensor_steps_us": [],
            "fields": {},
            "home": None,
            "acks": [],
            "bad": 0,
            "track": [],
            "last_state": None,
        }

    def pack(self, message):
        data = message.pack(self.mav)
        self.mav.seq = (self.mav.seq + 1) % 256
        return bytes(data)

    def run(self):
        self.socket.sendall(
            self.pack(m.MAVLink_heartbeat_message(0, 12, 0, 0, 0, 3))
            + self.pack(
                m.MAVLink_command_long_message(
                    0, 0, m.MAV_CMD_SET_MESSAGE_INTERVAL, 0, 115, 5000, 0, 0, 0, 0, 0
                )
            )
        )
        if self.options.fault == "garbage_only":
            for _ in range(200):
                self.socket.sendall(self.random.randbytes(1024))
        if self.options.fault == "flood":
            beat = self.pack(m.MAVLink_heartbeat_message(0, 12, 0, 0, 0, 3))
            for _ in range(200):
                self.socket.sendall(beat * 200)
        while True:
            data = self.socket.recv(4096)
            if not data:
                return
            for message in self.mav.parse_buffer(data) or []:
                if not self.handle(message):
                    return

    def handle(self, message):
        kind = message.get_type()
        counts = self.report["counts"]
        counts[kind] = counts.get(kind, 0) + 1
        if kind == "BAD_DATA":
            self.report["bad"] += 1
        elif kind == "HIL_SENSOR":
            return self.sensor(message)
        elif kind == "ODOMETRY":
            assert (message.frame_id, message.child_frame_id) == (20, 12), "LOCAL_FRD, BODY_FRD"
            self.estimate.vio(message)
        elif kind == "HIL_GPS" and self.report["home"] is None:
            self.report["home"] = [message.lat, message.lon, message.alt, message.fix_type]
        elif kind == "COMMAND_ACK":
            self.report["acks"].append([message.command, message.result])
        elif kind == "HIL_STATE_QUATERNION":
            self.report["last_state"] = [message.lat, message.lon, message.alt]
        return True

    def sensor(self, message):
        last = self.estimate.last_us
        if last is not None:
            self.report["stamps_in_order"] &= message.time_usec > last
            if len(self.report["sensor_steps_us"]) < 100:
                self.report["sensor_steps_us"].append(message.time_usec - last)
        fields = str(message.fields_updated)
        self.report["fields"][fields] = self.report["fields"].get(fields, 0) + 1
        self.estimate.imu(message)
        return self.answer(message.time_usec, self.motors(message.time_usec))

    def motors(self, t_us):
        """Arm when the estimate stands, climb for four seconds, hold."""
        e, o = self.estimate, self.options
        if self.armed_us is None:
            if t_us < o.arm_s * 1e6 or e.q is None:
                return [0.0] * 4
            self.armed_us = t_us
            rows = matrix(e.q)
            self.pilot.yaw = math.atan2(rows[1][0], rows[0][0])
            self.ground = e.p
        self.aim(t_us)
        if len(self.report["track"]) < 2000 and self.answers % 25 == 0:
            self.report["track"].append([t_us / 1e6, *e.p])
        return self.pilot.motors(e, 0.004)

    def aim(self, t_us):
        """Where to be now."""
        o = self.options
        climbed = min(1.0, (t_us - self.armed_us) / 4e6)
        self.pilot.goal = add(self.ground, (0.0, 0.0, -o.height_m * climbed))
        self.pilot.goal_v = (0.0, 0.0, -o.height_m / 4.0 if climbed < 1.0 else 0.0)

    def answer(self, t_us, motors):
        """HIL_ACTUATOR_CONTROLS; False: it has had enough."""
        o = self.options
        self.answers += 1
        flown_s = -1.0 if self.armed_us is None else (t_us - self.armed_us) / 1e6
        fault = o.fault if flown_s >= o.fault_s else "none"
        if o.fault == "silent":
            return True
        if fault == "hangs":
            time.sleep(3600)
        if fault == "leaves":
            return False
        armed = self.armed_us is not None and fault != "disarms"
        mode = CUSTOM | (ARMED if armed else 0)
        stamp = t_us + {"old_stamps": -1_000_000, "future_stamps": 1_000_000}.get(fault, 0)
        if fault == "nan" and flown_s < o.fault_s + 0.02:
            motors = [*motors[:3], math.nan]
        if fault == "wild":
            motors = [1e30 if self.answers % 200 == 0 else c if c > 0.2 else -7.0 for c in motors]
        flags = 0 if fault == "no_lockstep" else 1

        def controls(t_us, motors):
            return self.pack(
                m.MAVLink_hil_actuator_controls_message(t_us, [*motors, *[0.0] * 12], mode, flags)
            )

        data = controls(stamp, motors)
        if fault == "twice":
            data = controls(stamp - 4000, [0.0] * 4) + data + controls(stamp, [0.0] * 4)
        if fault == "garbage_between":
            # without the bytes that begin a message, which would swallow the next one
            garbage = self.random.randbytes(self.random.randrange(1, 40))
            data = garbage.translate(None, b"\xfd\xfe") + data
        if fault == "halves":
            cut = self.random.randrange(1, len(data))
            self.socket.sendall(data[:cut])
            time.sleep(0.0005)
            data = data[cut:]
        self.socket.sendall(data)
        return t_us < o.seconds * 1e6


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("--connect", required=True)
    parser.add_argument("--seconds", type=float, default=26.0, help="simulated, then it leaves")
    parser.add_argument("--arm-s", type=float, default=1.0)
    parser.add_argument("--height-m", type=float, default=1.2)
    parser.add_argument("--fault", choices=FAULTS, default="none")
    parser.add_argument("--fault-s", type=float, default=5.0, help="after arming")
    peer = Peer(parser.parse_args())
    try:
        peer.run()
    except (ConnectionResetError, BrokenPipeError):
        peer.report["broken"] = True
    print(json.dumps(peer.report), flush=True)
    peer.socket.close()


if __name__ == "__main__":
    sys.exit(main())
