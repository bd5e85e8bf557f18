"""The paper's eight kinds of bad conditions, and what else a picture may be noted to show."""

from __future__ import annotations

from collections.abc import Iterable

PAPER_CONDITIONS = (
    "blur",
    "low_light",
    "obstruction",
    "distortion",
    "far",
    "orientation",
    "flare",
    "close",
)
"""Fig. "Samples from the dataset": the environmental variables."""

_KINDS = {
    "motion_blur": "blur",
    "defocus": "blur",
    "occluder": "obstruction",
    "tilted": "orientation",
}
"""Finer words for some of the eight."""

OTHER_CONDITIONS = frozenset(
    {"nominal", "mixed", "over_exposed", "glossy", "scratched", "hard_negatives"}
    | {"arm", "lookalike", "noise", "partial", "shadow", "wall", "gloss", "worn"}
)
"""Noted as well, and none of the eight."""

KNOWN_CONDITIONS = frozenset(PAPER_CONDITIONS) | frozenset(_KINDS) | OTHER_CONDITIONS


def paper_conditions(noted: Iterable[str]) -> tuple[str, ...]:
    """Which of the eight a picture shows, in the paper's order."""
    shows = {_KINDS.get(name, name) for name in noted}
    return tuple(c for c in PAPER_CONDITIONS if c in shows)
