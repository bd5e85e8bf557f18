"""Series that are there before their first event, and those that the tunnel counts itself."""

from __future__ import annotations

from edge_service.metrics import Metrics


def test_series_are_there_from_the_start():
    """A rate of the first event needs a zero before it."""
    text = Metrics().text().decode()
    for line in (
        "edge_probes_total 0.0",
        'edge_dropped_total{where="intake"} 0.0',
        'edge_dropped_total{where="worker"} 0.0',
        'edge_rejected_total{reason="too_fast"} 0.0',
        'edge_rejected_total{reason="wrong_drone"} 0.0',
        'edge_rejected_total{reason="no_drone"} 0.0',
        'edge_frames_total{outcome="dropped"} 0.0',
        'edge_batch_frames_bucket{le="1.0"} 0.0',
        "edge_expected_service_seconds 0.0",
    ):
        assert line in text
    assert "edge_tunnel" not in text


def test_what_the_tunnel_refuses_is_read_when_asked_for():
    """One series for each reason, as it stands."""
    metrics, counts = Metrics(), {"bad_mac": 0, "replayed": 2}
    metrics.follow_tunnel(lambda: counts)
    counts["bad_mac"] = 7
    text = metrics.text().decode()
    assert 'edge_tunnel_refused_total{reason="bad_mac"} 7.0' in text
    assert 'edge_tunnel_refused_total{reason="replayed"} 2.0' in text
