"""docs/protocol.md says what the code does: fields and their order, reasons, bounds, examples."""

from __future__ import annotations

import dataclasses
import re
from pathlib import Path

import pytest

from rgbd_wire.depth import DepthTable, lattice_values
from rgbd_wire.envelope import MAGIC, MAX_BODY_BYTES, PREFIX_BYTES, VERSION, Kind
from rgbd_wire.errors import Reject
from rgbd_wire.frame_codec import MAX_HEADER_BYTES
from rgbd_wire.messages import (
    Ack,
    FrameHeader,
    Intrinsics,
    LevelBox,
    Outcome,
    Result,
    Status,
    TargetPose,
)
from rgbd_wire.probe import PROBE_BYTES, Probe
from rgbd_wire.streams import FRAME, PREFIX, PROBE, RESULT, worker_key, worker_status_key

PAGE = (Path(__file__).parents[3] / "docs" / "protocol.md").read_text(encoding="utf-8")
SECTIONS = dict(re.findall(r"^##+ (.+?)\n(.*?)(?=^##+ |\Z)", PAGE, re.MULTILINE | re.DOTALL))


def first_cells(section, heading):
    """The words in backticks of a table's first column, from top to bottom."""
    rows = SECTIONS[section].split(f"| {heading}", 1)[1].split("\n\n", 1)[0].splitlines()[2:]
    return [word for row in rows for word in re.findall(r"`(\w+)`", row.split("|")[1])]


@pytest.mark.parametrize(
    ("section", "heading", "message"),
    [
        ("FRAME", "header field", FrameHeader),
        ("FRAME", "Intrinsics field", Intrinsics),
        ("ACK", "field", Ack),
        ("RESULT", "field", Result),
        ("STATUS", "field", Status),
        ("RESULT", "TargetPose field", TargetPose),
        ("RESULT", "LevelBox field", LevelBox),
    ],
)
def test_fields_in_their_order(section, heading, message):
    """Each table lists the fields of its message, in the order in which they are sent."""
    assert first_cells(section, heading) == list(message.__struct_fields__)


def test_every_reason_and_outcome():
    """The tables of reasons and outcomes are complete."""
    reasons = first_cells("What a receiver checks", "reason")
    assert sorted(reasons) == sorted(r.value for r in Reject)
    assert first_cells("RESULT", "outcome") == [o.value for o in Outcome]
    assert all(f"`{table.value}`" in SECTIONS["Depth"] for table in DepthTable)


def test_the_envelope():
    """Magic, version, kinds and bounds."""
    text = SECTIONS["Envelope"].replace(" ", "").replace("\u202f", "")
    assert f"`{MAGIC.decode()}`" in text
    assert f"|version|{VERSION}|" in text
    assert f"{PREFIX_BYTES}bytesandabody" in text
    for kind in Kind:
        assert f"{kind.value}{kind.name}" in text
        assert f"{kind.name}≤{MAX_BODY_BYTES[kind]}" in text
    assert f"≤ {MAX_HEADER_BYTES}" in SECTIONS["FRAME"]
    assert PAGE.startswith(f"# Protocol, version {VERSION}\n")


def test_the_probe():
    """Its fields in their order, eight bytes each behind the envelope."""
    rows = re.findall(r"^\| +(\d+) \| `(\w+)`", SECTIONS["PROBE"], re.MULTILINE)
    names = [field.name for field in dataclasses.fields(Probe)]
    assert rows == [(str(PREFIX_BYTES + 8 * i), name) for i, name in enumerate(names)]
    assert f"{PROBE_BYTES} bytes" in SECTIONS["PROBE"]


def test_keys():
    """The keys are those of the stream table, and carry the version."""
    assert PREFIX.endswith(f"/v{VERSION}")
    for key in (
        FRAME.key("{drone}", "{worker}"),
        RESULT.key("{drone}", "{worker}"),
        PROBE.key("{drone}", "{worker}"),
        worker_key("{worker}"),
        worker_status_key("{worker}"),
    ):
        assert f"`{key}`" in SECTIONS["Channels"]


def test_the_rank_example():
    """The worked example comes out of the code."""
    values = lattice_values(173.28, 0.001)
    assert f"there are {values.size} values" in SECTIONS["Depth"].replace("\n", " ")
    assert values[733] == 1733
    assert "whose rank is 733" in SECTIONS["Depth"]
