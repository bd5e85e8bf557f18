"""The command ``edge-service``."""

from __future__ import annotations

import signal
import sys
from pathlib import Path
from typing import Annotated, NoReturn

import typer
from rich.console import Console
from rich.table import Table

from edge_service.errors import EdgeError, InputError
from edge_service.json_log import configure
from edge_service.settings import PREFIX, EdgeSettings, load_settings
from rgbd_wire.errors import WireError
from target_pose.errors import TargetError

EXIT_NO_TARGET = 1
EXIT_USAGE = 2
MAX_FILE_BYTES = 64_000_000
EXTRA_OF = {"onnx": "onnxruntime", "onnxruntime": "onnxruntime", "openvino": "openvino"}
"""Packages that are not in the extra ``edge``, and the one that brings them."""

app = typer.Typer(
    help="Finds a printed target in RGB-D pictures: for drones over Zenoh or a UDP tunnel, for "
    "people over HTTP.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,  # its tables cut the names of flags on a narrow terminal
)

Target = Annotated[
    str | None, typer.Option(help="Name of a packaged target or path of a target TOML.")
]
Method = Annotated[
    str | None,
    typer.Option(help="fused (default): circles and depth. pnp: points, of any planar target."),
]
Engine = Annotated[
    str | None, typer.Option(help="torch (default), onnxruntime or openvino (extras).")
]
Weights = Annotated[
    Path | None,
    typer.Option(help="Detector weights, .safetensors or .onnx; default: those packaged."),
]
Classes = Annotated[
    str | None, typer.Option(help="Classes of a foreign .onnx: T_good,-,T_best and so on.")
]
ModelCache = Annotated[
    Path | None, typer.Option(help="Folder for converted weights; default: ~/.cache.")
]
Threads = Annotated[int | None, typer.Option(help="Detector threads; default: the CPU quota.")]


def main() -> None:
    """Entry point: errors are one line on stderr and exit code 2."""
    if sys.argv[1:2] == ["serve"]:
        # Loading torch takes seconds, and as PID 1 of a container a process without a handler
        # ignores SIGTERM. Until the service sets its own there is nothing to drain.
        signal.signal(signal.SIGTERM, lambda *_: sys.exit(0))
    try:
        app()
    except (EdgeError, TargetError, WireError) as error:
        _fail(str(error))
    except ModuleNotFoundError as error:
        extra = EXTRA_OF.get(str(error.name), "edge")
        _fail(f"package {error.name} is missing; install aerial-contact[{extra}]")


@app.command(
    epilog="Example: edge-service serve --listen tcp/0.0.0.0:7447 --http 127.0.0.1:8080. "
    "Every flag has a variable, and there are more: edge-service settings."
)
def serve(
    listen: Annotated[
        str | None, typer.Option(help="Zenoh endpoints to listen on, separated by commas.")
    ] = None,
    connect: Annotated[
        str | None, typer.Option(help="Zenoh routers to join instead of listening.")
    ] = None,
    tls: Annotated[
        Path | None, typer.Option(help="Folder of certificates: Zenoh over mutual TLS.")
    ] = None,
    drones: Annotated[
        str | None, typer.Option(help="Drones that may come in over TLS, separated by commas.")
    ] = None,
    udp: Annotated[str | None, typer.Option(help="HOST:PORT of the UDP tunnel.")] = None,
    keys: Annotated[Path | None, typer.Option(help="The drones' keys for the tunnel.")] = None,
    http: Annotated[str | None, typer.Option(help="HOST:PORT of the HTTP side.")] = None,
    name: Annotated[str | None, typer.Option(help="This worker's name.")] = None,
    target: Target = None,
    method: Method = None,
    engine: Engine = None,
    weights: Weights = None,
    classes: Classes = None,
    threads: Threads = None,
    model_cache: ModelCache = None,
    self_check: Annotated[
        str | None,
        typer.Option(help="When no drawn target is found: refuse (default), warn or off."),
    ] = None,
) -> None:
    """Serve drones until SIGTERM or Ctrl-C; both finish what is there, a second one does not."""
    settings = load_settings(
        zenoh_listen=listen,
        zenoh_connect=connect,
        zenoh_tls=tls,
        zenoh_drones=drones,
        udp_listen=udp,
        tunnel_keys=keys,
        http=http,
        name=name,
        target=target,
        method=method,
        engine=engine,
        weights=weights,
        classes=classes,
        threads=threads,
        model_cache=model_cache,
        self_check=self_check,
    )
    configure(settings.log_level)
    from edge_service import process  # loads torch: --help and a wrong flag need not wait for it

    raise typer.Exit(process.serve(settings))


@app.command(
    epilog="Example: edge-service localize color.jpg depth.png --camera camera.json --json"
)
def localize(
    color: Annotated[Path, typer.Argument(help="Colour picture, JPEG or PNG.")],
    depth: Annotated[
        Path | None, typer.Argument(help="Depth picture, 16-bit PNG; may be left out.")
    ] = None,
    *,
    camera: Annotated[Path, typer.Option(help="Camera JSON of both pictures.")],
    json: Annotated[bool, typer.Option("--json", help="Print what POST /v1/localize answers.")] = (
        False
    ),
    draw: Annotated[
        Path | None,
        typer.Option(help="Picture of what was found and how sure it is: .png or .jpg."),
    ] = None,
    target: Target = None,
    method: Method = None,
    engine: Engine = None,
    weights: Weights = None,
    classes: Classes = None,
    threads: Threads = None,
    model_cache: ModelCache = None,
) -> None:
    """Find the target in one picture; exit code 1 when there is none."""
    settings = load_settings(
        target=target,
        method=method,
        engine=engine,
        weights=weights,
        classes=classes,
        threads=threads,
        model_cache=model_cache,
    )
    configure(settings.log_level)
    if draw is not None:
        from edge_service.drawing.files import check_drawing_path

        check_drawing_path(draw)
    color_file, camera_file = _read(color, "color"), _read(camera, "camera")
    depth_file = None if depth is None else _read(depth, "depth")
    from edge_service.handed_in import frame_of_files
    from edge_service.one_frame import draw_frame, localise_frame, report  # loads torch

    frame = frame_of_files(color_file, depth_file, camera_file)
    seen = localise_frame(frame, settings)
    if draw is not None:
        draw_frame(draw, frame, seen)
    if json:
        print(seen.body.model_dump_json(indent=2))
    else:
        _console().print(report(seen.body))
    raise typer.Exit(0 if seen.found else EXIT_NO_TARGET)


@app.command("settings")
def list_settings() -> None:
    """List every EDGE_ variable with its default and what it means."""
    table = Table("variable", "default", "meaning", box=None, pad_edge=False)
    for name, field in EdgeSettings.model_fields.items():
        default = field.get_default(call_default_factory=True)
        table.add_row(
            PREFIX + name.upper(), "" if default is None else str(default), field.description
        )
    _console().print(table)


def _console() -> Console:
    """Without markup: a [m] is a unit."""
    return Console(markup=False, highlight=False)


def _read(path: Path, field: str) -> bytes:
    try:
        with path.open("rb") as file:
            data = file.read(MAX_FILE_BYTES + 1)
    except OSError as error:
        raise InputError(field, f"{path}: {error.strerror}") from None
    if len(data) > MAX_FILE_BYTES:
        raise InputError(field, f"{path}: over {MAX_FILE_BYTES // 1_000_000} MB")
    return data


def _fail(sentence: str) -> NoReturn:
    print(f"edge-service: {sentence}", file=sys.stderr)
    sys.exit(EXIT_USAGE)
