"""``train``: the command around the loop, from scratch or from weights that stand."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated, Any, Literal

import torch
import typer
from rich.console import Console

from detector_training.commands.evaluate import AP_SCORE_THRESHOLD, SHORT
from detector_training.commands.shell import command_line, one_line_errors
from detector_training.commands.train_shell import progress, stop_when_asked
from detector_training.datasets.names import LabelNames
from detector_training.datasets.output import write_file
from detector_training.datasets.sample import Sample, load_dataset
from detector_training.datasets.sheet import write_png
from detector_training.errors import TrainingError
from detector_training.evaluation.report import share_text
from detector_training.evaluation.run import run_detector
from detector_training.evaluation.scores import ALL, CANDIDATE, Report, score
from detector_training.training import loop as training
from detector_training.training import settings as defaults
from detector_training.training.pictures import draw_finds
from detector_training.training.plot import plot_log
from detector_training.training.summary import count_boxes, summarise
from edge_service.detector.engine import TorchDetector
from edge_service.detector.files import DEFAULT_WEIGHTS
from edge_service.detector.threads import available_cpus
from edge_service.detector.weights import load_weights
from target_pose.target import DEFAULT_TARGET, load_round_target

SHIPPED = "shipped"
DEVICES = ("auto", "cpu", "cuda")


def register(app: typer.Typer) -> None:
    """Add ``train`` to a command line."""
    app.command("train")(train)


def train(
    data: Annotated[
        Path,
        typer.Argument(help="Data set: labels.jsonl, labelme, YOLO or COCO; recognised by itself."),
    ],
    out: Annotated[Path, typer.Option("--out", help="Folder of the run.")],
    start: Annotated[
        str | None,
        typer.Option(
            "--from",
            help="Fine-tune: the weights file to start from, or 'shipped' for the packaged one.",
        ),
    ] = None,
    mix: Annotated[
        Path | None,
        typer.Option(help="With --from: another data set (scenes), so that nothing is forgotten."),
    ] = None,
    mix_share: Annotated[
        float, typer.Option(help="Share of the crops that come from --mix.")
    ] = defaults.MIX_SHARE,
    val: Annotated[
        Path | None,
        typer.Option("--val", help="Data set to score on the way and at the end; keeps the best."),
    ] = None,
    val_pictures: Annotated[
        int, typer.Option(help="Pictures of --val to score on the way; at the end: all.")
    ] = defaults.VAL_PICTURES,
    validations: Annotated[int, typer.Option(help="How often on the way.")] = defaults.VALIDATIONS,
    patience: Annotated[
        int | None, typer.Option(help="Stop after so many scores on --val without a better one.")
    ] = None,
    minutes: Annotated[float | None, typer.Option(help="Length of the run by the clock.")] = None,
    epochs: Annotated[
        int | None, typer.Option(help="Length in pictures seen, as a multiple of DATA's.")
    ] = None,
    pictures: Annotated[
        int | None,
        typer.Option(
            help=f"Length in pictures seen. Default: {defaults.PICTURES} from scratch, "
            f"{defaults.FINE_TUNE_PICTURES} with --from."
        ),
    ] = None,
    seed: Annotated[int, typer.Option(help="Seed of everything left to chance.")] = 0,
    learning_rate: Annotated[
        float | None,
        typer.Option(
            help=f"Highest learning rate. Default: {defaults.LEARNING_RATE:g} from scratch, "
            f"{defaults.FINE_TUNE_LEARNING_RATE:g} with --from."
        ),
    ] = None,
    keep_norms: Annotated[
        bool | None,
        typer.Option(
            "--keep-norms/--learn-norms",
            help="Keep the statistics of the norm layers; few pictures give bad ones. "
            "Default: kept with --from.",
        ),
    ] = None,
    workers: Annotated[int | None, typer.Option(help="CPUs to use; default: all.")] = None,
    device: Annotated[
        str, typer.Option(help=f"{', '.join(DEVICES)}: auto takes a GPU when there is one.")
    ] = "auto",
    target: Annotated[
        str | None,
        typer.Option(
            help=f"Target that the data shows, or the path of your own .toml. Default: that of "
            f"the weights given, else {DEFAULT_TARGET}."
        ),
    ] = None,
    maps: Annotated[
        list[str] | None,
        typer.Option("--map", help="NAME=LEVEL: what another name of a label means; repeatable."),
    ] = None,
    ignores: Annotated[
        list[str] | None,
        typer.Option("--ignore", help="Name of labels to leave out; repeatable."),
    ] = None,
    resume: Annotated[bool, typer.Option("--resume", help="Go on with the run in --out.")] = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON at the end.")] = False,
) -> None:
    """Train the detector on a data set, or fine-tune weights on 20 to 50 pictures of a site.

    --out gets weights.safetensors (the best on --val, else the last), last.safetensors, log.csv,
    loss.png, crops.png (what is taught: look at it first), val.png and evaluation.json. Ctrl-C or a
    kill leaves a run that goes on with the same command and --resume.

    Example: python -m detector_training train my-site --from shipped --mix runs/scenes --out runs/a
    """
    with one_line_errors(_advice()):
        console = Console(stderr=as_json)
        names = LabelNames.parse(maps or (), ignores or ())
        if mix is not None and start is None:
            raise TrainingError("--mix goes with --from; from scratch put all pictures into DATA")
        if patience is not None and val is None:
            raise TrainingError("--patience waits for better scores on --val; give one")
        net = info = None
        if start is not None:
            net, info = load_weights(DEFAULT_WEIGHTS if start == SHIPPED else Path(start))
        tuned = net is not None
        if minutes is None and epochs is None and pictures is None:
            pictures = defaults.FINE_TUNE_PICTURES if tuned else defaults.PICTURES
        if learning_rate is None:
            learning_rate = defaults.FINE_TUNE_LEARNING_RATE if tuned else defaults.LEARNING_RATE
        settings = training.TrainSettings(
            minutes,
            epochs,
            seed,
            pictures=pictures,
            width=defaults.WIDTH if net is None else net.config.width,
            learning_rate=learning_rate,
            warm_up_steps=defaults.FINE_TUNE_WARM_UP_STEPS if tuned else defaults.WARM_UP_STEPS,
            keep_norms=tuned if keep_norms is None else keep_norms,
            mix_share=0.0 if mix is None else mix_share,
            target=target or (info.target if info is not None else DEFAULT_TARGET),
            workers=available_cpus() if workers is None else workers,
            device=_place(device),
            validations=validations,
            val_pictures=val_pictures,
            patience=patience,
        )
        load_round_target(settings.target)
        samples = load_dataset(data, names)
        sets = training.Sets(
            net,
            load_dataset(mix, names) if mix is not None else (),
            load_dataset(val, names) if val is not None else (),
        )
        _introduce(console, samples, sets, settings, out)
        with progress(console) as report, stop_when_asked() as stop:
            weights = training.train(
                samples, out, settings, sets=sets, resume=resume, report=report, stop=stop
            )
        plot_log(out / training.LOG, out / "loss.png")
        result: dict[str, Any] = {"weights": str(weights)}
        if sets.val:
            scores = _evaluate(weights, sets.val, settings, out)
            result["evaluation"] = scores.as_json()
            _say_scores(console, scores)
        console.print(f"weights: {weights}; how it went: {out / 'loss.png'}", soft_wrap=True)
        if as_json:
            typer.echo(json.dumps(result, indent=1))


def _introduce(
    console: Console,
    samples: tuple[Sample, ...],
    sets: training.Sets,
    settings: training.TrainSettings,
    out: Path,
) -> None:
    """Say what will be done, before it takes its time."""
    summary = summarise(samples)
    console.print(str(summary), soft_wrap=True, markup=False)
    elsewhere = count_boxes(sets.mixed).missing
    if unlearned := set(summary.missing) & set(elsewhere):
        console.print(
            f"warning: no box of {', '.join(sorted(unlearned))}: the net will not know that level; "
            "label it" + (", or --mix scenes that show it" if sets.start is not None else ""),
            style="yellow",
            soft_wrap=True,
        )
    seen = settings.length(len(samples))
    how_long = f"{settings.minutes:g} minutes" if seen is None else f"{seen} pictures seen"
    mixed = f", {settings.mix_share:.0%} of them of {len(sets.mixed)} others" if sets.mixed else ""
    kind = "from scratch" if sets.start is None else "fine-tuning"
    console.print(
        f"{kind} for {how_long}{mixed}, rate {settings.learning_rate:g}, on {settings.device} with "
        f"{settings.workers} workers; look at {out / training.CROPS}: it shows what is taught",
        soft_wrap=True,
        markup=False,
    )


def _evaluate(
    weights: Path, samples: tuple[Sample, ...], settings: training.TrainSettings, out: Path
) -> Report:
    """Score the weights that were kept on the whole set; leave the numbers and a picture."""
    detector = TorchDetector(
        weights,
        threads=settings.workers,
        score_threshold=AP_SCORE_THRESHOLD,
        device=settings.device,
    )
    finds = run_detector(detector.detect, samples, load_round_target(settings.target))
    write_png(out / "val.png", draw_finds(finds))
    scores = score(finds)
    write_file(out / "evaluation.json", json.dumps(scores.as_json(), indent=1) + "\n")
    return scores


def _say_scores(console: Console, scores: Report) -> None:
    """The whole in a few lines; `evaluate` prints all of it."""
    rows = scores.rows[ALL]
    found = rows[CANDIDATE]
    precision = ", ".join(
        f"{what} {row.ap50_95.value:.3f}"
        for what, row in rows.items()
        if what != CANDIDATE and row.ap50_95 is not None
    )
    console.print(
        f"--val, {scores.pictures} pictures: recall of whole targets "
        f"{share_text(found.recall, SHORT)} (95 %), false {found.false_per_picture:.4f} a picture; "
        f"AP50-95 {precision}\nlook at val.png; for all numbers: "
        "python -m detector_training evaluate RUN VAL --out REPORT",
        soft_wrap=True,
        markup=False,
        highlight=False,
    )


def _place(device: str) -> Literal["cpu", "cuda"]:
    if device not in DEVICES:
        raise TrainingError(f"--device {device!r} is not one of {', '.join(DEVICES)}")
    has_gpu = torch.cuda.is_available()
    if device == "cuda" and not has_gpu:
        raise TrainingError("--device cuda: torch sees no GPU here; cpu or auto works")
    return "cuda" if has_gpu and device != "cpu" else "cpu"


def _advice() -> str:
    line = command_line()
    return f"stopped; go on with: {line}{'' if '--resume' in line else ' --resume'}"
