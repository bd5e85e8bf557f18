"""A runtime at work in a process of its own: torch's threads and its own never share one."""

from __future__ import annotations

import multiprocessing
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from importlib.util import find_spec
from typing import ParamSpec, TypeVar

from detector_training.errors import ExportError

P = ParamSpec("P")
T = TypeVar("T")

RUNTIMES = ("onnxruntime", "openvino")


def apart(work: Callable[P, T], *args: P.args, **kwargs: P.kwargs) -> T:
    """Call a function in a new process and wait for its result; what it raises is raised here.

    Raises:
        ExportError: the process died.
    """
    context = multiprocessing.get_context("spawn")
    try:
        with ProcessPoolExecutor(1, mp_context=context) as pool:
            return pool.submit(work, *args, **kwargs).result()
    except BrokenProcessPool:
        raise ExportError("the process of the runtime died, maybe for want of memory") from None


def installed_runtime() -> str:
    """The runtime that checks an export.

    Raises:
        ExportError: none is installed.
    """
    for name in RUNTIMES:
        if find_spec(name) is not None:
            return name
    raise ExportError(
        "an export is checked by a runtime, and none is here: install aerial-contact[onnxruntime]"
    )
