"""Why no worker answers: what a person wants to know when a link stays silent.

Zenoh tries for ever and keeps its reasons to itself. This knocks once at an endpoint, from name to
certificate, and tells how far it came. For people; nothing decides by it.
"""

from __future__ import annotations

import socket
import ssl

from rgbd_wire.tls_files import TlsFiles

KNOCK_S = 2.0
"""Longest wait for each step."""


def diagnose(endpoint: str, tls: TlsFiles | None = None, timeout_s: float = KNOCK_S) -> str:
    """One sentence on a Zenoh endpoint.

    Args:
        endpoint: ``tcp/HOST:PORT`` or ``tls/HOST:PORT``.
        tls: the files that the link uses; None: none.
        timeout_s: longest wait for each step.
    """
    protocol, _, address = endpoint.partition("/")
    host, _, port = address.rpartition(":")
    host = host.strip("[]")
    try:
        knocking = socket.create_connection((host, int(port)), timeout=timeout_s)
    except (socket.gaierror, UnicodeError):
        return f"{endpoint}: there is no host called {host}"
    except TimeoutError:
        return f"{endpoint}: no answer within {timeout_s:g} s: is the host up, a firewall between?"
    except OSError as error:
        return f"{endpoint}: {error.strerror}: is edge-service running there?"
    with knocking:
        if protocol == "tls":
            return f"{endpoint}: {_shake_hands(knocking, host, tls)}"
        return f"{endpoint}: {_listen_for_tls(knocking, host)}"


def _shake_hands(knocking: socket.socket, host: str, tls: TlsFiles | None) -> str:
    context = ssl.create_default_context(cafile=None if tls is None else str(tls.ca))
    if tls is not None:
        context.load_cert_chain(tls.certificate, tls.key)
    has_shaken = False
    try:
        with context.wrap_socket(knocking, server_hostname=host) as secured:
            has_shaken = True
            secured.recv(1)  # what the worker says to our certificate comes after our half
    except ssl.SSLCertVerificationError as error:
        return f"the worker's certificate is not to be trusted: {error.verify_message}"
    except ssl.SSLError as error:
        reason = (error.reason or str(error)).lower().replace("_", " ")
        if "alert" in reason:
            return f"the worker refuses our certificate: {reason}"
    except OSError:  # a time-out too: it waits for us to speak, Zenoh if the handshake is through
        pass
    if has_shaken:
        return (
            "it takes our certificate; is this drone among EDGE_ZENOH_DRONES, and the worker ready?"
        )
    return "it does not speak TLS: has the worker EDGE_ZENOH_TLS, or is it tcp/ there?"


def _listen_for_tls(knocking: socket.socket, host: str) -> str:
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    context.check_hostname = False  # the question is whether it speaks TLS, not who it is
    context.verify_mode = ssl.CERT_NONE
    try:
        with context.wrap_socket(knocking, server_hostname=host):
            return f"it speaks TLS: write tls/{host}:..., and name the certificates with DRONE_TLS"
    except OSError:  # an ssl.SSLError, a hang-up or a time-out: something else than TLS
        return "somebody listens there; is it edge-service, and is it ready?"
