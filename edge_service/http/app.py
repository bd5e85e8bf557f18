"""The HTTP application; it reads the service's state and never changes it."""

from __future__ import annotations

from importlib import metadata

from fastapi import FastAPI
from fastapi.responses import HTMLResponse

from edge_service.http import examples
from edge_service.http.health import health_routes
from edge_service.http.localize import localize_routes
from edge_service.http.page import page
from edge_service.state import ServiceState

DESCRIPTION = """
Finds a printed target in an RGB-D picture and says where it is, with a covariance.

Drones send their frames over Zenoh or a UDP tunnel and never come here. This side is for people
and for clusters: try a picture (`POST /v1/localize`), see what the model is (`GET /v1/model`),
watch the service (`GET /metrics`, `/livez`, `/readyz`).
"""


def create_app(state: ServiceState) -> FastAPI:
    """The application around the state of a service that may still be starting."""
    app = FastAPI(
        title="edge-service",
        version=metadata.version("aerial-contact"),
        description=DESCRIPTION,
        # The usual pages load their scripts from a public network: there may be none here
        docs_url=None,
        redoc_url=None,
    )
    app.include_router(localize_routes(state))
    app.include_router(health_routes(state))

    @app.get("/", include_in_schema=False)
    @app.get("/docs", include_in_schema=False)
    async def docs() -> HTMLResponse:
        """The interface on one page, from its own description."""
        return HTMLResponse(page(app.openapi()))

    _add_examples(app)
    return app


def _add_examples(app: FastAPI) -> None:
    """Put in the examples whose nulls FastAPI would leave out."""
    answer = app.openapi()["paths"]["/v1/localize"]["post"]["responses"]["200"]
    answer["content"]["application/json"]["examples"] = examples.LOCALIZE_EXAMPLES
