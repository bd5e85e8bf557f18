"""An autopilot that flies nowhere and remembers the newest commands: for replay and tests."""

from __future__ import annotations

from collections import deque

from drone_client.autopilot import VelocityCommand


class MemoryAutopilot:
    """Keeps the last ``capacity`` commands."""

    def __init__(self, capacity: int = 4096) -> None:
        self.commands: deque[VelocityCommand] = deque(maxlen=capacity)

    def command(self, command: VelocityCommand) -> None:
        """Remember the command."""
        self.commands.append(command)
