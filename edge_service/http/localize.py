"""One picture in, one pose out, over HTTP; and what it is that looks for it."""

from __future__ import annotations

import asyncio
import dataclasses
import logging
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from importlib import metadata
from typing import Annotated

from fastapi import APIRouter, Query, Request, Response
from fastapi.responses import JSONResponse
from starlette.requests import ClientDisconnect

from edge_service.drawing.draw import draw as draw_sheet
from edge_service.drawing.files import encoded
from edge_service.drawing.findings import Findings, look
from edge_service.errors import InputError
from edge_service.handed_in import frame_of_files
from edge_service.http import examples
from edge_service.http.answers import answer, refusal
from edge_service.http.bodies import ErrorBody, LocalizeBody, ModelBody
from edge_service.http.turnstile import BusyError, Turnstile
from edge_service.http.uploads import TooLargeError, TooSlowError, read_fields
from edge_service.pipeline import Output, Pipeline
from edge_service.state import ServiceState
from rgbd_wire.frame import RgbdFrame
from rgbd_wire.messages import Outcome

log = logging.getLogger(__name__)

NOT_WARM = "the model is not warm yet"
FAULT = "a fault of the service's own; its log says more"


def localize_routes(state: ServiceState) -> APIRouter:
    """``POST /v1/localize`` and ``GET /v1/model``."""
    router = APIRouter(tags=["localize"])
    desk = _Desk(state)

    @router.post(
        "/v1/localize",
        response_model=LocalizeBody,
        summary="Where is the target in this picture?",
        openapi_extra={"requestBody": examples.LOCALIZE_REQUEST},
        responses=examples.LOCALIZE_RESPONSES,
    )
    async def localize(
        request: Request,
        draw: Annotated[bool, Query(description="Answer with a picture (PNG).")] = False,
    ) -> Response:
        """One picture in, one pose out; the same stages as for a drone's frame.

        Hand in `color` (JPEG or PNG), `camera` (the camera JSON) and, for the best accuracy,
        `depth` (16-bit PNG in units of the camera's `depth_scale_m`). With `?draw=1` the answer is
        a picture: boxes, circles, both folds, covariance, or why there is no target.
        """
        try:
            response = await desk.serve(request, draw=draw)
        except Exception:  # the process boundary: what is wrong here is for the log alone
            log.exception("picture failed")
            response = refusal(500, FAULT, close=True)
        state.metrics.requests.labels(str(response.status_code)).inc()
        return response

    @router.get(
        "/v1/model",
        response_model=ModelBody,
        summary="What looks for what",
        responses={503: {"model": ErrorBody, "description": "The model is not warm yet."}},
    )
    async def model() -> JSONResponse:
        """The detector's weights and how they run, and the target that is looked for."""
        pipeline = state.pipeline
        if pipeline is None:
            return refusal(503, NOT_WARM)
        body = ModelBody(
            worker=state.settings.name,
            version=metadata.version("aerial-contact"),
            target=dataclasses.asdict(pipeline.target),
            method=pipeline.method,
            detector=pipeline.detector.describe(),
        )
        return answer(body)

    return router


class _Desk:
    """Takes pictures, one after the other, and tells what is wrong with those it cannot take."""

    def __init__(self, state: ServiceState) -> None:
        self._state = state
        self._turnstile = Turnstile(state.settings.http_waiting)
        # One thread: the detector takes one picture at a time anyway, and every thread that ever
        # calls it gets a pool of its own from OpenMP
        self._executor = ThreadPoolExecutor(1, thread_name_prefix="localize")

    async def serve(self, request: Request, *, draw: bool = False) -> Response:
        """The answer to a request, whatever it is; a PNG if ``draw``."""
        pipeline = self._state.pipeline
        if pipeline is None:
            return refusal(503, NOT_WARM, close=True)
        try:
            seen = await self._look(_draw if draw else _locate, pipeline, request)
        except InputError as error:
            return refusal(422, str(error), error.field)
        except TooLargeError:
            limit = self._state.settings.http_upload_mb
            return refusal(413, f"the upload is over {limit} MB", close=True)
        except TooSlowError:
            return refusal(408, "the upload took too long", close=True)
        except BusyError:
            return refusal(503, "too many pictures wait already", close=True)
        except ClientDisconnect:
            return refusal(400, "the client went away")  # nobody reads it, but it is counted
        if isinstance(seen, bytes):
            return Response(seen, media_type="image/png")
        return answer(LocalizeBody.of(seen, pipeline.detector.model_hash))

    async def _look(
        self,
        answered_by: Callable[[Pipeline, dict[str, bytes]], Output | bytes],
        pipeline: Pipeline,
        request: Request,
    ) -> Output | bytes:
        async with self._turnstile.line() as place:
            max_bytes = self._state.settings.http_upload_mb * 1_000_000
            fields = await read_fields(request, max_bytes)
            for required in ("color", "camera"):
                if not fields.get(required):
                    raise InputError(required, "missing or empty")
            async with place:
                loop = asyncio.get_running_loop()
                return await loop.run_in_executor(self._executor, answered_by, pipeline, fields)


def _locate(pipeline: Pipeline, fields: dict[str, bytes]) -> Output:
    return _found(pipeline, fields)[1].output


def _draw(pipeline: Pipeline, fields: dict[str, bytes]) -> bytes:
    frame, findings = _found(pipeline, fields)
    return encoded(draw_sheet(frame.color_rgb, frame.camera.color, pipeline.target, findings))


def _found(pipeline: Pipeline, fields: dict[str, bytes]) -> tuple[RgbdFrame, Findings]:
    frame = frame_of_files(fields["color"], fields.get("depth"), fields["camera"])
    findings = look(pipeline, frame)
    if findings.output.outcome is Outcome.BAD_FRAME:
        raise InputError("color", findings.output.reason)
    return frame, findings
