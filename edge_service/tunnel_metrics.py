"""The tunnel's own counts as a Prometheus series."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping

from prometheus_client.core import CounterMetricFamily
from prometheus_client.registry import Collector


class TunnelCollector(Collector):
    """Reads what the tunnel refused, by reason, whenever the metrics are asked for."""

    def __init__(self, counters: Callable[[], Mapping[str, int]]) -> None:
        self._counters = counters

    def collect(self) -> Iterator[CounterMetricFamily]:
        """One series for each reason."""
        family = CounterMetricFamily(
            "edge_tunnel_refused",
            "Datagrams and messages that the UDP tunnel did not take, by reason.",
            labels=["reason"],
        )
        for reason, count in self._counters().items():
            family.add_metric([reason], count)
        yield family
