"""Pictures of the target with true labels, rendered into photographs and furnished rooms."""

from __future__ import annotations

from detector_training.scenes.backdrop import Library
from detector_training.scenes.dataset_writer import DatasetRequest, write_dataset
from detector_training.scenes.generator import Scene, generate
from detector_training.scenes.labels import LabelledBox

__all__ = ["DatasetRequest", "LabelledBox", "Library", "Scene", "generate", "write_dataset"]
