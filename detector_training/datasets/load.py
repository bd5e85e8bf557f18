"""A data set of any format that we read, recognised by what lies there."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from detector_training.datasets.lines import LABELS, read_lines
from detector_training.datasets.names import LabelNames
from detector_training.datasets.sample import Sample
from detector_training.errors import DatasetError


def read_entries(path: Path, names: LabelNames) -> Iterator[Sample | DatasetError]:
    """Every picture of a data set; an error in place of each label that is wrong.

    Raises:
        DatasetError: there is no data set, or the file of all labels cannot be read.
    """
    file = path / LABELS if path.is_dir() else path
    if not file.is_file():
        raise DatasetError(f"no data set in {path}: no {LABELS}")
    return read_lines(file, names)


def load_dataset(path: Path, names: LabelNames | None = None) -> tuple[Sample, ...]:
    """All samples of a data set, in the order of its labels.

    Args:
        path: The data set's folder, or the file that holds its labels.
        names: What its labels mean, where they are not called as the levels are.

    Raises:
        DatasetError: names the file and what is wrong with it.
    """
    samples: list[Sample] = []
    for entry in read_entries(path, names or LabelNames()):
        if isinstance(entry, DatasetError):
            raise entry
        samples.append(entry)
    if not samples:
        raise DatasetError(f"the data set in {path} has no pictures")
    return tuple(samples)
