"""JSON answers: a body with its status, or what is wrong in one sentence."""

from __future__ import annotations

from fastapi.responses import JSONResponse
from pydantic import BaseModel

from edge_service.http.bodies import ErrorBody

RETRY_AFTER_S = 1


def answer(body: BaseModel, status: int = 200) -> JSONResponse:
    """A body with its status."""
    return JSONResponse(body.model_dump(mode="json"), status)


def refusal(
    status: int, detail: str, field: str | None = None, *, close: bool = False
) -> JSONResponse:
    """What is wrong; a 503 says when to ask again.

    Args:
        status: HTTP status code.
        detail: one sentence.
        field: the form field at fault, if it is one.
        close: end the connection, since the rest of the request is not read.
    """
    headers = {}
    if status == 503:
        headers["Retry-After"] = str(RETRY_AFTER_S)
    if close:
        headers["Connection"] = "close"
    return JSONResponse(ErrorBody(field=field, detail=detail).model_dump(), status, headers)
