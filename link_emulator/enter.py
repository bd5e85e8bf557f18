"""Runs a command in a network namespace: ``python -m link_emulator.enter NAME PARENT COMMAND...``.

Unlike ``ip netns exec`` the command does not outlive the process that started it.
"""

from __future__ import annotations

import ctypes
import os
import signal
import sys

from link_emulator import netns

PR_SET_PDEATHSIG = 1


def main() -> None:
    """Become the command."""
    name, parent, *command = sys.argv[1:]
    ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGKILL, 0, 0, 0)
    if os.getppid() != int(parent):
        sys.exit("the process that started this is gone")
    netns.enter(name)
    try:
        os.execvp(command[0], command)
    except OSError as error:
        sys.exit(f"{command[0]}: {error.strerror}")


if __name__ == "__main__":
    main()
