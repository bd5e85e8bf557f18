"""What is wrong with a data set: every finding with its file and what to do about it.

A finding is *wrong* when training or measuring on it would mislead; else it is a note.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import Any

from detector_training.datasets.conditions import KNOWN_CONDITIONS
from detector_training.datasets.sample import LabelBox, Sample, share_inside
from target_pose.candidate import Box
from target_pose.nesting import nests
from target_pose.rings import is_board
from target_pose.target import Level, Target

DUPLICATE_IOU = 0.8
TINY_PX = 3.0
"""A box with a shorter side is a slip of the mouse, or of a target too far to be seen."""
BORDER_PX = 1.5
"""A box that comes so near the border may have been cut there by whoever labelled it."""


class Kind(StrEnum):
    """What may be wrong."""

    LABEL = "label"
    PICTURE = "picture"
    NESTING = "nesting"
    OUTSIDE = "outside"
    DUPLICATE = "duplicate"
    TINY = "tiny"
    FLAG = "flag"
    NO_LABEL = "no label"
    NO_PICTURE = "no picture"
    TWICE = "twice"
    LEAK = "leak"


@dataclass(frozen=True, slots=True)
class Finding:
    """One thing that somebody should look at."""

    kind: Kind
    file: str
    """The label or picture at fault."""
    text: str
    wrong: bool = True
    sample: int | None = None
    """Index of the picture, where its labels could be read."""
    boxes: tuple[int, ...] = ()
    """Indices of its boxes at fault."""

    def as_json(self) -> dict[str, Any]:
        """The same as plain values."""
        return {"kind": str(self.kind), "file": self.file, "text": self.text, "wrong": self.wrong}


def check_sample(
    sample: Sample, target: Target, flags: Collection[str] = (), index: int | None = None
) -> Iterator[Finding]:
    """What is wrong with the labels of one picture; its pixels are not looked at.

    Args:
        sample: The picture's labels.
        target: Says how the levels nest.
        flags: Conditions that are known besides our own.
        index: Of the sample, for the findings.
    """

    def finding(kind: Kind, text: str, boxes: Sequence[int] = (), wrong: bool = True) -> Finding:
        where = sample.label or str(sample.image)
        if sample.image.name not in where:
            where = f"{where} ({sample.image.name})"
        return Finding(kind, where, text, wrong, index, tuple(boxes))

    size = sample.width, sample.height
    labels = sample.labels
    for i, box in enumerate(labels):
        if share_inside(box.xyxy, size) == 0 and not _is_part_of_one_inside(i, labels, size):
            text = f"{box.level} {_shown(box)} lies outside of its {size[0]}x{size[1]} px"
            yield finding(Kind.OUTSIDE, text, [i])
        side = min(box.xyxy[2] - box.xyxy[0], box.xyxy[3] - box.xyxy[1])
        if side < TINY_PX:
            yield finding(Kind.TINY, f"{box.level} is only {side:.1f} px wide", [i], wrong=False)
    for (i, a), (j, b) in itertools.combinations(enumerate(labels), 2):
        if a.level == b.level and _iou(a, b) > DUPLICATE_IOU:
            yield finding(Kind.DUPLICATE, f"{a.level} is labelled twice at {_shown(a)}", [i, j])
    for boxes, text in _not_nested(labels, target, size):
        yield finding(Kind.NESTING, text, boxes)
    for name in sorted(set(sample.conditions) - KNOWN_CONDITIONS - set(flags)):
        known = "a slip? else say --flag " + name
        yield finding(Kind.FLAG, f"condition {name!r} is not a known one: {known}")


def _not_nested(
    labels: Sequence[LabelBox], target: Target, size: tuple[int, int]
) -> Iterator[tuple[list[int], str]]:
    """Boxes that share a place with one of another level, and nest with none of them."""
    by_level = {level: [i for i, b in enumerate(labels) if b.level == level] for level in Level}
    for outer, inner in itertools.combinations(Level, 2):
        outers = by_level[outer]
        for i in by_level[inner]:
            near = [o for o in outers if _share_centre(labels[o], labels[i])]
            lonely = _without(outers, by_level[inner], labels, size)
            if not near and lonely and len(outers) >= len(by_level[inner]):
                yield [i, *lonely], f"{inner} {_shown(labels[i])} lies in no {outer}"
            elif near and not any(_fits(labels[o], labels[i], target, size) for o in near):
                ratio = target.level_m[outer] / target.level_m[inner]
                o = labels[near[0]]
                yield (
                    [i, near[0]],
                    f"{inner} {_shown(labels[i])} does not nest in {outer} {_shown(o)}: on "
                    f"{target.name} that is {ratio:.2f} times as large, around the same centre",
                )


def _without(
    outers: Sequence[int], inners: Sequence[int], labels: Sequence[LabelBox], size: tuple[int, int]
) -> list[int]:
    """Outer boxes in which no inner one lies, though their centres are in the picture."""
    return [
        o
        for o in outers
        if not any(_share_centre(labels[o], labels[i]) for i in inners)
        and all(
            -0.5 <= (labels[o].xyxy[k] + labels[o].xyxy[k + 2]) / 2 <= size[k] - 0.5 for k in (0, 1)
        )
    ]


def _fits(outer: LabelBox, inner: LabelBox, target: Target, size: tuple[int, int]) -> bool:
    least = target.level_m[outer.level] / target.level_m[inner.level]
    most = least * math.sqrt(2) if is_board(outer.level, target) else least
    if nests(Box(*outer.xyxy, 1.0), Box(*inner.xyxy, 1.0), (least, most), size):
        return True
    if not (_at_border(outer, size) or _at_border(inner, size)):
        return False
    # cut at the border when it was labelled: its true size is not known, but in stays in
    return all(
        a <= b + BORDER_PX
        for a, b in (
            (outer.xyxy[0], inner.xyxy[0]),
            (outer.xyxy[1], inner.xyxy[1]),
            (inner.xyxy[2], outer.xyxy[2]),
            (inner.xyxy[3], outer.xyxy[3]),
        )
    )


def _is_part_of_one_inside(i: int, labels: Sequence[LabelBox], size: tuple[int, int]) -> bool:
    """Whether a box outside of the picture belongs to a target of which the rest is in it."""
    return any(
        other.level != labels[i].level
        and _share_centre(other, labels[i])
        and share_inside(other.xyxy, size) > 0
        for other in labels
    )


def _at_border(box: LabelBox, size: tuple[int, int]) -> bool:
    x0, y0, x1, y1 = box.xyxy
    return min(x0, y0, size[0] - 1 - x1, size[1] - 1 - y1) < BORDER_PX


def _share_centre(a: LabelBox, b: LabelBox) -> bool:
    """Whether the centre of either lies in the other."""
    return any(
        p.xyxy[0] <= (q.xyxy[0] + q.xyxy[2]) / 2 <= p.xyxy[2]
        and p.xyxy[1] <= (q.xyxy[1] + q.xyxy[3]) / 2 <= p.xyxy[3]
        for p, q in ((a, b), (b, a))
    )


def _iou(a: LabelBox, b: LabelBox) -> float:
    width = min(a.xyxy[2], b.xyxy[2]) - max(a.xyxy[0], b.xyxy[0])
    height = min(a.xyxy[3], b.xyxy[3]) - max(a.xyxy[1], b.xyxy[1])
    both = max(width, 0.0) * max(height, 0.0)
    areas = sum((x.xyxy[2] - x.xyxy[0]) * (x.xyxy[3] - x.xyxy[1]) for x in (a, b))
    return both / (areas - both) if areas > both else 0.0


def _shown(box: LabelBox) -> str:
    return "[" + ", ".join(f"{v:.0f}" for v in box.xyxy) + "]"
