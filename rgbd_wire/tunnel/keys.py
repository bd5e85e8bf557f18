"""The keys of the drones: a file of lines ``name hex-key``, read again when it changes.

::

    # 32 bytes each, as 64 hex digits
    drone-1  000102...1f
"""

from __future__ import annotations

import logging
import os
import re
import secrets
import stat
from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType

from rgbd_wire.tunnel.errors import KeyFileError

PSK_BYTES = 32
MAX_FILE_BYTES = 256 * 1024
MAX_KEYS = 1024
CHECK_EVERY_NS = 1_000_000_000
_NAME = re.compile(r"[a-z0-9][a-z0-9_-]{0,31}")
_HEX = re.compile(r"[0-9a-fA-F]{64}")
_log = logging.getLogger(__name__)


def generate_key() -> str:
    """A new key as it stands in the file."""
    return secrets.token_hex(PSK_BYTES)


def parse_keys(text: str, source: str) -> Mapping[str, bytes]:
    """Key by drone, of the text of a key file.

    Args:
        text: the whole file.
        source: its name, for messages; these never hold a key.

    Raises:
        KeyFileError: says the line and what is wrong with it.
    """
    keys: dict[str, bytes] = {}
    for number, line in enumerate(text.splitlines(), start=1):
        words = line.partition("#")[0].split()
        if not words:
            continue
        where = f"{source}:{number}"
        if len(words) != 2:
            raise KeyFileError(f"{where}: {len(words)} words, a line is a name and a key")
        name, key = words
        if not _NAME.fullmatch(name):
            raise KeyFileError(f"{where}: the name is not of the form [a-z0-9][a-z0-9_-]{{0,31}}")
        if not _HEX.fullmatch(key):
            raise KeyFileError(
                f"{where}: the key of {name} is not {2 * PSK_BYTES} hex digits ({len(key)} here)"
            )
        if name in keys:
            raise KeyFileError(f"{where}: {name} has a key already")
        if len(set(key)) == 1:
            raise KeyFileError(f"{where}: the key of {name} is one digit over and over")
        keys[name] = bytes.fromhex(key)
        if len(keys) > MAX_KEYS:
            raise KeyFileError(f"{where}: more than {MAX_KEYS} keys")
    return MappingProxyType(keys)


def load_keys(path: Path) -> Mapping[str, bytes]:
    """Key by drone, of a file.

    Raises:
        KeyFileError: it cannot be read, is open to others, is too large, or a line is wrong.
    """
    try:
        with path.open("rb") as file:
            mode = os.fstat(file.fileno()).st_mode
            data = file.read(MAX_FILE_BYTES + 1)
    except OSError as error:
        raise KeyFileError(f"{path}: {error.strerror}") from None
    if len(data) > MAX_FILE_BYTES:
        raise KeyFileError(f"{path}: more than {MAX_FILE_BYTES} bytes")
    # The group may read it: that is how a cluster hands a secret to a process that is not root
    if stat.S_ISREG(mode) and mode & (stat.S_IROTH | stat.S_IWOTH | stat.S_IWGRP):
        raise KeyFileError(
            f"{path} is open to others (mode {stat.S_IMODE(mode):04o}); chmod 600 {path}"
        )
    try:
        return parse_keys(data.decode("ascii"), str(path))
    except UnicodeDecodeError:
        raise KeyFileError(f"{path}: not ASCII text") from None


def load_key(path: Path, drone: str) -> bytes:
    """The key of one drone, of a file.

    Raises:
        KeyFileError: as ``load_keys``, or the drone has no line.
    """
    key = load_keys(path).get(drone)
    if key is None:
        raise KeyFileError(f"{path}: no key for {drone}")
    return key


class KeyFile:
    """A key file that is looked at again at most once a second.

    Raises:
        KeyFileError: as ``load_keys``, at the start only; later a wrong file is logged and the keys
            that were read before stay.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._mark = self._look()
        self._keys = load_keys(path)
        self._checked_ns: int | None = None
        self._told: tuple[int, ...] | None = self._mark

    def __len__(self) -> int:
        """How many drones have a key."""
        return len(self._keys)

    def get(self, drone: str) -> bytes | None:
        """Key of a drone, None: it has none."""
        return self._keys.get(drone)

    def refresh(self, now_ns: int) -> bool:
        """Read the file again if it changed since; True: the keys are other ones now."""
        if self._checked_ns is not None and now_ns - self._checked_ns < CHECK_EVERY_NS:
            return False
        self._checked_ns = now_ns
        mark = self._look()
        if mark == self._mark:
            return False
        try:
            keys = load_keys(self._path)
        except KeyFileError as error:
            # tried again, for it may be the machine that could not; told once for each change
            if mark != self._told:
                _log.error("the keys stay as they were: %s", error)
            self._told = mark
            return False
        self._mark = mark
        changed = keys != self._keys
        self._keys = keys
        return changed

    def _look(self) -> tuple[int, ...] | None:
        try:
            found = self._path.stat()  # through links, as Kubernetes swaps secrets by one
        except OSError:
            return None
        return found.st_mtime_ns, found.st_ino, found.st_size, found.st_mode
