"""A simulated flight, or a campaign with a service, that is killed leaves no process behind."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.flight_process import FLY, SIMULATOR, FlightProcess, flight_process

GONE_S = 30.0
"""More than the service is given to end; it takes a second or two on an idle machine."""
pytestmark = pytest.mark.timeout(400)


def serves(flight: FlightProcess) -> bool:
    """Whether the service's own process runs, and not only what ties it to the flight."""
    return any(
        "edge-service serve" in line and "contact_sim.flight.tied" not in line
        for line in flight.all().values()
    )


@pytest.mark.parametrize("when", ["as the service starts", "in flight"])
def test_a_flight_that_is_killed_takes_all_with_it(when: str, tmp_path: Path):
    """Service, link and flight are processes of their own; kill -9 of the flight ends them all."""
    out = tmp_path / "run"
    options = "--sim", "tunnel", "--link", "wifi", "--out", str(out)
    with flight_process(*FLY, *options, log=tmp_path / "log") as flight:
        flight.wait_until(lambda: serves(flight))
        if when == "in flight":
            flight.wait_until(lambda: "hold -> search" in flight.log.read_text())
            assert len(flight.all()) >= 3
        flight.process.kill()
        flight.process.wait()
        assert flight.left(GONE_S) == {}


def test_a_campaign_that_is_killed_takes_its_service_with_it(tmp_path: Path):
    """And the processes that fly."""
    options = "--eyes", "service", "--world", "tunnel", "--flights", "20", "--jobs", "2"
    with flight_process(
        *SIMULATOR, "campaign", *options, "--out", str(tmp_path / "run"), log=tmp_path / "log"
    ) as campaign:
        campaign.wait_until(lambda: serves(campaign))
        campaign.process.kill()
        campaign.process.wait()
        assert campaign.left(GONE_S) == {}
