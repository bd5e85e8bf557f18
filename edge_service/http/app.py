"""The HTTP application; it reads the service's state and never changes it."""

from __future__ import annotations

import asyncio
import dataclasses
from concurrent.futures import ThreadPoolExecutor
from importlib import metadata

from fastapi import FastAPI, Request, Response
from fastapi.responses import HTMLResponse, JSONResponse
from prometheus_client import CONTENT_TYPE_LATEST
from pydantic import BaseModel

from edge_service.errors import InputError
from edge_service.handed_in import frame_of_files
from edge_service.http import examples
from edge_service.http.bodies import ErrorBody, LiveBody, LocalizeBody, ModelBody, ReadyBody
from edge_service.http.page import page
from edge_service.http.turnstile import BusyError, Turnstile
from edge_service.http.uploads import TooLargeError, TooSlowError, read_fields
from edge_service.pipeline import Output, Pipeline
from edge_service.state import ServiceState
from rgbd_wire.messages import Outcome

RETRY_AFTER_S = 1

DESCRIPTION = """
Finds a printed target in an RGB-D picture and says where it is, with a covariance.

Drones send their frames over Zenoh and never come here. This side is for people and for clusters:
try a picture (`POST /v1/localize`), see what the model is (`GET /v1/model`), watch the service
(`GET /metrics`, `/livez`, `/readyz`).
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
    _add_health(app, state)
    _add_localize(app, state)
    return app


def _add_health(app: FastAPI, state: ServiceState) -> None:
    @app.get("/", include_in_schema=False)
    @app.get("/docs", include_in_schema=False)
    async def docs() -> HTMLResponse:
        """The interface on one page, from its own description."""
        return HTMLResponse(page(app.openapi()))

    @app.get(
        "/livez",
        response_model=LiveBody,
        tags=["health"],
        summary="Does the worker's loop go round?",
        responses={503: {"model": LiveBody, "description": "Stuck: start it anew."}},
    )
    async def livez() -> JSONResponse:
        """For a liveness probe. 503 when the worker has been stuck for `EDGE_HEARTBEAT_S`."""
        worker = state.worker
        body = LiveBody(
            alive=state.alive,
            silent_s=None if worker is None else round(worker.silent_ns * 1e-9, 3),
        )
        return _with_status(body, 200 if body.alive else 503)

    @app.get(
        "/readyz",
        response_model=ReadyBody,
        tags=["health"],
        summary="Are frames taken?",
        responses={503: {"model": ReadyBody, "description": "Not yet, or not any more."}},
    )
    async def readyz() -> JSONResponse:
        """For a readiness probe. Says which condition is missing."""
        conditions = state.readiness()
        body = ReadyBody(ready=all(conditions.values()), **conditions)
        return _with_status(body, 200 if body.ready else 503)

    @app.get(
        "/metrics",
        tags=["health"],
        summary="Prometheus metrics",
        response_class=Response,
        responses={200: {"content": {"text/plain": {"example": examples.METRICS}}}},
    )
    async def metrics() -> Response:
        """Frames by outcome, refusals by reason, time of each stage, drones, waiting frames."""
        return Response(state.metrics_text(), media_type=CONTENT_TYPE_LATEST)

    @app.get(
        "/v1/model",
        response_model=ModelBody,
        tags=["localize"],
        summary="What looks for what",
        responses={503: {"model": ErrorBody, "description": "The model is not warm yet."}},
    )
    async def model() -> JSONResponse:
        """The detector's weights and how they run, and the target that is looked for."""
        pipeline = state.pipeline
        if pipeline is None:
            return _error(503, None, "the model is not warm yet")
        body = ModelBody(
            worker=state.settings.name,
            version=app.version,
            target=dataclasses.asdict(pipeline.target),
            detector=pipeline.detector.describe(),
        )
        return _with_status(body, 200)


def _add_localize(app: FastAPI, state: ServiceState) -> None:
    turnstile = Turnstile(state.settings.http_waiting)
    # One thread: the detector takes one picture at a time anyway, and every thread that ever
    # calls it gets a pool of its own from OpenMP
    executor = ThreadPoolExecutor(1, thread_name_prefix="localize")
    max_bytes = state.settings.http_upload_mb * 1_000_000

    @app.post(
        "/v1/localize",
        response_model=LocalizeBody,
        tags=["localize"],
        summary="Where is the target in this picture?",
        openapi_extra={"requestBody": examples.LOCALIZE_REQUEST},
        responses=examples.LOCALIZE_RESPONSES,
    )
    async def localize(request: Request) -> JSONResponse:
        """One picture in, one pose out; the same stages as for a drone's frame.

        Hand in `color` (JPEG or PNG), `camera` (the camera JSON) and, for the best accuracy,
        `depth` (16-bit PNG in units of the camera's `depth_scale_m`).
        """
        try:
            response = await answer(request)
        except InputError as error:
            response = _error(422, error.field, str(error))
        except TooLargeError:
            limit = state.settings.http_upload_mb
            response = _error(413, None, f"the upload is over {limit} MB", close=True)
        except TooSlowError:
            response = _error(408, None, "the upload took too long", close=True)
        except BusyError:
            response = _error(503, None, "too many pictures wait already", close=True)
        state.metrics.requests.labels(str(response.status_code)).inc()
        return response

    async def answer(request: Request) -> JSONResponse:
        pipeline = state.pipeline
        if pipeline is None:
            return _error(503, None, "the model is not warm yet", close=True)
        async with turnstile.line() as place:
            fields = await read_fields(request, max_bytes)
            for required in ("color", "camera"):
                if not fields.get(required):
                    raise InputError(required, "missing or empty")
            async with place:
                loop = asyncio.get_running_loop()
                output = await loop.run_in_executor(executor, _locate, pipeline, fields)
        body = LocalizeBody.of(output, pipeline.detector.model_hash)
        return _with_status(body, 200)


def _locate(pipeline: Pipeline, fields: dict[str, bytes]) -> Output:
    frame = frame_of_files(fields["color"], fields.get("depth"), fields["camera"])
    output = pipeline.locate(frame)
    if output.outcome is Outcome.BAD_FRAME:
        raise InputError("color", output.reason)
    return output


def _with_status(body: BaseModel, status: int) -> JSONResponse:
    return JSONResponse(body.model_dump(mode="json"), status)


def _error(status: int, field: str | None, detail: str, *, close: bool = False) -> JSONResponse:
    headers = {}
    if status == 503:
        headers["Retry-After"] = str(RETRY_AFTER_S)
    if close:  # what is left of the body is not read
        headers["Connection"] = "close"
    return JSONResponse(ErrorBody(field=field, detail=detail).model_dump(), status, headers)
