"""The interface on one self-contained page: no script, nothing loaded from elsewhere."""

from __future__ import annotations

import html
import json
import re
from typing import Any

_STYLE = (
    "body{font:16px/1.5 system-ui,sans-serif;max-width:60rem;margin:2rem auto;padding:0 1rem;"
    "color:#222;background:#fff}code,pre{font:14px/1.4 ui-monospace,monospace;background:#f3f3f3}"
    "pre{padding:.7rem;overflow:auto}code{padding:0 .2rem}h2{margin-top:2.5rem;border-top:1px "
    "solid #ddd;padding-top:1rem}summary{cursor:pointer}dt{font-weight:600}"
)

_INNER_LIST = re.compile(r"\[[^\[\]{}]*\]")
"""A list of numbers, which reads better on one line."""


def page(openapi: dict[str, Any]) -> str:
    """HTML of an OpenAPI description."""
    info = openapi["info"]
    parts = [
        f"<h1>{_text(info['title'])} {_text(info['version'])}</h1>",
        _prose(info["description"]),
        '<p>For machines: <a href="/openapi.json">/openapi.json</a></p>',
    ]
    for path, methods in openapi["paths"].items():
        parts += [_operation(path, method, o) for method, o in methods.items()]
    return (
        '<!doctype html><html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width">'
        f"<title>{_text(info['title'])}</title><style>{_STYLE}</style></head>"
        f"<body>{''.join(parts)}</body></html>"
    )


def _operation(path: str, method: str, operation: dict[str, Any]) -> str:
    parts = [
        f"<h2><code>{method.upper()} {_text(path)}</code> {_text(operation['summary'])}</h2>",
        _prose(operation.get("description", "")),
    ]
    body = operation.get("requestBody")
    if body is not None:
        parts.append(_prose(body["description"]))
        parts.append(_form(path, body))
        for content in body["content"].values():
            parts.append(_fields(content["schema"]))
    for status, response in operation["responses"].items():
        parts.append(_response(status, response))
    return "".join(parts)


def _fields(schema: dict[str, Any]) -> str:
    rows = []
    for name, field in schema["properties"].items():
        need = "required" if name in schema.get("required", []) else "optional"
        rows.append(f"<dt><code>{_text(name)}</code> ({need})</dt>")
        rows.append(f"<dd>{_text(field.get('description', ''))}")
        if "example" in field:
            rows.append(f"<pre>{_text(field['example'])}</pre>")
        rows.append("</dd>")
    return f"<dl>{''.join(rows)}</dl>"


def _form(path: str, body: dict[str, Any]) -> str:
    """A form that hands files in and shows the picture that comes back."""
    rows = []
    for content in body["content"].values():
        required = content["schema"].get("required", [])
        for name in content["schema"]["properties"]:
            need = " required" if name in required else ""
            rows.append(
                f'<p><label>{_text(name)} <input type="file" name="{_text(name)}"{need}>'
                "</label></p>"
            )
    return (
        f'<form action="{_text(path)}?draw=1" method="post" enctype="multipart/form-data">'
        f"{''.join(rows)}<p><button>Draw what is found</button></p></form>"
    )


def _response(status: str, response: dict[str, Any]) -> str:
    shown = []
    for content in response.get("content", {}).values():
        examples = {k: e["value"] for k, e in content.get("examples", {}).items()}
        if "example" in content:
            examples["example"] = content["example"]
        shown += [f"<p>{_text(name)}:</p>{_example(value)}" for name, value in examples.items()]
    summary = f"<code>{_text(status)}</code> {_text(response['description'])}"
    if not shown:
        return f"<p>{summary}</p>"
    return f"<details><summary>{summary}</summary>{''.join(shown)}</details>"


def _example(value: Any) -> str:
    if not isinstance(value, str):
        indented = json.dumps(value, indent=2)
        value = _INNER_LIST.sub(lambda m: " ".join(m[0].split()), indented)
    return f"<pre>{_text(value)}</pre>"


def _prose(markdown: str) -> str:
    """Paragraphs, `code` and fenced blocks: as much Markdown as the descriptions use."""
    parts = []
    for n, block in enumerate(markdown.split("```")):
        if n % 2:
            parts.append(f"<pre>{_text(block.strip())}</pre>")
            continue
        for paragraph in filter(None, map(str.strip, block.split("\n\n"))):
            spans = paragraph.split("`")
            line = "".join(
                f"<code>{_text(s)}</code>" if i % 2 else _text(s) for i, s in enumerate(spans)
            )
            parts.append(f"<p>{line}</p>")
    return "".join(parts)


def _text(value: Any) -> str:
    return html.escape(str(value))
