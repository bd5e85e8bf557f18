"""A bad link on one machine: delay, jitter, burst loss, rate, queue, partition, for any protocol.

As root, two network namespaces with a TUN device each and one relay process between them, so that
whatever the kernel speaks goes through it (``Namespaces``). Without, a proxy for UDP or TCP. A pure
core (``Path``) decides about a packet from the time and its size alone; the shells keep to its
release times and measure how well they do.
"""

from link_emulator.control import Control
from link_emulator.errors import ControlError, EmulatorError, ImpairmentError, NotPermittedError
from link_emulator.impairments import Impairments
from link_emulator.namespaces import Namespaces, may_make_namespaces
from link_emulator.path import Drop, Path
from link_emulator.proxy_process import TcpProxy, UdpProxy
from link_emulator.report import DirectionReport, Report

__all__ = [
    "Control",
    "ControlError",
    "DirectionReport",
    "Drop",
    "EmulatorError",
    "ImpairmentError",
    "Impairments",
    "Namespaces",
    "NotPermittedError",
    "Path",
    "Report",
    "TcpProxy",
    "UdpProxy",
    "may_make_namespaces",
]
