"""``export``: the command around the ONNX export."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated

import typer
from rich.box import SIMPLE
from rich.console import Console
from rich.table import Table

from detector_training.commands.shell import console, one_line_errors
from detector_training.datasets.sample import load_dataset
from detector_training.errors import ExportError
from detector_training.export.export import Exported, Int8, export
from edge_service.detector.onnx_export import OPSET
from edge_service.detector.threads import available_cpus
from target_pose.target import DEFAULT_TARGET, load_round_target


def register(app: typer.Typer) -> None:
    """Add ``export`` to a command line."""
    app.command("export")(export_command)


def export_command(
    weights: Annotated[Path, typer.Argument(help="A weights file, .safetensors.")],
    out: Annotated[Path, typer.Argument(help="The .onnx file to write.")],
    opset: Annotated[int, typer.Option(help="Operator set of ONNX, 13 to 20.")] = OPSET,
    dynamic_batch: Annotated[
        bool, typer.Option("--dynamic-batch", help="Take any number of pictures at once.")
    ] = False,
    check: Annotated[
        Path | None,
        typer.Option(help="Data set to compare on; with --int8 the one that judges it."),
    ] = None,
    int8: Annotated[bool, typer.Option("--int8", help="Quantise; needs --calibrate.")] = False,
    calibrate: Annotated[
        Path | None, typer.Option(help="Data set whose pictures set the ranges of int8.")
    ] = None,
    max_loss: Annotated[
        float, typer.Option(help="Fall of AP50 or recall of a level that int8 may cost.")
    ] = 0.01,
    target: Annotated[
        str, typer.Option(help="Target that the data shows: a name, or the path of a .toml.")
    ] = DEFAULT_TARGET,
    workers: Annotated[int | None, typer.Option(help="CPUs to use; default: all.")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON.")] = False,
) -> None:
    """Write weights as an ONNX file, checked: the same boxes within 1 px, scores within 0.001.

    The input is images (1, 3, H, W), RGB in [0, 1], sides multiples of 32; the outputs are logits
    (1, N, C) and distances (1, N, C, 4) of N cells. Nothing is written when a check fails.

    Example: python -m detector_training export runs/a/weights.safetensors a.onnx --check runs/val
    """
    with one_line_errors():
        if int8 and calibrate is None:
            raise ExportError("--int8 needs pictures to set its ranges by: --calibrate DATA")
        if calibrate is not None and not int8:
            raise ExportError("--calibrate is of use with --int8 alone")
        if int8 and check is None:
            raise ExportError("--int8 is judged on a data set that it was not set by: --check DATA")
        if out.suffix != ".onnx":
            raise ExportError(f"{out}: the file's name must end in .onnx")
        samples = load_dataset(check) if check else ()
        small = Int8(load_dataset(calibrate), samples, max_loss) if calibrate else None
        with console.status("export and check"):
            done = export(
                weights,
                out,
                load_round_target(target),
                opset=opset,
                dynamic_batch=dynamic_batch,
                pictures=samples,
                int8=small,
                threads=workers or available_cpus(),
            )
        if as_json:
            typer.echo(json.dumps(done.as_json(), indent=1))
        else:
            Console().print(_table(done))


def _table(done: Exported) -> Table:
    parity = done.parity
    table = Table(show_header=False, box=SIMPLE)
    table.add_row("file", f"{done.path}, {done.bytes / 1e6:.1f} MB, opset {done.opset}")
    table.add_row("SHA-256", done.sha256)
    table.add_row(
        f"net and {done.runtime} differ by",
        f"{parity.box_px:.2g} px, {parity.score:.2g} of score at most, "
        f"on {parity.pictures} pictures",
    )
    if done.before is not None and done.after is not None:
        for what, ap50 in done.before.ap50.items():
            pairs = (
                (ap50, done.after.ap50[what]),
                (done.before.recall[what], done.after.recall[what]),
            )
            told = ["-" if a is None or b is None else f"{a:.3f} -> {b:.3f}" for a, b in pairs]
            table.add_row(f"int8 {what}", f"AP50 {told[0]}, recall {told[1]}")
    return table
