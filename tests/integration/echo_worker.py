"""A worker's Zenoh transport that sends every message back; a process that a test may stop.

python -m tests.integration.echo_worker NAME ENDPOINT [TLS_FOLDER DRONES]
"""

from __future__ import annotations

import signal
import sys
from pathlib import Path

from edge_service.transport.zenoh import ZenohAddress, ZenohTransport
from rgbd_wire.tls_files import tls_files


def main() -> None:
    """Serve until SIGTERM; says "ready" when drones may come."""
    name, endpoint, *secure = sys.argv[1:]
    address = ZenohAddress(listen=(endpoint,))
    if secure:
        folder, drones = secure
        address = ZenohAddress((endpoint,), tls=tls_files(Path(folder)), drones=(drones,))
    transport = ZenohTransport(name, address)
    transport.open()
    transport.start(lambda drone, data, _t2_ns: transport.send(drone, bytes(data[:4000])))
    transport.announce()
    print("ready", flush=True)
    signal.sigwait({signal.SIGTERM})
    transport.close()


if __name__ == "__main__":
    signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGTERM})
    main()
