"""What a drone waits for its results while another one, or a stranger, is hostile.

``scripts/bench adversary`` starts a service with one thread and a calm drone that sends frames.
Quiet and each attack take turns, so that whatever else the machine does falls on all of them. The
attacker is a process of its own. On a machine of few cores the processor time that it burns is part
of what is measured, which in flight it is not: ``burn`` makes the same frames and keeps them.
"""

from __future__ import annotations

import argparse
import contextlib
import os
import random
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from rgbd_wire.messages import Result
from rgbd_wire.tunnel.handshake import pack_hello, pack_init
from rgbd_wire.tunnel.seal import Cipher
from tests.integration.hostile import KEYS, Service, frame, udp_socket
from tests.integration.udp_drone import tunnelling
from tests.integration.zenoh_drone import flying

ATTACKS = ("burn", "frames", "garbage", "hellos")
RATE_HZ = 15.0
FLOOD_HZ = 300.0
"""Ten times what a drone sends."""
HELLOS_HZ = 20_000.0
TIMEOUT_S = 10.0
NETWORKS = ("udp", "zenoh")


def delays_ms(drone, seconds: float) -> list[float]:
    """Time from each frame to its result; one that never comes counts as the time-out."""
    sent_s: dict[int, float] = {}
    got_s: dict[int, float] = {}
    seen = threading.Event()
    received = drone.received

    def watch() -> None:
        at = len(received)
        while not seen.is_set():
            with drone._changed:
                if len(received) == at:
                    drone._changed.wait(0.2)
                now_s = time.monotonic()
                new, at = received[at:], len(received)
            for message in new:
                if isinstance(message, Result):
                    got_s[message.sequence] = now_s

    watcher = threading.Thread(target=watch)
    watcher.start()
    next_s = time.monotonic()
    for _ in range(round(seconds * RATE_HZ)):
        time.sleep(max(0.0, next_s - time.monotonic()))
        sequence, data = frame("d1")
        sent_s[sequence] = time.monotonic()
        drone.send(data)
        next_s += 1 / RATE_HZ
    give_up_s = time.monotonic() + TIMEOUT_S
    while len(got_s) < len(sent_s) and time.monotonic() < give_up_s:
        time.sleep(0.01)
    seen.set()
    watcher.join()
    return [1e3 * (got_s.get(s, t + TIMEOUT_S) - t) for s, t in sent_s.items()]


@contextlib.contextmanager
def attacked(network: str, attack: str, service: Service) -> Iterator[None]:
    """While an attacker is at it; quiet is no attacker."""
    if attack == "quiet":
        yield
        return
    where = service.udp if network == "udp" else service.process.endpoint
    command = [sys.executable, "-m", "tests.perf.bench_adversary", "--attack", attack]
    with subprocess.Popen(
        [*command, "--at", where], stdin=subprocess.PIPE, stdout=subprocess.PIPE
    ) as process:
        assert process.stdout is not None
        process.stdout.readline()
        yield
        process.communicate()


def attack(kind: str, where: str) -> None:
    """Until standard input ends."""
    over = threading.Event()
    threading.Thread(target=lambda: (sys.stdin.read(), over.set()), daemon=True).start()
    with contextlib.ExitStack() as stack:
        if kind == "hellos":
            _hellos(stack, where, over)
            return
        if where.startswith("udp/"):
            drone = stack.enter_context(tunnelling(where, KEYS["d6"], "d6"))
        else:
            drone = stack.enter_context(flying(where, "d6"))
        rng = random.Random(1)
        print("ready", flush=True)
        while not over.wait(1 / FLOOD_HZ):
            _, data = frame("d6")
            if kind == "garbage":
                spoilt = bytearray(data)
                spoilt[rng.randrange(len(spoilt))] ^= 0xFF
                data = bytes(spoilt)
            if kind != "burn":
                drone.send(data)


def _hellos(stack: contextlib.ExitStack, where: str, over: threading.Event) -> None:
    host, port = where.removeprefix("udp/").split(":")
    rng = random.Random(1)
    sockets = [stack.enter_context(contextlib.closing(udp_socket())) for _ in range(500)]
    nonce = rng.randbytes(16)
    hello = pack_hello(
        "d1", rng.randbytes(32), nonce, rng.randbytes(20), bytes(32), Cipher.AES_256_GCM
    )
    print("ready", flush=True)
    while not over.wait(100 / HELLOS_HZ):
        for sock in rng.sample(sockets, 50):
            for packet in (pack_init(rng.randbytes(16)), hello):
                with contextlib.suppress(BlockingIOError):
                    sock.sendto(packet, (host, int(port)))


def measure(network: str, attacks: Sequence[str], rounds: int, seconds: float) -> None:
    """Print a line for each attack."""
    found: dict[str, list[list[float]]] = {name: [] for name in ("quiet", *attacks)}
    with tempfile.TemporaryDirectory() as folder:
        service = Service(Path(folder))
        service.process.start()
        try:
            service.process.wait_ready()
            where, key = service.udp, KEYS["d1"]
            calm = (
                tunnelling(where, key, "d1")
                if network == "udp"
                else flying(service.process.endpoint, "d1")
            )
            with calm as drone:
                delays_ms(drone, 2.0)
                for round_ in range(rounds):
                    for name in found:
                        with attacked(network, name, service):
                            delays_ms(drone, 0.5)
                            found[name].append(delays_ms(drone, seconds))
                    sys.stderr.write(f"\r{network}: round {round_ + 1} of {rounds} ")
            refused = {n: int(v) for n, v in service.metrics().items() if v and "_total{" in n}
        finally:
            service.process.kill()
    sys.stderr.write("\n")
    print(f"\n{network}: a calm drone at {RATE_HZ:g} Hz, {rounds} rounds of {seconds:g} s [ms]")
    print(f"{'':10}{'p50':>8}{'p95':>8}{'  p95 over quiet; by round':42}{'lost':>5}")
    quiet = [np.percentile(run, 95) for run in found["quiet"]]
    for name, runs in found.items():
        every = np.concatenate(runs)
        ratios = [np.percentile(run, 95) / calm for run, calm in zip(runs, quiet, strict=True)]
        whole = np.percentile(every, 95) / np.percentile(np.concatenate(found["quiet"]), 95)
        by_round = f"median {np.median(ratios):.2f}, {min(ratios):.2f} to {max(ratios):.2f}"
        spread = f"{whole:6.2f}  ({by_round})"
        lost = sum(ms >= 1e3 * TIMEOUT_S for ms in every)
        p50, p95 = np.percentile(every, [50, 95])
        print(f"{name:10}{p50:8.1f}{p95:8.1f}  {spread:40}{lost:5d}")
    turned = ("rejected", "refused")
    print(
        "counted: "
        + ", ".join(f"{n} {v}" for n, v in refused.items() if any(t in n for t in turned))
    )


def main() -> int:
    """Measure, or be the attacker."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--rounds", type=int, default=6)
    parser.add_argument("--seconds", type=float, default=3.0, help="of each attack in each round")
    parser.add_argument("--network", choices=NETWORKS, action="append")
    parser.add_argument("--attack", choices=ATTACKS, help=argparse.SUPPRESS)
    parser.add_argument("--at", help=argparse.SUPPRESS)
    args = parser.parse_args()
    if args.attack:
        attack(args.attack, args.at)
        return 0
    print(f"{os.cpu_count()} cores, load {os.getloadavg()[0]:.1f}")
    for network in args.network or NETWORKS:
        attacks = ATTACKS if network == "udp" else ATTACKS[:-1]
        measure(network, attacks, args.rounds, args.seconds)
    return 0


if __name__ == "__main__":
    sys.exit(main())
