"""A folder that appears when it is finished, and pictures copied into it."""

from __future__ import annotations

import os
import shutil
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from detector_training.datasets.files import PART
from detector_training.datasets.sample import Sample, check_header, read_bytes
from detector_training.errors import DatasetError


@contextmanager
def new_folder(out: Path) -> Iterator[Path]:
    """A folder to write to, which becomes ``out`` at the end, or is gone when something failed.

    Raises:
        DatasetError: ``out`` holds something already, or cannot be written.
    """
    part = out.absolute().with_name(out.absolute().name + PART)
    try:
        if out.is_file() or (out.is_dir() and any(out.iterdir())):
            raise DatasetError(f"{out} holds something already; name a new folder")
        shutil.rmtree(part, ignore_errors=True)  # of a run that was killed
        part.mkdir(parents=True)
        yield part
        if out.is_dir():
            out.rmdir()
        os.replace(part, out)
    except OSError as error:
        raise DatasetError(f"cannot write to {out}: {error.strerror or error}") from None
    finally:
        shutil.rmtree(part, ignore_errors=True)


def write_file(path: Path, content: str | bytes) -> None:
    """Write a file that is whole or not there.

    Raises:
        DatasetError: it cannot be written.
    """
    part = path.with_name(path.name + PART)
    try:
        part.write_bytes(content.encode() if isinstance(content, str) else content)
        os.replace(part, path)
    except OSError as error:
        raise DatasetError(f"cannot write {path}: {error.strerror or error}") from None
    finally:
        if part.is_file():
            part.unlink()


def picture_names(samples: Sequence[Sample]) -> list[str]:
    """A file name for each picture, its own where that is unique; no two share a stem.

    Labels are named by the stem of their picture, so ``a.jpg`` and ``a.png`` would share one.
    """
    stems = Counter(s.image.stem.lower() for s in samples)
    names, taken = [], {stem for stem, count in stems.items() if count == 1}
    for number, sample in enumerate(samples):
        name = sample.image.name
        if stems[sample.image.stem.lower()] > 1:
            stem = f"{sample.image.parent.name}_{sample.image.stem}"
            if stem.lower() in taken:
                stem = f"{number:06d}_{stem}"
            taken.add(stem.lower())
            name = stem + sample.image.suffix
        names.append(name)
    return names


def copy_picture(sample: Sample, path: Path) -> bool:
    """Copy a picture byte by byte, checked against its label.

    Returns:
        Whether an EXIF note turns it when it is shown.

    Raises:
        DatasetError: it cannot be read, or has another size than its label says.
    """
    data = read_bytes(sample.image)
    header = check_header(sample, data)
    path.write_bytes(data)
    return header.orientation != 1
