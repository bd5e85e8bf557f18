"""What ``drone-client fly --sim`` opens, named by an entry point.

OpenGL is looked for before anything is started, and before anything loads mujoco.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from contact_sim.errors import SimulatorError
from contact_sim.sensing.gl import choose_gl, load_mujoco
from drone_client.errors import WorldError
from drone_client.fly.simulator import SimulatorRequest
from link_emulator.errors import EmulatorError
from rgbd_wire.clock import Clock

if TYPE_CHECKING:
    from contact_sim.flight.world import SimulatedWorld


def open_simulator(request: SimulatorRequest, clock: Clock) -> SimulatedWorld:
    """The world of a request, running, with a service if it named none.

    Raises:
        WorldError: there is no such world, board, seed or link, no drone of that airframe, no
            OpenGL, or no service came up.
    """
    try:
        choose_gl()
        load_mujoco()
        from contact_sim.flight.world import open_world  # loads mujoco, which MUJOCO_GL may break

        return open_world(request, clock)
    except (SimulatorError, EmulatorError) as error:
        raise WorldError(str(error)) from None
