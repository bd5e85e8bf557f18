"""Whether a service is ready, asked of real HTTP servers on loopback."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, HTTPServer

import pytest

from contact_sim.flight.service import answers_ready, free_port


@pytest.fixture(autouse=True)
def _patient(monkeypatch: pytest.MonkeyPatch) -> None:
    """A busy machine takes its time to answer."""
    monkeypatch.setattr("contact_sim.flight.service.READY_ANSWER_S", 20.0)


class Ready(BaseHTTPRequestHandler):
    """Ready, and that is all."""

    def do_GET(self) -> None:
        self.send_response(200 if self.path == "/readyz" else 404)
        self.end_headers()

    def log_message(self, *_: object) -> None:
        pass


class Loading(Ready):
    """Not yet."""

    def do_GET(self) -> None:
        self.send_response(503)
        self.end_headers()


@contextmanager
def served(handler: type[BaseHTTPRequestHandler]) -> Iterator[str]:
    with HTTPServer(("127.0.0.1", 0), handler) as server:
        thread = threading.Thread(target=server.serve_forever, args=(0.01,))
        thread.start()
        try:
            yield f"127.0.0.1:{server.server_port}"
        finally:
            server.shutdown()
            thread.join()


@pytest.mark.parametrize("name", ["http_proxy", "HTTP_PROXY"])
def test_a_proxy_of_the_environment_is_not_asked(
    name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Nobody is at its address, and to the service on loopback it is no way."""
    for other in ("no_proxy", "NO_PROXY"):
        monkeypatch.delenv(other, raising=False)
    monkeypatch.setenv(name, "http://127.0.0.1:9")
    with served(Ready) as http:
        assert answers_ready(http)


def test_who_loads_or_is_not_there_is_not_ready() -> None:
    """An answer that says no, and none at all."""
    with served(Loading) as http:
        assert not answers_ready(http)
    assert not answers_ready(f"127.0.0.1:{free_port()}")
