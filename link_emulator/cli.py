"""The command line: run commands over a bad link, proxy a port, change a link that runs."""

from __future__ import annotations

import argparse
import json
import signal
import sys
import time
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import fields
from pathlib import Path
from typing import Any

from link_emulator.control import DIRECTIONS, Control
from link_emulator.errors import EmulatorError
from link_emulator.impairments import Impairments
from link_emulator.namespaces import ADDRESS_A, ADDRESS_B, Namespaces
from link_emulator.proxy_process import TcpProxy, UdpProxy
from link_emulator.report import Report

ABOUT = f"""\
A bad link on one machine: delay, jitter, burst loss, rate, queue, partition.

  run      two network namespaces with the link between them, any protocol; needs root
  proxy    a UDP or TCP port with the link behind it; no root (TCP: delay, jitter, rate, cut)
  change   change a link that runs, or cut it, heal it, ask for its report

The rate counts whole IP packets; what waits longer than the queue is dropped at its tail; loss
comes after the rate; --burst makes it come in bursts of that mean length (Gilbert-Elliott).
Up is from a (or the clients) to b (or the server). Options hold for both directions;
--up loss=0.01 and --down rate_mbit=2 change one.

At the end stand what was passed and dropped, and how late packets left against when they should
have: a run whose 99th percentile is over 0.3 ms is marked, and its times are not to be trusted.

examples
  ping over 20 Mbit/s, 10 ms each way, 1 % loss in bursts of 4 (a is {ADDRESS_A}, b {ADDRESS_B}):
    python -m link_emulator run --rate-mbit 20 --delay-ms 10 --loss 0.01 --burst 4 \\
        -- ping -c 10 {ADDRESS_B}
  a server in b, and a client in a, with a socket for commands:
    python -m link_emulator run --delay-ms 10 --control /tmp/link \\
        --server 'python3 -m http.server' -- curl http://{ADDRESS_B}:8000/
  cut that link while it runs:
    python -m link_emulator change --control /tmp/link --cut
  a UDP port 9000 with a bad link to 127.0.0.1:7448:
    python -m link_emulator proxy udp --listen 127.0.0.1:9000 --to 127.0.0.1:7448 --loss 0.05
"""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a command; a user's mistake ends in one line and exit code 2."""
    arguments = list(sys.argv[1:] if arguments is None else arguments)
    command: list[str] = []
    if "--" in arguments:
        place = arguments.index("--")
        arguments, command = arguments[:place], arguments[place + 1 :]
    args = _parser().parse_args(arguments)
    try:
        if args.action == "run":
            return _run(args, command)
        if args.action == "proxy":
            return _proxy(args)
        return _change(args)
    except EmulatorError as error:
        print(f"link_emulator: {error}", file=sys.stderr)
        return 2


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="python -m link_emulator",
        description=ABOUT,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    actions = parser.add_subparsers(dest="action", required=True, metavar="run|proxy|change")
    run = actions.add_parser("run", help="commands in two namespaces, after --")
    run.add_argument("--server", help="command line that runs in b meanwhile")
    _link_options(run)
    proxy = actions.add_parser("proxy", help="a UDP or TCP port, until Ctrl-C")
    proxy.add_argument("protocol", choices=["udp", "tcp"])
    proxy.add_argument("--listen", type=_place, default=("127.0.0.1", 0), metavar="HOST:PORT")
    proxy.add_argument("--to", type=_place, required=True, metavar="HOST:PORT")
    proxy.add_argument("--seconds", type=_seconds, help="end after so long")
    _link_options(proxy)
    change = actions.add_parser("change", help="a link that runs")
    change.add_argument("--control", type=Path, required=True, help="the socket it was given")
    change.add_argument("--direction", choices=DIRECTIONS, default="both")
    change.add_argument(
        "--set", type=_assignment, action="append", default=[], metavar="NAME=VALUE"
    )
    change.add_argument("--cut", action="store_true", help="partition the link")
    change.add_argument("--heal", action="store_true", help="end the partition")
    change.add_argument("--report", action="store_true", help="print what happened so far")
    change.add_argument("--json", action="store_true", help="the report as JSON")
    return parser


def _link_options(parser: argparse.ArgumentParser) -> None:
    for name, text in (
        ("rate_mbit", "serial rate; without it no limit"),
        ("queue_ms", "queue in front of the rate, as time (100)"),
        ("queue_bytes", "the same in bytes"),
        ("delay_ms", "one way"),
        ("jitter_ms", "on top, uniform from 0 to this"),
        ("loss", "mean share of lost packets, 0 to 1"),
        ("burst", "mean length of a burst of lost packets"),
    ):
        kind = int if name == "queue_bytes" else float
        parser.add_argument(f"--{name.replace('_', '-')}", type=kind, help=text, metavar="X")
    parser.add_argument("--reorder", action="store_true", default=None, help="let jitter reorder")
    parser.add_argument(
        "--cut", type=_cut, action="append", metavar="FROM-TO", help="partition [ms from the start]"
    )
    for name, text in (("up", "a to b"), ("down", "b to a")):
        parser.add_argument(
            f"--{name}",
            type=_assignment,
            action="append",
            default=[],
            metavar="NAME=VALUE",
            help=f"{text} alone, such as loss=0.01",
        )
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--control", type=Path, help="Unix socket for `change`")
    parser.add_argument("--json", action="store_true", help="the report as JSON")


def _impairments(args: argparse.Namespace) -> tuple[Impairments, Impairments]:
    names = {f.name for f in fields(Impairments)}
    both = {k: v for k, v in vars(args).items() if k in names and v is not None and k != "cut"}
    if args.cut:
        both["cuts_ms"] = args.cut
    up, down = (Impairments().changed(both | dict(more)) for more in (args.up, args.down))
    return up, down


def _run(args: argparse.Namespace, command: list[str]) -> int:
    if not command:
        print("link_emulator: nothing to run; put the command after --", file=sys.stderr)
        return 2
    up, down = _impairments(args)
    with Namespaces(up, down, args.seed, args.control) as net:
        if args.server:
            net.popen("b", ["sh", "-c", args.server])
        process = net.popen("a", command)
        try:
            code = process.wait()
        except KeyboardInterrupt:
            process.wait()
            code = 130
        _print(net.control.report(), as_json=args.json)
    return code if code >= 0 else 128 - code


def _proxy(args: argparse.Namespace) -> int:
    up, down = _impairments(args)
    kind = UdpProxy if args.protocol == "udp" else TcpProxy
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    with kind(args.to, up, down, args.listen, args.seed, args.control) as proxy:
        print(f"{args.protocol} {args.listen[0]}:{proxy.port}", file=sys.stderr, flush=True)
        with suppress(KeyboardInterrupt):
            time.sleep(args.seconds if args.seconds is not None else float(1 << 31))
        _print(proxy.control.report(), as_json=args.json)
    return 0


def _change(args: argparse.Namespace) -> int:
    control = Control.connect(args.control)
    changes: dict[str, Any] = dict(args.set)
    if args.cut or args.heal:
        changes["cut"] = args.cut
    if changes:
        control.change(args.direction, **changes)
    if args.report:
        _print(control.report(), as_json=args.json, to=sys.stdout)
    control.close()
    return 0


def _print(report: Report, *, as_json: bool, to: Any = None) -> None:
    text = json.dumps(report.as_json(), indent=2) if as_json else str(report)
    print(text, file=to or sys.stderr)


def _seconds(text: str) -> float:
    value = float(text)
    if not 0.0 <= value < 1e9:
        raise argparse.ArgumentTypeError(f"{text} is no time")
    return value


def _place(text: str) -> tuple[str, int]:
    host, _, port = text.rpartition(":")
    if not host or not port.isdecimal() or int(port) > 65535:
        raise argparse.ArgumentTypeError(f"{text!r} is not HOST:PORT")
    return host, int(port)


def _cut(text: str) -> tuple[float, float]:
    first, _, last = text.partition("-")
    try:
        return float(first), float(last)
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text!r} is not FROM-TO in ms") from None


def _assignment(text: str) -> tuple[str, Any]:
    name, sign, value = text.partition("=")
    try:
        return name, json.loads(value)
    except ValueError:
        pass
    raise argparse.ArgumentTypeError(f"{text!r} is not NAME=VALUE{'' if sign else ': no ='}")
