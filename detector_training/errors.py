"""The errors of ``detector_training``.

::

    TrainingError
    ├── BackgroundsError   a folder of background pictures that cannot be used
    ├── SceneError         a request for scenes that cannot be met
    ├── DatasetError       a data set folder that is missing or malformed
    ├── ExportError        an export that says something else than the net
    ├── NotFiniteError     a loss or a gradient that is no number
    ├── TargetPrintError   a target that cannot be printed as asked
    └── EvaluationError    an evaluation asked for with numbers or files that give none
"""

from __future__ import annotations


class TrainingError(Exception):
    """Root of this package's errors."""


class BackgroundsError(TrainingError):
    """A folder of background pictures is missing or holds none that can be read."""


class SceneError(TrainingError):
    """Scenes were asked for with numbers that make none."""


class TargetPrintError(TrainingError):
    """A target cannot be printed as asked: on this paper, into this file."""


class DatasetError(TrainingError):
    """A data set folder is missing, malformed, or in the way of a new one."""


class EvaluationError(TrainingError):
    """An evaluation was asked for with numbers or files that give none."""


class ExportError(TrainingError):
    """An export cannot be made, or says something else than the net."""


class NotFiniteError(TrainingError):
    """A loss or a gradient is no number; the net is as it was before the step."""
