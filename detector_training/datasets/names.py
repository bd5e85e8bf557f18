"""Which level a label's name means: the target's own names, and what the user says of others."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field

from detector_training.datasets.values import shown
from detector_training.errors import DatasetError
from target_pose.target import Level

_KNOWN = ", ".join(Level)


@dataclass(frozen=True, slots=True)
class LabelNames:
    """What labels are called in a data set that others made.

    Raises:
        DatasetError: a name is both mapped and ignored.
    """

    mapped: Mapping[str, Level] = field(default_factory=dict)
    ignored: frozenset[str] = frozenset()

    def __post_init__(self) -> None:
        if both := sorted(self.ignored & set(self.mapped)):
            raise DatasetError(f"label {both[0]!r} is both mapped and ignored; choose one")

    @classmethod
    def parse(cls, maps: Iterable[str] = (), ignores: Iterable[str] = ()) -> LabelNames:
        """From a command's ``--map NAME=LEVEL`` and ``--ignore NAME``.

        Raises:
            DatasetError: a mapping is malformed or names no level.
        """
        mapped: dict[str, Level] = {}
        for text in maps:
            name, equals, level = text.rpartition("=")
            if not (name and equals):
                raise DatasetError(f"--map {text}: write --map NAME=LEVEL, as in rings=T_good")
            if level not in tuple(Level):
                raise DatasetError(f"--map {text}: {level!r} is not one of {_KNOWN}")
            if mapped.get(name, level) != level:
                raise DatasetError(f"--map {text}: {name!r} is mapped to {mapped[name]} already")
            mapped[name] = Level(level)
        return cls(mapped, frozenset(ignores))

    def level(self, name: object) -> Level | None:
        """The level that ``name`` means; None where its boxes are to be ignored.

        Raises:
            DatasetError: the name is unknown; says which are known and what to do.
        """
        if isinstance(name, str):
            if name in self.ignored:
                return None
            if name in self.mapped:
                return self.mapped[name]
            if name in tuple(Level):
                return Level(name)
        plain = name if isinstance(name, str) and name.isidentifier() else "NAME"
        raise DatasetError(
            f"label {shown(name)} is not one of {_KNOWN}; "
            f"use --map {plain}={Level.GOOD} (or another level) or --ignore {plain}"
        )
