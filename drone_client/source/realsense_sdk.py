"""RealSense's SDK, loaded when it is asked for; what is missing is said in one line.

The wheel of pyrealsense2 wants the system's libusb-1.0.so.0 and does not bring it. Where there is
none, that of the package libusb-package stands in: once it is in the process, the loader takes it
for the one that is asked for by that name.
"""

from __future__ import annotations

import ctypes
import importlib
from typing import Any, Final

from drone_client.errors import SourceError

_NO_SDK: Final = "no RealSense SDK here: install aerial-contact[realsense]"
_NO_LIBUSB: Final = (
    "the RealSense SDK finds no libusb-1.0: pip install libusb-package, "
    "or on Debian and Ubuntu: apt-get install libusb-1.0-0"
)


def load_sdk() -> Any:
    """The module ``pyrealsense2``.

    Raises:
        SourceError: the package, or a library that it needs, is not installed.
    """
    try:
        return importlib.import_module("pyrealsense2")
    except ModuleNotFoundError:
        raise SourceError(_NO_SDK) from None
    except ImportError as error:
        if "libusb" not in str(error):
            raise SourceError(f"the RealSense SDK cannot be loaded: {error}") from None
    _preload_libusb()
    try:
        return importlib.import_module("pyrealsense2")
    except ImportError as error:
        raise SourceError(f"the RealSense SDK cannot be loaded: {error}") from None


def _preload_libusb() -> None:
    try:
        path = importlib.import_module("libusb_package").get_library_path()
        if path is None:
            raise SourceError(_NO_LIBUSB)
        ctypes.CDLL(str(path), mode=ctypes.RTLD_GLOBAL)
    except (ImportError, OSError):
        raise SourceError(_NO_LIBUSB) from None
