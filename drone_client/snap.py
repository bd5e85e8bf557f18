"""``drone-client snap``: one picture, asked over HTTP."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Final

import httpx

from drone_client.errors import LinkError, SourceError
from rgbd_wire.camera import load_camera

MAX_FILE_BYTES: Final = 32 * 1024 * 1024


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
    try:
        response = httpx.post(f"{url.rstrip('/')}/v1/localize", files=files, timeout=timeout_s)
    except httpx.InvalidURL as error:
        raise LinkError(f"address {url!r}: {error}; try http://127.0.0.1:8080") from None
    except httpx.HTTPError as error:
        raise LinkError(
            f"no answer from {url}: {error or type(error).__name__}; is edge-service running there?"
        ) from None
    try:
        body = response.json()
    except ValueError:
        raise LinkError(f"{url} answered {response.status_code}, but no JSON") from None
    if response.status_code != httpx.codes.OK or not isinstance(body, dict):
        detail = body.get("detail", body) if isinstance(body, dict) else body
        raise SourceError(f"{url} refused ({response.status_code}): {detail}")
    return body


def _read(path: Path) -> bytes:
    try:
        with path.open("rb") as file:
            data = file.read(MAX_FILE_BYTES + 1)
    except OSError as error:
        raise SourceError(f"{path}: {error.strerror}") from None
    if len(data) > MAX_FILE_BYTES:
        raise SourceError(f"{path}: over {MAX_FILE_BYTES} bytes")
    return data
