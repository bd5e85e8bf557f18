"""Runs a command that ends with whoever started it.

``python -m contact_sim.flight.tied SECONDS COMMAND...``: standard input is a pipe that the starter
holds open and never writes to. It ends when the starter closes it, and when the starter is killed;
then the command is told to end, and after so many seconds killed, with all that it has started.
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
from contextlib import suppress
from types import FrameType
from typing import Final

STDIN: Final = 0
NOT_FOUND: Final = 127


class Tied:
    """The command, in a process group of its own."""

    def __init__(self, command: list[str], end_s: float) -> None:
        self._end_s = end_s
        self._process = subprocess.Popen(
            command, stdin=subprocess.DEVNULL, start_new_session=True, preexec_fn=_hear_signals
        )

    def end(self) -> None:
        """Tell it to end; at once after its time is over."""
        self._signal(signal.SIGTERM)
        last = threading.Timer(self._end_s, self._signal, (signal.SIGKILL,))
        last.daemon = True
        last.start()

    def wait(self) -> int:
        """Until it has ended; nothing that it has started goes on. Returns its exit status."""
        code = self._process.wait()
        self._signal(signal.SIGKILL)
        return code if code >= 0 else 128 - code

    def _signal(self, sign: signal.Signals) -> None:
        with suppress(ProcessLookupError, PermissionError):  # gone, or a zombie
            os.killpg(self._process.pid, sign)


def _hear_signals() -> None:
    """What this process left unheard while the command began, the command hears."""
    signal.pthread_sigmask(signal.SIG_UNBLOCK, _SIGNS)


_SIGNS: Final = (signal.SIGINT, signal.SIGTERM)


def main() -> int:
    """Run it."""
    seconds, *command = sys.argv[1:]
    signal.pthread_sigmask(signal.SIG_BLOCK, _SIGNS)  # none is lost before there is whom to tell
    try:
        tied = Tied(command, float(seconds))
    except OSError as error:
        print(f"{command[0]}: {error.strerror}", file=sys.stderr)
        return NOT_FOUND

    def end(_signal: int, _frame: FrameType | None) -> None:
        tied.end()

    for sign in _SIGNS:
        signal.signal(sign, end)
    signal.pthread_sigmask(signal.SIG_UNBLOCK, _SIGNS)

    def watch() -> None:
        while os.read(STDIN, 64):
            pass
        tied.end()

    threading.Thread(target=watch, name="end with the starter", daemon=True).start()
    return tied.wait()


if __name__ == "__main__":
    sys.exit(main())
