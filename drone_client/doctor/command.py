"""``drone-client doctor``: what is wrong before a flight, and what to change."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.progress import Progress, SpinnerColumn, TextColumn, TimeElapsedColumn
from rich.table import Table
from rich.text import Text

from drone_client.doctor.areas import look_at
from drone_client.doctor.camera import collect_camera, judge_camera_run
from drone_client.doctor.files import check_files
from drone_client.doctor.finding import Check, Finding, unchecked
from drone_client.doctor.machine import collect_machine, judge_machine
from drone_client.doctor.odometry import collect_odometry, judge_odometry
from drone_client.doctor.path import collect_path
from drone_client.doctor.service import (
    ServiceFacts,
    collect_http,
    collect_service,
    collect_target,
    judge_service,
)
from drone_client.errors import ClientError
from drone_client.flight_settings import flight_settings
from drone_client.link.choose import link_summary, open_link
from drone_client.odometry.choose import open_odometry
from drone_client.odometry.jump import JumpSettings
from drone_client.odometry.zenoh import RosOdometry
from drone_client.ros.names import Flavour
from drone_client.settings import ClientSettings, about, load_settings
from drone_client.source.choose import open_live
from drone_client.tuning import load_tuning
from rgbd_wire.clock import MonotonicClock
from rgbd_wire.tls_files import tls_files
from target_pose.errors import TargetError
from target_pose.target import Target, load_round_target

STYLES = {
    Finding.OK: "green",
    Finding.WARNING: "yellow",
    Finding.FAULT: "bold red",
    Finding.UNCHECKED: "dim",
}


@dataclass(frozen=True, slots=True)
class _Topics:
    """Of the robot's own sensors, in ROS 2; None: it has no such one."""

    vio: str | None
    lidar: str | None
    ahead: str | None

    @property
    def wanted(self) -> tuple[str, ...]:
        """As the source calls them."""
        named = {"odometry": self.vio, "height": self.lidar, "ahead": self.ahead}
        return tuple(kind for kind, topic in named.items() if topic is not None)

    def open(self, settings: ClientSettings, clock: MonotonicClock) -> RosOdometry | None:
        return open_odometry(
            settings,
            clock,
            vio_topic=self.vio,
            lidar_topic=self.lidar,
            ahead_topic=self.ahead,
        )


def doctor(
    autopilot: Annotated[
        str | None, typer.Option(help="as for fly; without it the vehicle is not looked at")
    ] = None,
    airframe: Annotated[Path | None, typer.Option(help="airframe TOML")] = None,
    camera: Annotated[Path | None, typer.Option(help="camera JSON")] = None,
    tuning: Annotated[Path | None, typer.Option(help="tuning TOML")] = None,
    source: Annotated[
        str | None,
        typer.Option(help="realsense[:SERIAL]; without it no camera is run", show_default=False),
    ] = None,
    connect: Annotated[str | None, typer.Option(help=about("connect"))] = None,
    url: Annotated[
        str | None, typer.Option(help="the service's HTTP address, such as http://HOST:8080")
    ] = None,
    name: Annotated[str | None, typer.Option(help=about("name"))] = None,
    tau_max_ms: Annotated[float | None, typer.Option(help=about("tau_max_ms"))] = None,
    age_max_ms: Annotated[float | None, typer.Option(help=about("age_max_ms"))] = None,
    key_file: Annotated[Path | None, typer.Option(help=about("key_file"))] = None,
    tls: Annotated[Path | None, typer.Option(help=about("tls"))] = None,
    onboard_fallback: Annotated[
        bool | None,
        typer.Option("--onboard-fallback/--no-onboard-fallback", help=about("onboard_fallback")),
    ] = None,
    onboard_target: Annotated[str | None, typer.Option(help=about("onboard_target"))] = None,
    ros_connect: Annotated[str | None, typer.Option(help=about("ros_connect"))] = None,
    ros_flavour: Annotated[Flavour | None, typer.Option(help=about("ros_flavour"))] = None,
    vio_topic: Annotated[
        str | None, typer.Option(help="ROS 2 topic of the robot's VIO (nav_msgs/Odometry)")
    ] = None,
    lidar_topic: Annotated[
        str | None,
        typer.Option(help="ROS 2 topic of a lidar that looks down (sensor_msgs/Range)"),
    ] = None,
    ahead_topic: Annotated[
        str | None,
        typer.Option(help="ROS 2 topic of a lidar that looks ahead (sensor_msgs/Range)"),
    ] = None,
    wait_s: Annotated[float, typer.Option(min=0.1, max=60, help="wait so long for a worker")] = 5.0,
    limit_s: Annotated[
        float,
        typer.Option(min=1, max=600, help="an area that takes longer is at fault"),
    ] = 40.0,
    out: Annotated[Path, typer.Option(help="where the ledger will go")] = Path("RUN"),
    as_json: Annotated[bool, typer.Option("--json", help="print the checks as JSON")] = False,
) -> None:
    """Check a drone before a flight: machine, files, vehicle, odometry, camera, service.

    Nothing moves: the vehicle is asked for its parameters, for the time, and to send what a flight
    needs as often as a flight needs it, which it does until it is switched off; workers are probed,
    a camera runs for three seconds. All at once, in about fifteen seconds; what fails or hangs is a
    line like any other.

    Exit code 0: nothing is at fault. 1: something is.

    Example: drone-client doctor --airframe drone.toml --autopilot udp/0.0.0.0:14540
    """
    settings = load_settings(
        name=name,
        connect=connect,
        tau_max_ms=tau_max_ms,
        age_max_ms=age_max_ms,
        key_file=key_file,
        tls=tls,
        onboard_fallback=onboard_fallback,
        onboard_target=onboard_target,
        ros_connect=ros_connect,
        ros_flavour=ros_flavour,
    )
    topics = _Topics(vio_topic, lidar_topic, ahead_topic)
    areas = {
        "machine": lambda: judge_machine(collect_machine(out), settings.uses_tunnel),
        "files": lambda: check_files(settings, airframe, camera, tuning),
        "vehicle": lambda: _vehicle(autopilot, settings, topics),
        "odometry": lambda: _odometry(settings, topics, tuning),
        "camera": lambda: _camera(source, camera),
        "service": lambda: _service(settings, url, wait_s),
    }
    limits_s = {name: limit_s + (wait_s if name == "service" else 0.0) for name in areas}
    console = Console(stderr=True)
    columns = (SpinnerColumn(), TextColumn("{task.description}"), TimeElapsedColumn())
    with Progress(
        *columns, console=console, disable=not console.is_terminal, transient=True
    ) as bar:
        task = bar.add_task("")
        checks = look_at(
            {name: (look, limits_s[name]) for name, look in areas.items()},
            lambda names: bar.update(task, description=f"looking at {', '.join(names)}"),
        )
    faults = sum(check.finding is Finding.FAULT for check in checks)
    if as_json:
        counts = Counter(check.finding.value for check in checks)
        print(json.dumps({"counts": counts, "checks": [asdict(c) for c in checks]}, indent=2))
    else:
        _show(checks, Console())
    if faults:
        raise typer.Exit(1)


def _vehicle(address: str | None, settings: ClientSettings, topics: _Topics) -> Sequence[Check]:
    if address is None:
        return [unchecked("vehicle", "autopilot", "no --autopilot given")]
    from drone_client.autopilot.choose import open_autopilot
    from drone_client.doctor.vehicle import collect_vehicle, judge_vehicle

    clock = MonotonicClock()
    lidar = replace(topics, vio=None, ahead=None)
    with ExitStack() as stack:
        vehicle = open_autopilot(address, clock)
        stack.callback(vehicle.close)
        odometry = lidar.open(settings, clock)
        if odometry is not None:
            stack.callback(odometry.close)
        facts = collect_vehicle(vehicle, clock, odometry)
        return judge_vehicle(facts, address, feeds_vio=topics.vio is not None)


def _odometry(settings: ClientSettings, topics: _Topics, tuning: Path | None) -> Sequence[Check]:
    clock = MonotonicClock()
    odometry = topics.open(settings, clock)
    if odometry is None:
        return [unchecked("odometry", "topics", "no --vio-topic, --lidar-topic, --ahead-topic")]
    try:
        jump = _vio_jump(settings, tuning)
        facts = collect_odometry(odometry, topics.wanted, clock, jump)
    finally:
        odometry.close()
    return judge_odometry(facts, settings.ros_connect)


def _vio_jump(settings: ClientSettings, tuning: Path | None) -> JumpSettings | None:
    """As tuned; None: as usual, also where the file cannot be read."""
    if tuning is None:
        return None
    try:
        return load_tuning(tuning, flight_settings(settings)).odometry.vio_jump
    except (ClientError, TargetError):  # told among the files
        return None


def _camera(source: str | None, camera: Path | None) -> Sequence[Check]:
    if source is None:
        return [unchecked("camera", "pictures", "no --source given")]
    clock = MonotonicClock()
    return judge_camera_run(collect_camera(open_live(source, clock, camera=camera), clock))


def _service(settings: ClientSettings, url: str | None, wait_s: float) -> Sequence[Check]:
    clock = MonotonicClock()
    http = {} if url is None else collect_http(url)
    target = None if url is None else collect_target(url)
    paths = [collect_path(e) for e in settings.endpoints] if settings.uses_tunnel else []
    link = open_link(settings, clock)
    try:
        facts: ServiceFacts = collect_service(link, settings, clock, wait_s)
        warnings = link_summary(link).get("warnings", ())
    finally:
        link.close()
    # What is said of the certificates stands among the files
    said = () if settings.tls is None else tls_files(settings.tls).warnings
    facts = replace(
        facts,
        http=http,
        target=target,
        paths=tuple(paths),
        link_warnings=tuple(w for w in warnings if w not in said),
    )
    return judge_service(facts, settings, _own_target(settings))


def _own_target(settings: ClientSettings) -> Target | None:
    """Of the drone's own eyes; None: it has none, or they have no file that can be read."""
    if not settings.onboard_fallback:
        return None
    try:
        return load_round_target(settings.onboard_target)
    except TargetError:  # told among the files
        return None


def _show(checks: Sequence[Check], console: Console) -> None:
    table = Table("", "what", "found, and what to do", box=None, pad_edge=False)
    area = ""
    for check in checks:
        if check.area != area:
            area = check.area
            table.add_row("", Text(area, "bold"), "")
        text = Text(check.found)
        if check.advice:
            text.append(f"\n-> {check.advice}", STYLES[check.finding])
        table.add_row(Text(check.finding.value, STYLES[check.finding]), f"  {check.name}", text)
    console.print(table)
    counts = Counter(check.finding for check in checks)
    console.print(", ".join(f"{counts[f]} {f.value}" for f in Finding if counts[f]), markup=False)
