"""A link that cannot be is refused with a reason."""

from __future__ import annotations

import json
from typing import Any

import pytest

from link_emulator.errors import ImpairmentError
from link_emulator.impairments import Impairments


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"rate_mbit": 0}, "rate_mbit is 0"),
        ({"rate_mbit": float("nan")}, "rate_mbit is nan"),
        ({"delay_ms": -1}, "delay_ms is -1"),
        ({"jitter_ms": float("inf")}, "jitter_ms is inf"),
        ({"queue_bytes": -5}, "queue_bytes is -5"),
        ({"loss": 1.5}, "loss is 1.5"),
        ({"burst": 4}, "a burst needs a loss"),
        ({"loss": 0.01, "burst": 0.5}, "burst is 0.5"),
        ({"loss": 0.9, "burst": 2}, "at most 0.666"),
        ({"cuts_ms": ((5, 2),)}, "0 <= from <= to"),
    ],
)
def test_link_that_cannot_be_is_refused(values: dict[str, Any], message: str) -> None:
    """The message says the value and what would do."""
    with pytest.raises(ImpairmentError, match=message):
        Impairments(**values)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"speed": 3}, "no impairment 'speed'; there are rate_mbit"),
        ({"loss": "0.1"}, "loss is '0.1'; it is a float"),
        ({"loss": None}, "loss is None"),
        ({"loss": True}, "loss is True"),
        ({"cut": 1}, "cut is 1; it is a bool"),
        ({"queue_bytes": 1.5}, "queue_bytes is 1.5"),
        ({"cuts_ms": [[1, "2"]]}, "cuts_ms is"),
        ({"cuts_ms": [[1]]}, "from and to"),
    ],
)
def test_wrong_change_is_refused(changes: dict[str, Any], message: str) -> None:
    """What comes from outside is looked at before it is believed."""
    with pytest.raises(ImpairmentError, match=message):
        Impairments().changed(changes)


def test_all_values_survive_json() -> None:
    """What is sent to the relay is what it gets."""
    link = Impairments(20, 50, 9000, 10, 2, True, 0.03, 4, True, ((1, 2), (5, 6.5)))
    assert Impairments().changed(json.loads(json.dumps(link.as_json()))) == link


def test_no_loss_ends_the_bursts_as_well() -> None:
    """One change takes both back."""
    assert Impairments(loss=0.1, burst=4).changed({"loss": 0}) == Impairments()
