"""A look at a whole data set: its labels, its pictures, and what it shares with another one."""

from __future__ import annotations

import os
from collections.abc import Callable, Collection, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from detector_training.datasets.check import Finding, Kind, check_sample
from detector_training.datasets.files import is_file, walk
from detector_training.datasets.fingerprint import Look, digest, look_of, nearest_alike
from detector_training.datasets.header import SUFFIXES
from detector_training.datasets.load import Format, Found, read_entries, recognise
from detector_training.datasets.names import LabelNames
from detector_training.datasets.sample import Sample, decode_image, read_bytes
from detector_training.datasets.yolo import labels_without_picture
from detector_training.errors import DatasetError
from target_pose.target import Target

MAX_COMPARED = 30_000
"""Pictures of a data set whose looks are compared with each of another's: half a minute."""

OnProgress = Callable[[int, int], None]
"""Called with the number of pictures done, and of all."""


@dataclass(frozen=True, slots=True)
class Report:
    """What was found."""

    path: Path
    format: Format
    samples: tuple[Sample, ...]
    """Those whose labels can be read."""
    findings: tuple[Finding, ...]

    @property
    def wrong(self) -> int:
        """Number of findings that are more than notes."""
        return sum(f.wrong for f in self.findings)

    def as_json(self) -> dict[str, Any]:
        """The same as plain values."""
        return {
            "path": str(self.path),
            "format": str(self.format),
            "pictures": len(self.samples),
            "wrong": self.wrong,
            "findings": [f.as_json() for f in self.findings],
        }


@dataclass
class _Pictures:
    """What the pixels of a data set say."""

    digests: list[str | None] = field(default_factory=list)
    looks: list[Look | None] = field(default_factory=list)
    findings: list[Finding] = field(default_factory=list)


def inspect_dataset(
    path: Path,
    target: Target,
    names: LabelNames | None = None,
    flags: Collection[str] = (),
    against: Path | None = None,
    on_progress: OnProgress = lambda done, total: None,
) -> Report:
    """Check labels and pictures of a data set.

    Args:
        path: The data set.
        target: Says how the levels nest.
        names: What its labels mean.
        flags: Conditions that are known besides our own.
        against: Another data set that must not share a picture with it.
        on_progress: Told of every picture read.

    Raises:
        DatasetError: there is no data set, or a file that describes all of it cannot be read.
    """
    found = recognise(path)
    entries = list(read_entries(found, names or LabelNames()))
    samples = tuple(e for e in entries if isinstance(e, Sample))
    findings = [
        Finding(Kind.LABEL, *_place_and_text(e)) for e in entries if isinstance(e, DatasetError)
    ]
    if not entries:
        findings.append(Finding(Kind.LABEL, str(found.path), "no pictures in it"))
    for i, sample in enumerate(samples):
        findings += check_sample(sample, target, flags, i)
    others: tuple[Sample, ...] = ()
    if against is not None:
        other = read_entries(recognise(against), names or LabelNames())
        others = tuple(e for e in other if isinstance(e, Sample))
    total = len(samples) + len(others)
    mine = _look(samples, lambda done: on_progress(done, total))
    theirs = _look(others, lambda done: on_progress(len(samples) + done, total))
    findings += mine.findings
    findings += _twice(samples, mine)
    findings += _leaks(samples, mine, others, theirs)
    findings += _unpaired(found, samples)
    if found.format is Format.YOLO:
        findings += _unpaired_texts(found.folder, samples)
    findings.sort(key=lambda f: not f.wrong)
    return Report(path, found.format, samples, tuple(findings))


def _look(samples: Sequence[Sample], on_progress: Callable[[int], None]) -> _Pictures:
    seen = _Pictures()
    for i, sample in enumerate(samples):
        data, look = b"", None
        try:
            data = read_bytes(sample.image)
            look = look_of(decode_image(sample, data))
        except DatasetError as error:
            kind = Kind.PICTURE if data or is_file(sample.image) else Kind.NO_PICTURE
            seen.findings.append(Finding(kind, *_place_and_text(error, sample), sample=i))
        seen.digests.append(digest(data) if data else None)
        seen.looks.append(look)
        on_progress(i + 1)
    return seen


def _twice(samples: Sequence[Sample], seen: _Pictures) -> Iterator[Finding]:
    first: dict[str, int] = {}
    for i, key in enumerate(seen.digests):
        if key is None:
            continue
        j = first.setdefault(key, i)
        if j != i:
            both = samples[j].image
            same = "labelled twice" if both == samples[i].image else f"the same picture as {both}"
            yield Finding(Kind.TWICE, str(samples[i].image), same, sample=i)


def _leaks(
    samples: Sequence[Sample], mine: _Pictures, others: Sequence[Sample], theirs: _Pictures
) -> Iterator[Finding]:
    there = {key: j for j, key in enumerate(theirs.digests) if key is not None}
    leaked = set()
    for i, key in enumerate(mine.digests):
        if key is not None and key in there:
            leaked.add(i)
            text = f"the same picture as {others[there[key]].image}: one of them must go"
            yield Finding(Kind.LEAK, str(samples[i].image), text, sample=i)
    if max(len(mine.looks), len(theirs.looks)) > MAX_COMPARED:
        return
    for i, j in enumerate(nearest_alike(mine.looks, theirs.looks)):
        if j is not None and i not in leaked:
            text = f"looks the same as {others[j].image}"
            yield Finding(Kind.LEAK, str(samples[i].image), text, False, i)


def _unpaired(found: Found, samples: Sequence[Sample]) -> Iterator[Finding]:
    """Pictures in the samples' folders that no label speaks of."""
    used = {os.path.abspath(s.image) for s in samples}
    folders = sorted({os.path.dirname(p) for p in used})
    if found.format is Format.LABELME:
        folders = [str(found.folder)]  # a whole folder may be forgotten
    seen: set[str] = set()
    for folder in folders:
        if not os.path.isdir(folder):
            continue
        for path in walk(Path(folder), SUFFIXES):
            name = os.path.abspath(path)
            if name in used or name in seen:
                continue
            seen.add(name)
            if not path.with_suffix(".json").is_file():  # else its label was found to be wrong
                text = "has no label; label it, as empty too where no target shows"
                yield Finding(Kind.NO_LABEL, str(path), text)


def _unpaired_texts(folder: Path, samples: Sequence[Sample]) -> Iterator[Finding]:
    """YOLO's pictures without a text file, and text files without a picture."""
    for sample in samples:
        if sample.label == str(sample.image):
            text = "has no text file, which in YOLO means that it shows no target"
            yield Finding(Kind.NO_LABEL, str(sample.image), text, wrong=False)
    for label in labels_without_picture(folder):
        yield Finding(Kind.NO_PICTURE, str(label), "has no picture")


def _place_and_text(error: DatasetError, sample: Sample | None = None) -> tuple[str, str]:
    """The file of an error and what is wrong with it, apart."""
    if sample is not None:
        text = str(error).replace(f"picture {sample.image}", "", 1).lstrip(": ")
        return str(sample.image), text
    place, colon, text = str(error).partition(": ")
    return (place, text) if colon else ("", place)
