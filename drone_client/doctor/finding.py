"""What a check found: one line each, with what to do about it."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum


class Finding(StrEnum):
    """How it is."""

    OK = "ok"
    WARNING = "warning"
    """It flies, but worse than it could, or it could not be told for sure."""
    FAULT = "fault"
    """Do not fly like that."""
    UNCHECKED = "not checked"


@dataclass(frozen=True, slots=True)
class Check:
    """One thing that was looked at."""

    area: str
    """Machine, files, vehicle, camera, service."""
    name: str
    finding: Finding
    found: str
    """What was found, with its numbers."""
    advice: str = ""
    """What to change; empty where nothing has to be."""


def ok(area: str, name: str, found: str) -> Check:
    """As it should be."""
    return Check(area, name, Finding.OK, found)


def unchecked(area: str, name: str, why: str) -> Check:
    """Could not be looked at."""
    return Check(area, name, Finding.UNCHECKED, why)


def judged(area: str, name: str, finding: Finding, found: str, advice: str) -> Check:
    """With advice unless it is well."""
    return Check(area, name, finding, found, "" if finding is Finding.OK else advice)
