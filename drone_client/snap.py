"""``drone-client snap``: one picture, asked over HTTP."""

from __future__ import annotations

import json
import time
from pathlib import Path
from typing import Any, Final

import httpx

from drone_client.errors import LinkError, SourceError
from rgbd_wire.camera import load_camera

MAX_FILE_BYTES: Final = 32 * 1024 * 1024
MAX_ANSWER_BYTES: Final = 1024 * 1024
MAX_DETAIL_CHARACTERS: Final = 500


def snap(
    url: str, color: Path, depth: Path | None, camera: Path, timeout_s: float
) -> dict[str, Any]:
    """Ask a service where the target is in one picture; returns its JSON.

    Raises:
        SourceError: a file cannot be read, or the service refuses its content.
        CameraFileError: the camera file is wrong.
        LinkError: nobody answers there, or not as the service does.
    """
    load_camera(camera)  # a wrong one is told here, without a network
    files = {"color": (color.name, _read(color))}
    if depth is not None:
        files["depth"] = (depth.name, _read(depth))
    files["camera"] = (camera.name, _read(camera))
    return ask(url, files, timeout_s)


def ask(url: str, files: dict[str, tuple[str, bytes]], timeout_s: float) -> dict[str, Any]:
    """What a service answers to the files of a form, by field: name and content.

    Raises:
        SourceError: the service refuses their content.
        LinkError: nobody answers there, or not as the service does.
    """
    return _answer(url, "POST", "/v1/localize", files, timeout_s)


def get(url: str, path: str, timeout_s: float) -> dict[str, Any]:
    """What a service answers to a GET; raises as ``ask``."""
    return _answer(url, "GET", path, None, timeout_s)


def _answer(
    url: str,
    method: str,
    path: str,
    files: dict[str, tuple[str, bytes]] | None,
    timeout_s: float,
) -> dict[str, Any]:
    status, content = _send(url, method, path, files, timeout_s)
    try:
        body = json.loads(content)
    except (ValueError, RecursionError):
        raise LinkError(f"{url} answered {status}, but no JSON: is it edge-service?") from None
    if status != httpx.codes.OK or not isinstance(body, dict):
        raise SourceError(f"{url} refused ({status}): {_said(body)}")
    return body


def _send(
    url: str,
    method: str,
    path: str,
    files: dict[str, tuple[str, bytes]] | None,
    timeout_s: float,
) -> tuple[int, bytes]:
    """Status and body of the service's answer, which is short."""
    content = b""
    give_up = time.monotonic() + timeout_s
    try:
        with httpx.stream(
            method, f"{url.rstrip('/')}{path}", files=files, timeout=timeout_s
        ) as response:
            for chunk in response.iter_bytes(65_536):
                content += chunk
                if time.monotonic() > give_up:
                    raise LinkError(f"{url} is still answering after {timeout_s:g} s")
                if len(content) > MAX_ANSWER_BYTES:
                    raise LinkError(
                        f"{url} answered over {MAX_ANSWER_BYTES} bytes: no edge-service"
                    )
    except (httpx.InvalidURL, httpx.UnsupportedProtocol, UnicodeError):
        raise LinkError(f"address {url!r} is none, try http://127.0.0.1:8080") from None
    except httpx.HTTPError as error:
        reason = str(error) or type(error).__name__
        raise LinkError(f"no answer from {url}: {reason}; is edge-service running there?") from None
    return response.status_code, content


def _said(body: object) -> str:
    """What the service says is wrong, or all that it said."""
    detail = body.get("detail", body) if isinstance(body, dict) else body
    return str(detail)[:MAX_DETAIL_CHARACTERS]


def _read(path: Path) -> bytes:
    try:
        with path.open("rb") as file:
            data = file.read(MAX_FILE_BYTES + 1)
    except OSError as error:
        raise SourceError(f"{path}: {error.strerror}") from None
    if len(data) > MAX_FILE_BYTES:
        raise SourceError(f"{path}: over {MAX_FILE_BYTES} bytes")
    return data
