"""Network namespaces by name: make, enter, sweep, delete. Needs root and iproute2.

A name carries the process that made it and when that process started, so that what a killed run
left behind can be told from what is in use, also when its process id was given out again.
"""

from __future__ import annotations

import ctypes
import os
import re
import signal
import subprocess
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from link_emulator.errors import NotPermittedError

FOLDER = Path("/run/netns")
CLONE_NEWNET = 0x40000000
END_S = 2.0
_NAME = re.compile(r"link-emulator-(\d+)-(\d+)-\d+-[ab]")


def owned_name(number: int, end: str) -> str:
    """A namespace's name for this process."""
    pid = os.getpid()
    return f"link-emulator-{pid}-{_started(pid)}-{number}-{end}"


def make(name: str) -> None:
    """Make a namespace, with its loopback up.

    Raises:
        NotPermittedError: says what the kernel or iproute2 said.
    """
    ip("netns", "add", name)
    ip("-n", name, "link", "set", "lo", "up")


def delete(name: str) -> None:
    """End what still runs in a namespace, and delete it; nothing happens if it is not there."""
    if not (FOLDER / name).exists():
        return
    deadline = time.monotonic() + END_S
    while (left := _processes(name)) and time.monotonic() < deadline:
        for pid in left:
            with suppress(ProcessLookupError):
                os.kill(pid, signal.SIGKILL)
        time.sleep(0.01)
    subprocess.run(["ip", "netns", "del", name], check=False, capture_output=True)


def sweep() -> list[str]:
    """Delete the namespaces of processes that are no more; their names."""
    stale = []
    for place in FOLDER.glob("link-emulator-*") if FOLDER.exists() else ():
        match = _NAME.fullmatch(place.name)
        if match and _started(int(match[1])) != int(match[2]):
            delete(place.name)
            stale.append(place.name)
    return stale


def enter(name: str) -> None:
    """Move the calling thread into a namespace.

    Raises:
        NotPermittedError: it is not there, or not ours.
    """
    try:
        fd = os.open(FOLDER / name, os.O_RDONLY | os.O_CLOEXEC)
    except OSError as error:
        raise NotPermittedError(f"namespace {name}: {error.strerror}") from None
    try:
        _set(fd)
    except OSError as error:
        raise NotPermittedError(f"namespace {name}: {error.strerror}") from None
    finally:
        os.close(fd)


@contextmanager
def inside(name: str) -> Iterator[None]:
    """The calling thread is in a namespace for the block.

    Raises:
        NotPermittedError: it is not there, or not ours.
    """
    home = os.open("/proc/thread-self/ns/net", os.O_RDONLY | os.O_CLOEXEC)
    try:
        enter(name)
        try:
            yield
        finally:
            _set(home)
    finally:
        os.close(home)


def ip(*arguments: str) -> str:
    """Run iproute2's ``ip``.

    Raises:
        NotPermittedError: it failed or is not installed; says what it said.
    """
    try:
        done = subprocess.run(["ip", *arguments], check=False, capture_output=True, text=True)
    except FileNotFoundError:
        raise NotPermittedError("`ip` is not installed; it comes with iproute2") from None
    if done.returncode:
        raise NotPermittedError(f"ip {' '.join(arguments)}: {done.stderr.strip()}")
    return done.stdout


def _set(fd: int) -> None:
    libc = ctypes.CDLL(None, use_errno=True)
    if libc.setns(fd, CLONE_NEWNET) != 0:
        raise OSError(ctypes.get_errno(), os.strerror(ctypes.get_errno()))


def _processes(name: str) -> list[int]:
    done = subprocess.run(["ip", "netns", "pids", name], check=False, capture_output=True)
    return [int(pid) for pid in done.stdout.split() if int(pid) != os.getpid()]


def _started(pid: int) -> int:
    """When a process started, in ticks since boot; -1: there is none."""
    try:
        stat = Path(f"/proc/{pid}/stat").read_text()
    except OSError:
        return -1
    return int(stat.rpartition(")")[2].split()[19])
