"""The multipart body of a request: bounded while it is read, held in memory, never on disk."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncGenerator

from fastapi import Request
from starlette.datastructures import FormData, UploadFile
from starlette.formparsers import MultiPartException, MultiPartParser

from edge_service.errors import InputError

FIELDS = ("color", "depth", "camera")
READ_TIMEOUT_S = 20.0
"""A client that takes longer to hand in its pictures is dropped."""


class TooLargeError(Exception):
    """The body is larger than it may be."""


class TooSlowError(Exception):
    """The body took longer than it may."""


async def read_fields(request: Request, max_bytes: int) -> dict[str, bytes]:
    """The fields of a multipart form by name, each at most once.

    Raises:
        TooLargeError: over ``max_bytes`` in all.
        TooSlowError: not whole within ``READ_TIMEOUT_S``.
        InputError: no multipart form, an unknown or repeated field, or a text that is none.
    """
    kind = request.headers.get("content-type", "")
    if not kind.lower().startswith("multipart/form-data"):
        raise InputError("form", f"content type must be multipart/form-data, not {kind[:80]!r}")
    declared = request.headers.get("content-length", "0")
    if declared.isdigit() and int(declared) > max_bytes:
        raise TooLargeError
    parser = MultiPartParser(
        request.headers,
        _bounded(request, max_bytes),
        max_files=len(FIELDS),
        max_fields=len(FIELDS),
        max_part_size=max_bytes,
    )
    parser.spool_max_size = max_bytes + 1  # in memory: the root file system is read-only
    try:
        async with asyncio.timeout(READ_TIMEOUT_S):
            form = await parser.parse()
        try:
            return await _contents(form)
        finally:
            await form.close()
    except TimeoutError:
        raise TooSlowError from None
    except MultiPartException as error:
        raise InputError("form", error.message) from None
    except UnicodeError:  # some of Python's codecs raise it bare, and some give what is no text
        raise InputError("form", "a text in it is none in the charset that it names") from None


async def _contents(form: FormData) -> dict[str, bytes]:
    fields: dict[str, bytes] = {}
    for name, value in form.multi_items():
        if name not in FIELDS:
            raise InputError("form", f"unknown field {name[:40]!r}; known: {', '.join(FIELDS)}")
        if name in fields:
            raise InputError(name, "given more than once")
        fields[name] = await value.read() if isinstance(value, UploadFile) else value.encode()
    return fields


async def _bounded(request: Request, max_bytes: int) -> AsyncGenerator[bytes, None]:
    received = 0
    async for chunk in request.stream():
        received += len(chunk)
        if received > max_bytes:
            raise TooLargeError
        yield chunk
