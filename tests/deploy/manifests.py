"""The deployment files as their users see them: rendered, with variables at their defaults."""

from __future__ import annotations

import functools
import re
import shutil
import subprocess
from pathlib import Path
from typing import Any

import pytest
import yaml

ROOT = Path(__file__).parents[2]
OVERLAYS = sorted(
    path.parent.name for path in ROOT.glob("deploy/k8s/overlays/*/kustomization.yaml")
)
_VARIABLE = re.compile(r"\$\{(\w+)(?::?-([^}]*))?\}")


@functools.cache
def _rendered(overlay: str) -> str:
    folder = ROOT / "deploy/k8s/overlays" / overlay
    result = subprocess.run(
        ["kubectl", "kustomize", str(folder)], capture_output=True, text=True, check=False
    )
    assert result.returncode == 0, result.stderr
    return result.stdout


def rendered(overlay: str) -> list[dict[str, Any]]:
    """All objects of an overlay, as ``kubectl apply -k`` would send them."""
    if shutil.which("kubectl") is None:
        pytest.skip("kubectl is not installed: overlays cannot be rendered")
    return [document for document in yaml.safe_load_all(_rendered(overlay)) if document]


def of_kind(objects: list[dict[str, Any]], kind: str) -> list[dict[str, Any]]:
    """The objects of one kind."""
    return [o for o in objects if o["kind"] == kind]


def only(objects: list[dict[str, Any]], kind: str) -> dict[str, Any]:
    """The one object of its kind."""
    (found,) = of_kind(objects, kind)
    return found


def compose_with_defaults(*files: str) -> dict[str, Any]:
    """Compose files, each above those before it, as an engine reads them when no variable is set.

    Args:
        files: their names; none: compose.yaml alone.
    """
    merged: dict[str, Any] = {}
    for name in files or ("compose.yaml",):
        text = (ROOT / name).read_text(encoding="utf-8")
        merged = _above(merged, yaml.safe_load(_VARIABLE.sub(lambda m: m[2] or "", text)))
    return merged


def _above(below: Any, value: Any) -> Any:
    """Mappings are merged, lists (ports, volumes) put together, all else replaced."""
    if isinstance(below, dict) and isinstance(value, dict):
        return below | {k: _above(below.get(k), v) for k, v in value.items()}
    if isinstance(below, list) and isinstance(value, list):
        return below + value
    return value


def dockerfile() -> list[tuple[str, str]]:
    """Instructions of the Dockerfile: (name, arguments), in order, continued lines joined."""
    text = (ROOT / "Dockerfile").read_text(encoding="utf-8")
    text = re.sub(r"^\s*#.*\n", "", text, flags=re.MULTILINE).replace("\\\n", " ")
    lines = (line.strip() for line in text.splitlines())
    return [(name, rest) for name, _, rest in (line.partition(" ") for line in lines if line)]
