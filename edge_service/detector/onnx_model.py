"""What an ONNX model is: ours by its metadata, a foreign one by the shape of its answer."""

from __future__ import annotations

from typing import TYPE_CHECKING

from edge_service.detector.detector import Model
from edge_service.detector.grid import SIZE_MULTIPLE_PX, STRIDES
from edge_service.detector.layouts import (
    CellLayout,
    EndToEndLayout,
    KeyPoints,
    Layout,
    Outputs,
    YoloLayout,
)
from edge_service.errors import WeightsError
from target_pose.target import Level

if TYPE_CHECKING:
    from edge_service.detector.onnx_file import OnnxFile

OUTPUTS = ("logits", "distances")
"""What our export calls its outputs."""
EXPORT_VERSION = "1"
IGNORED = "-"
"""In a list of classes: one that is no level of the target."""

_LEVELS = tuple(level.value for level in Level)
_READ = (
    "read are (1, 4 + classes, N) as YOLOv8 and v11 export it, and (1, N, 6) of models that "
    "suppress by themselves; with 3 more for each of the target's [[points]] of pose exports"
)


def model_of(file: OnnxFile, outputs: Outputs, classes: str | None, points: int = 0) -> Model:
    """How to read a model's answers.

    Args:
        file: of which it was loaded.
        outputs: its answer to one picture; the shapes count.
        classes: names of a foreign model's classes in their order, separated by commas; None:
            its metadata have them.
        points: labelled points that the target has.

    Raises:
        WeightsError: its outputs fit no layout, its classes are not known, or its key points are
            not as many as the target's points.
    """
    if file.is_ours:
        return _own(file, outputs)
    layout = _foreign_layout(file, outputs, classes, points)
    facts = {"weights_version": None, "parameters": file.parameters}
    return Model(file.path.stem, None, file.sha256, layout, file.size, facts)


def _own(file: OnnxFile, outputs: Outputs) -> Model:
    told = file.metadata
    where = f"weights {file.path}"
    wanted = {
        "export_version": EXPORT_VERSION,
        "classes": ",".join(_LEVELS),
        "strides": ",".join(map(str, STRIDES)),
    }
    for field, value in wanted.items():
        if told.get(field) != value:
            raise WeightsError(
                f"{where}: {field} {told.get(field)!r}, this program reads {value!r}; "
                "export it anew with `python -m detector_training export`"
            )
    shapes = [o.shape for o in outputs]
    n, c = (shapes[0][1], len(_LEVELS)) if shapes and len(shapes[0]) == 3 else (0, 0)
    if file.outputs != OUTPUTS or shapes != [(1, n, c), (1, n, c, 4)] or file.size is not None:
        raise WeightsError(
            f"{where}: outputs {dict(zip(file.outputs, shapes, strict=False))} "
            "are not those of our export"
        )
    facts = {
        "weights_version": told.get("weights_version"),
        "weights_sha256": told.get("weights_sha256"),
        "parameters": file.parameters,
        "width": int(told["width"]) if told.get("width", "").isdigit() else None,
    }
    layout = CellLayout(tuple(Level))
    return Model(file.path.stem, told.get("target"), file.sha256, layout, None, facts)


def _foreign_layout(file: OnnxFile, outputs: Outputs, classes: str | None, points: int) -> Layout:
    shapes = [tuple(o.shape) for o in outputs]
    where = f"weights {file.path}"
    if len(shapes) != 1 or len(shapes[0]) != 3 or shapes[0][0] != 1:
        raise WeightsError(f"{where}: outputs of shapes {shapes} are not known; {_READ}")
    if file.size is not None and any(side % SIZE_MULTIPLE_PX for side in file.size):
        raise WeightsError(f"{where}: sides {file.size} are no multiples of {SIZE_MULTIPLE_PX} px")
    names = _names(file, classes)
    columns = {Level(name): k for k, name in enumerate(names) if name in _LEVELS}
    if not columns or len(columns) != sum(name in _LEVELS for name in names):
        raise WeightsError(
            f"{where}: classes {', '.join(names)[:200]!r}; each of {', '.join(_LEVELS)} at most "
            "once and one of them at least: say which is which with --classes "
            f"(EDGE_CLASSES), in the model's order, {IGNORED!r} for any other"
        )
    _, rows, width = shapes[0]
    told = file.key_points
    if told is not None and told[0] != points:
        raise WeightsError(f"{where}: {_mismatch(told[0], points)}")
    # without metadata: a box alone, or points with and without a confidence
    for numbers in (0, 3, 2) if told is None else (told[1],):
        more = numbers * points
        if rows == 4 + len(names) + more:
            return YoloLayout(columns, key_points=_key_points(4 + len(names), points, numbers))
        if width == 6 + more:
            return EndToEndLayout(columns, key_points=_key_points(6, points, numbers))
    hint = "; this looks like YOLOv5's, with objectness" if width == 5 + len(names) else ""
    seen, rest = divmod(rows - 4 - len(names), 3)
    if not hint and seen > 0 and not rest:
        hint = f"; this looks like {_mismatch(seen, points)}"
    raise WeightsError(
        f"{where}: output of shape {shapes[0]} with {len(names)} classes is not known{hint}; "
        f"{_READ}"
    )


def _key_points(first: int, count: int, numbers: int) -> KeyPoints | None:
    return KeyPoints(first, count, numbers) if count and numbers else None


def _mismatch(seen: int, points: int) -> str:
    has = f"{points} [[points]]" if points else "no [[points]]"
    return f"{seen} key points a box, and the target has {has}: number and order must be the same"


def _names(file: OnnxFile, classes: str | None) -> tuple[str, ...]:
    if classes is not None:
        return tuple(name.strip() for name in classes.split(","))
    if names := file.class_names:
        return names
    raise WeightsError(
        f"weights {file.path}: a foreign model without metadata names: give its classes in their "
        f"order with --classes (EDGE_CLASSES), such as --classes {','.join(_LEVELS)}"
    )
