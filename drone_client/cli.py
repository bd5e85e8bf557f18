"""The ``drone-client`` command."""

from __future__ import annotations

import json
import signal
import sys
from collections.abc import Iterator
from contextlib import ExitStack
from functools import partial
from pathlib import Path
from types import FrameType
from typing import Annotated, Any

import cv2
import typer
from rich.console import Console
from rich.markup import escape
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn
from rich.table import Table
from rich.text import Text

from drone_client.airframe import Airframe, load_airframe
from drone_client.calibration.command import calibrate
from drone_client.doctor.command import doctor
from drone_client.errors import ClientError
from drone_client.fly.command import fly
from drone_client.link.choose import link_summary, open_link
from drone_client.replay import ReplayOptions
from drone_client.replay import replay as run_replay
from drone_client.ros.names import Flavour
from drone_client.ros.publish import open_ros, publish_accepted
from drone_client.run_files import LEDGER_NAME, PLOT_NAME, SUMMARY_NAME
from drone_client.settings import ClientSettings, about, known_name, load_settings
from drone_client.source.bag import BagOptions
from drone_client.source.choose import open_recorded
from drone_client.source.record_command import record
from drone_client.summary_table import print_summary
from drone_client.tally import Tally
from drone_client.truth import load_truth
from drone_client.viewing.command import log
from rgbd_wire.clock import MonotonicClock
from rgbd_wire.errors import WireError
from rgbd_wire.messages import Outcome
from target_pose.errors import TargetError

app = typer.Typer(
    help="The onboard side: frames up, fresh target poses down, safe velocity commands out.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    add_completion=False,
    rich_markup_mode=None,  # at 80 columns its tables cut the names of flags
    epilog="Every setting can come from the environment: "
    + ", ".join(known_name(field) for field in ClientSettings.model_fields),
)
_errors = Console(stderr=True)
EXIT_NO_TARGET = 1


@app.command(no_args_is_help=True)
def replay(
    recording: Annotated[
        str,
        typer.Argument(
            help="folder in TUM RGB-D layout (rgb.txt, depth.txt, groundtruth.txt), ROS 2 bag "
            "(folder, .db3), .mcap, or ROS 1 .bag"
        ),
    ],
    camera: Annotated[
        Path | None,
        typer.Option(
            help="camera JSON; without it FOLDER/camera.json, or what the bag says",
            show_default=False,
        ),
    ] = None,
    color_topic: Annotated[
        str | None, typer.Option(help="of a bag; without it the only one", show_default=False)
    ] = None,
    depth_topic: Annotated[
        str | None, typer.Option(help="of a bag; without it the only one", show_default=False)
    ] = None,
    pose_topic: Annotated[
        str | None,
        typer.Option(
            help="of a bag: Odometry, PoseStamped, or tf:WORLD:BODY; goes with --airframe",
            show_default=False,
        ),
    ] = None,
    connect: Annotated[str | None, typer.Option(help=about("connect"))] = None,
    out: Annotated[Path, typer.Option(help="folder for ledger, summary and plot")] = Path("RUN"),
    name: Annotated[str | None, typer.Option(help=about("name"))] = None,
    tau_max_ms: Annotated[float | None, typer.Option(help=about("tau_max_ms"))] = None,
    age_max_ms: Annotated[float | None, typer.Option(help=about("age_max_ms"))] = None,
    window: Annotated[int | None, typer.Option(help=about("window"))] = None,
    jpeg_quality: Annotated[int | None, typer.Option(help=about("jpeg_quality"))] = None,
    wait_for_worker_s: Annotated[
        float | None, typer.Option(help=about("wait_for_worker_s"))
    ] = None,
    key_file: Annotated[Path | None, typer.Option(help=about("key_file"))] = None,
    tls: Annotated[Path | None, typer.Option(help=about("tls"))] = None,
    rate_control: Annotated[
        bool | None, typer.Option("--rate-control/--no-rate-control", help=about("rate_control"))
    ] = None,
    hedge: Annotated[bool | None, typer.Option("--hedge/--no-hedge", help=about("hedge"))] = None,
    onboard_fallback: Annotated[
        bool | None,
        typer.Option("--onboard-fallback/--no-onboard-fallback", help=about("onboard_fallback")),
    ] = None,
    onboard_target: Annotated[str | None, typer.Option(help=about("onboard_target"))] = None,
    onboard_max_s: Annotated[float | None, typer.Option(help=about("onboard_max_s"))] = None,
    onboard_growth_mm_s: Annotated[
        float | None, typer.Option(help=about("onboard_growth_mm_s"))
    ] = None,
    ros_topic: Annotated[str | None, typer.Option(help=about("ros_topic"))] = None,
    ros_connect: Annotated[str | None, typer.Option(help=about("ros_connect"))] = None,
    ros_flavour: Annotated[Flavour | None, typer.Option(help=about("ros_flavour"))] = None,
    airframe: Annotated[
        Path | None, typer.Option(help="TOML with body_from_camera and body_from_tip")
    ] = None,
    truth: Annotated[
        Path | None, typer.Option(help="JSON with the true poses: errors go into the summary")
    ] = None,
    as_fast_as_possible: Annotated[
        bool,
        typer.Option(
            "--as-fast-as-possible", help="each frame after the last one's answer: none is left out"
        ),
    ] = False,
    as_json: Annotated[bool, typer.Option("--json", help="print the summary as JSON")] = False,
    plot: Annotated[
        bool, typer.Option("--plot/--no-plot", help="draw run.png beside the ledger")
    ] = True,
    overwrite: Annotated[
        bool, typer.Option("--overwrite", help="an earlier run in the same folder may go")
    ] = False,
) -> None:
    """Play a recording through the whole chain, as if it were flown now.

    Frames go to a worker, results come back through the delay gate, the target feeds guidance and
    the safety filter, and an autopilot in memory takes the commands. The folder of --out gets
    ledger.jsonl with one line for every frame, ticks.jsonl, events.jsonl, summary.json and run.png;
    with --onboard-fallback also onboard.jsonl, with one line for every frame that came while no
    fresh result was left.

    Example: drone-client replay examples/recordings/rendered-approach --connect tcp/127.0.0.1:7447
    """
    settings = load_settings(
        name=name,
        connect=connect,
        tau_max_ms=tau_max_ms,
        age_max_ms=age_max_ms,
        window=window,
        jpeg_quality=jpeg_quality,
        wait_for_worker_s=wait_for_worker_s,
        key_file=key_file,
        tls=tls,
        rate_control=rate_control,
        hedge=hedge,
        onboard_fallback=onboard_fallback,
        onboard_target=onboard_target,
        onboard_max_s=onboard_max_s,
        onboard_growth_mm_s=onboard_growth_mm_s,
        ros_topic=ros_topic,
        ros_connect=ros_connect,
        ros_flavour=ros_flavour,
    )
    body = Airframe() if airframe is None else load_airframe(airframe)
    topics = BagOptions(color_topic, depth_topic, pose_topic)
    source = open_recorded(recording, camera, body, topics)
    entries = () if truth is None else load_truth(truth, len(source))
    options = ReplayOptions(out, as_fast_as_possible, entries, plot, overwrite)
    clock = MonotonicClock()
    title = escape(Path(recording).resolve().name)
    with _progress() as progress:
        task = progress.add_task("waiting for a worker", total=len(source), counts="")

        def on_progress(done: int, tally: Tally) -> None:
            accepted = tally.verdicts["accepted"]
            refused = sum(tally.verdicts.values()) - accepted
            counts = f"{accepted} accepted, {refused} refused, {tally.outcomes['target']} targets"
            if settings.onboard_fallback:
                counts += f", {tally.onboard} seen on board"
            progress.update(task, completed=done, description=title, counts=counts)

        with ExitStack() as stack:
            link = open_link(settings, clock)
            stack.callback(link.close)
            for warning in link_summary(link).get("warnings", ()):
                _errors.print(f"warning: {warning}", style="yellow", markup=False, soft_wrap=True)
            ros = open_ros(settings, clock)
            if ros is not None:
                stack.callback(ros.close)
            summary = run_replay(
                source,
                body,
                settings,
                options,
                link,
                clock,
                on_progress,
                (lambda reception: None) if ros is None else partial(publish_accepted, ros),
            )
    for note in source.notes:
        _errors.print(f"warning: {note}", style="yellow", markup=False, soft_wrap=True)
    if as_json:
        print(json.dumps(summary, indent=2))
    else:
        print_summary(summary)
        files = [LEDGER_NAME, SUMMARY_NAME, *([PLOT_NAME] if options.plot else [])]
        written = ", ".join(str(options.out / f) for f in files)
        Console().print(f"written: {written}", markup=False, soft_wrap=True)
    if summary["unwritten"]:
        raise typer.Exit(2)
    if summary["interrupted"]:
        raise typer.Exit(130)


@app.command(no_args_is_help=True)
def snap(
    color: Annotated[Path, typer.Argument(help="colour picture, JPEG or PNG")],
    depth: Annotated[Path | None, typer.Argument(help="depth picture, 16-bit PNG")] = None,
    camera: Annotated[Path, typer.Option(help="camera JSON")] = Path("camera.json"),
    url: Annotated[str, typer.Option(help="the service's HTTP address")] = "http://127.0.0.1:8080",
    timeout_s: Annotated[float, typer.Option(min=0.1, max=600, help="give up after this")] = 10.0,
    as_json: Annotated[bool, typer.Option("--json", help="print the answer as JSON")] = False,
) -> None:
    """Ask a service over HTTP where the target is in one picture.

    Exit code 1 when there is none.

    Example: drone-client snap color.jpg depth.png --camera camera.json
    """
    from drone_client.snap import snap as ask  # httpx comes with the extra "drone"

    answer = ask(url, color, depth, camera, timeout_s)
    if as_json:
        print(json.dumps(answer, indent=2))
    else:
        table = Table("", "", title=Text(color.name), show_header=False)
        for key, value in _leaves(answer):
            table.add_row(Text(key), Text(value))
        Console().print(table)
    if answer.get("outcome") != Outcome.TARGET.value:
        raise typer.Exit(EXIT_NO_TARGET)


app.command(no_args_is_help=True)(fly)
app.command()(doctor)
app.command(no_args_is_help=True)(calibrate)
app.command(no_args_is_help=True)(record)
app.command(no_args_is_help=True)(log)


def _leaves(value: Any, key: str = "") -> Iterator[tuple[str, str]]:
    """Each number, text and list of them in an answer by its path, short enough to read.

    Matrices repeat what stands in other fields or are for programs: --json has them.
    """
    if isinstance(value, dict):
        for name, inner in value.items():
            yield from _leaves(inner, f"{key}.{name}" if key else name)
    elif isinstance(value, list) and value and isinstance(value[0], dict | list):
        if isinstance(value[0], dict):
            for number, inner in enumerate(value):
                yield from _leaves(inner, f"{key}[{number}]")
    elif isinstance(value, list):
        yield key, ", ".join(_short(v) for v in value)
    else:
        yield key, _short(value)


def _short(value: object) -> str:
    return f"{value:.6g}" if isinstance(value, float) else str(value)


def main() -> None:
    """Run the command; a user's mistake ends in one line and exit code 2, never a traceback."""
    for sign in (signal.SIGINT, signal.SIGTERM):  # a script's background job is born deaf to SIGINT
        signal.signal(sign, _interrupt)
    cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)  # the one line is ours
    try:
        app(standalone_mode=True)
    except (ClientError, WireError, TargetError) as error:
        line = " ".join(str(error).split())
        _errors.print(f"drone-client: {line}", style="red", markup=False, soft_wrap=True)
        sys.exit(2)
    except ModuleNotFoundError as error:
        _errors.print(
            f"drone-client: package {error.name} is missing; install aerial-contact[drone]",
            markup=False,
            soft_wrap=True,
        )
        sys.exit(2)
    except KeyboardInterrupt:
        sys.exit(130)


def _interrupt(_signal: int, _frame: FrameType | None) -> None:
    """Either signal ends a run with a whole ledger."""
    raise KeyboardInterrupt


def _progress() -> Progress:
    return Progress(
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TextColumn("{task.fields[counts]}"),
        TimeElapsedColumn(),
        console=_errors,
        disable=not _errors.is_terminal,
    )


if __name__ == "__main__":
    main()
