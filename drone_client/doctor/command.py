"""``drone-client doctor``: what is wrong before a flight, and what to change."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import asdict, replace
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.progress import Progress, SpinnerColumn, TextColumn, TimeElapsedColumn
from rich.table import Table
from rich.text import Text

from drone_client.doctor.camera import collect_camera, judge_camera_run
from drone_client.doctor.files import check_files
from drone_client.doctor.finding import Check, Finding, judged, unchecked
from drone_client.doctor.machine import collect_machine, judge_machine
from drone_client.doctor.service import ServiceFacts, collect_http, collect_service, judge_service
from drone_client.errors import ClientError
from drone_client.link.choose import open_link
from drone_client.settings import ClientSettings, about, load_settings
from drone_client.source.choose import open_live
from rgbd_wire.clock import MonotonicClock
from rgbd_wire.errors import WireError

STYLES = {
    Finding.OK: "green",
    Finding.WARNING: "yellow",
    Finding.FAULT: "bold red",
    Finding.UNCHECKED: "dim",
}


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
    wait_s: Annotated[float, typer.Option(min=0.1, max=60, help="wait so long for a worker")] = 5.0,
    out: Annotated[Path, typer.Option(help="where the ledger will go")] = Path("RUN"),
    as_json: Annotated[bool, typer.Option("--json", help="print the checks as JSON")] = False,
) -> None:
    """Check a drone before a flight: machine, files, vehicle, camera, service.

    Nothing moves and nothing is changed: the vehicle is listened to and asked for its parameters,
    workers are probed, a camera runs for three seconds. All at once, in about fifteen seconds.

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
    )
    console = Console(stderr=True)
    columns = (SpinnerColumn(), TextColumn("{task.description}"), TimeElapsedColumn())
    with (
        Progress(*columns, console=console, disable=not console.is_terminal, transient=True) as bar,
        ThreadPoolExecutor() as pool,
    ):
        parts: dict[str, Future[Sequence[Check]]] = {
            "machine": pool.submit(
                lambda: judge_machine(collect_machine(out), settings.uses_tunnel)
            ),
            "files": pool.submit(check_files, settings, airframe, camera, tuning),
            "vehicle": pool.submit(_vehicle, autopilot),
            "camera": pool.submit(_camera, source, camera),
            "service": pool.submit(_service, settings, url, wait_s),
        }
        task = bar.add_task("")
        checks: list[Check] = []
        for area, future in parts.items():
            bar.update(task, description=f"looking at the {area}")
            try:
                checks += future.result()
            except (ClientError, WireError) as error:
                line = " ".join(str(error).split())
                checks.append(judged(area, area, Finding.FAULT, line, "correct it as it says"))
    faults = sum(check.finding is Finding.FAULT for check in checks)
    if as_json:
        counts = Counter(check.finding.value for check in checks)
        print(json.dumps({"counts": counts, "checks": [asdict(c) for c in checks]}, indent=2))
    else:
        _show(checks, Console())
    if faults:
        raise typer.Exit(1)


def _vehicle(address: str | None) -> Sequence[Check]:
    if address is None:
        return [unchecked("vehicle", "autopilot", "no --autopilot given")]
    from drone_client.autopilot.choose import open_autopilot
    from drone_client.doctor.vehicle import collect_vehicle, judge_vehicle

    clock = MonotonicClock()
    vehicle = open_autopilot(address, clock)
    try:
        is_px4 = not address.startswith("ardupilot+")
        return judge_vehicle(collect_vehicle(vehicle, clock, is_px4), address)
    finally:
        vehicle.close()


def _camera(source: str | None, camera: Path | None) -> Sequence[Check]:
    if source is None:
        return [unchecked("camera", "pictures", "no --source given")]
    clock = MonotonicClock()
    return judge_camera_run(collect_camera(open_live(source, clock, camera=camera), clock))


def _service(settings: ClientSettings, url: str | None, wait_s: float) -> Sequence[Check]:
    clock = MonotonicClock()
    http = {} if url is None else collect_http(url)
    link = open_link(settings, clock)
    try:
        facts: ServiceFacts = collect_service(link, settings, clock, wait_s)
    finally:
        link.close()
    return judge_service(replace(facts, http=http), settings)


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
