"""Whether the service lives, is ready, and what it counts: for clusters and dashboards."""

from __future__ import annotations

from fastapi import APIRouter, Response
from fastapi.responses import JSONResponse
from prometheus_client import CONTENT_TYPE_LATEST

from edge_service.http import examples
from edge_service.http.answers import answer
from edge_service.http.bodies import LiveBody, ReadyBody
from edge_service.state import ServiceState


def health_routes(state: ServiceState) -> APIRouter:
    """``/livez``, ``/readyz`` and ``/metrics``."""
    router = APIRouter(tags=["health"])

    @router.get(
        "/livez",
        response_model=LiveBody,
        summary="Do the worker's loop and the link's threads go round?",
        responses={503: {"model": LiveBody, "description": "Stuck: start it anew."}},
    )
    async def livez() -> JSONResponse:
        """503: stuck for `EDGE_HEARTBEAT_S`, or a thread of the link is gone."""
        worker = state.worker
        silent_s = None if worker is None else round(worker.silent_ns * 1e-9, 3)
        alive = state.alive
        return answer(LiveBody(alive=alive, silent_s=silent_s), 200 if alive else 503)

    @router.get(
        "/readyz",
        response_model=ReadyBody,
        summary="Are frames taken?",
        responses={503: {"model": ReadyBody, "description": "Not yet, or not any more."}},
    )
    async def readyz() -> JSONResponse:
        """For a readiness probe. Says which condition is missing."""
        conditions = state.readiness()
        ready = all(conditions.values())
        return answer(ReadyBody(ready=ready, **conditions), 200 if ready else 503)

    @router.get(
        "/metrics",
        summary="Prometheus metrics",
        response_class=Response,
        responses={200: {"content": {"text/plain": {"example": examples.METRICS}}}},
    )
    async def metrics() -> Response:
        """Frames by outcome, refusals and drops by reason, stage times, drones, what waits."""
        return Response(state.metrics_text(), media_type=CONTENT_TYPE_LATEST)

    return router
