"""A detector over a data set, once: what it found is kept, and all scores are made from that."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from detector_training.datasets.sample import Sample
from edge_service.detector.detector import SCORE_THRESHOLD
from target_pose.candidate import Candidate, Detections
from target_pose.nesting import group
from target_pose.target import Target

Detect: TypeAlias = Callable[[NDArray[np.uint8]], Detections]


@dataclass(frozen=True, slots=True, eq=False)
class Find:
    """What a detector said of one picture."""

    sample: Sample
    detections: Detections
    """Down to the detector's own threshold."""
    candidates: tuple[Candidate, ...]
    """What is left after the nesting check, of the boxes above ``SCORE_THRESHOLD``."""


def run_detector(
    detect: Detect,
    samples: Iterable[Sample],
    target: Target,
    on_progress: Callable[[int], None] = lambda done: None,
) -> tuple[Find, ...]:
    """Look at each picture.

    Args:
        detect: Should return boxes down to a low score, else the AP is cut short.
        samples: Pictures and truth.
        target: For the nesting check.
        on_progress: Called with the number of pictures done.

    Raises:
        DatasetError: a picture cannot be read.
    """
    finds = []
    for sample in samples:
        image = sample.read()
        detections = detect(image)
        finds.append(Find(sample, detections, group(confident(detections), target, image)))
        on_progress(len(finds))
    return tuple(finds)


def confident(detections: Detections, threshold: float = SCORE_THRESHOLD) -> Detections:
    """The boxes above a score: what the service would have got."""
    return Detections(
        {
            level: tuple(b for b in boxes if b.score > threshold)
            for level, boxes in detections.boxes.items()
        }
    )
