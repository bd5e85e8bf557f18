"""Colour and depth of one exposure, found by their stamps and never by their numbers.

Two sensors in one housing drop frames each on its own, start at different moments and may count
from anywhere: the fifth colour picture has nothing to do with the fifth depth picture. What
belongs together lies close in time, so of all ways to pair two streams the one is taken in which

    sum over pairs of (tolerance - |t_colour - t_depth|)

is largest: no pair beyond the tolerance, each picture used once, order kept (on a line the best
pairing never crosses). Two pictures further apart than the tolerance do not compete, so the
streams fall into small groups, each solved by itself as soon as nothing that may still come can
change it. Where a stream's pictures are over two tolerances apart, that is at once.
"""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import Final, Generic, TypeVar

C = TypeVar("C")
D = TypeVar("D")

CAPACITY: Final = 16
"""Pictures of one stream that wait; at 30 Hz half a second of a sensor that lost its partner."""
_FOREVER: Final = 1 << 63


class Unpaired(StrEnum):
    """Why a picture has no partner."""

    NO_PARTNER = "no partner"
    """None within the tolerance, or another one was closer to it."""
    TOO_OLD = "too old"
    """A depth picture whose colour had gone out before it came."""
    OUT_OF_ORDER = "out of order"
    """Older than the one before it in its own stream."""
    DUPLICATE = "duplicate stamp"
    """As old as the one before it in its own stream."""


@dataclass(frozen=True, slots=True)
class Pair(Generic[C, D]):
    """A colour picture, with the depth picture that belongs to it if there is one."""

    t_color_ns: int
    color: C
    t_depth_ns: int | None
    depth: D | None


class Pairer(Generic[C, D]):
    """Takes both streams as they come and gives colours in order; not thread-safe, no clock.

    All stamps are of one time line. At most ``CAPACITY`` pictures of each stream wait; when there
    are more, the oldest is settled with what is known.
    """

    def __init__(self, tolerance_ns: int, spacing_ns: int = 1, capacity: int = CAPACITY) -> None:
        """Nothing waits yet.

        Args:
            tolerance_ns: two pictures further apart are not of one exposure.
            spacing_ns: least time between two pictures of one stream. If it is over two
                tolerances, two that find each other go out at once; where it turns out smaller,
                a better partner may come too late, and nothing worse.
            capacity: pictures of one stream that wait at most.
        """
        if tolerance_ns < 0 or spacing_ns < 1 or capacity < 1:
            raise ValueError(
                f"tolerance {tolerance_ns} < 0, spacing {spacing_ns} < 1 or capacity {capacity} < 1"
            )
        self.paired = 0
        self.unpaired_color: Counter[Unpaired] = Counter()
        """Colours: those without a partner went out alone, the others were dropped."""
        self.unpaired_depth: Counter[Unpaired] = Counter()
        """Depths that were dropped."""
        self._tolerance_ns = tolerance_ns
        self._spacing_ns = spacing_ns
        self._capacity = capacity
        self._colors: deque[tuple[int, C]] = deque()
        self._depths: deque[tuple[int, D]] = deque()
        self._newest_color_ns: int | None = None
        self._newest_depth_ns: int | None = None
        self._last_alone_ns: int | None = None
        """The last colour that went out without depth."""

    def add_color(self, t_ns: int, color: C) -> list[Pair[C, D]]:
        """A colour picture has come; what is settled by that."""
        reason = _misplaced(t_ns, self._newest_color_ns)
        if reason is not None:
            self.unpaired_color[reason] += 1
            return []
        self._newest_color_ns = t_ns
        self._colors.append((t_ns, color))
        return self._settle()

    def add_depth(self, t_ns: int, depth: D) -> list[Pair[C, D]]:
        """A depth picture has come; what is settled by that."""
        reason = _misplaced(t_ns, self._newest_depth_ns)
        if reason is not None:
            self.unpaired_depth[reason] += 1
            return []
        self._newest_depth_ns = t_ns
        self._depths.append((t_ns, depth))
        return self._settle()

    def release(self, before_ns: int) -> list[Pair[C, D]]:
        """Settle whatever is older than a time, with what is known: colours go out alone."""
        return self._settle(forced_before_ns=before_ns)

    def flush(self) -> list[Pair[C, D]]:
        """Settle everything: nothing more will come."""
        return self._settle(forced_before_ns=_FOREVER)

    @property
    def waiting(self) -> int:
        """Pictures that wait, of both streams."""
        return len(self._colors) + len(self._depths)

    def _settle(self, forced_before_ns: int = -_FOREVER) -> list[Pair[C, D]]:
        out: list[Pair[C, D]] = []
        while self._colors or self._depths:
            n_colors, n_depths = self._first_group()
            oldest_ns = min(queue[0][0] for queue in (self._colors, self._depths) if queue)
            if not (oldest_ns < forced_before_ns or self._is_closed(n_colors, n_depths)):
                if max(len(self._colors), len(self._depths)) <= self._capacity:
                    break
                # Only the oldest of an endless group: its best partner so far
                n_colors, n_depths = self._without_newer(n_colors, n_depths)
            out += self._take(n_colors, n_depths)
        return out

    def _first_group(self) -> tuple[int, int]:
        """Numbers of colours and depths of the oldest group, in which each reaches the next."""
        n_colors = n_depths = 0
        last_ns: int | None = None
        while True:
            color_ns = self._colors[n_colors][0] if n_colors < len(self._colors) else _FOREVER
            depth_ns = self._depths[n_depths][0] if n_depths < len(self._depths) else _FOREVER
            next_ns = min(color_ns, depth_ns)
            if next_ns == _FOREVER:
                return n_colors, n_depths
            if last_ns is not None and next_ns > last_ns + self._tolerance_ns:
                return n_colors, n_depths
            last_ns = next_ns
            if color_ns <= depth_ns:
                n_colors += 1
            else:
                n_depths += 1

    def _is_closed(self, n_colors: int, n_depths: int) -> bool:
        """Whether nothing that may still come reaches a member of the group.

        Two that found each other rely on the stated spacing. One that is alone goes alone only
        when the other stream has passed it: a camera may be faster for once than it says.
        """
        spacing_ns = self._spacing_ns if n_colors == n_depths == 1 else 1

        def out_of_reach(
            queue: Sequence[tuple[int, object]], n: int, newest_ns: int | None
        ) -> bool:
            if n == 0:
                return True
            if newest_ns is None:
                return False
            return queue[n - 1][0] + self._tolerance_ns < newest_ns + spacing_ns

        return out_of_reach(self._colors, n_colors, self._newest_depth_ns) and out_of_reach(
            self._depths, n_depths, self._newest_color_ns
        )

    def _without_newer(self, n_colors: int, n_depths: int) -> tuple[int, int]:
        """The group cut after its oldest colour and that colour's partner."""
        if n_colors == 0:
            return 0, 1
        if n_depths == 0:
            return 1, 0
        partner = dict(self._best(n_colors, n_depths)).get(0)
        if partner is not None:
            return 1, partner + 1
        # It goes alone; the depths are left for the colours after it
        return 1, 0

    def _take(self, n_colors: int, n_depths: int) -> list[Pair[C, D]]:
        """Settle the first so many of each."""
        pairs = dict(self._best(n_colors, n_depths))
        colors = [self._colors.popleft() for _ in range(n_colors)]
        depths = [self._depths.popleft() for _ in range(n_depths)]
        used = set(pairs.values())
        for j, (t_ns, _) in enumerate(depths):
            if j not in used:
                gone_ns = self._last_alone_ns
                late = gone_ns is not None and t_ns <= gone_ns + self._tolerance_ns
                self.unpaired_depth[Unpaired.TOO_OLD if late else Unpaired.NO_PARTNER] += 1
        out: list[Pair[C, D]] = []
        for i, (t_ns, color) in enumerate(colors):
            if i in pairs:
                self.paired += 1
                out.append(Pair(t_ns, color, *depths[pairs[i]]))
            else:
                self._last_alone_ns = t_ns
                self.unpaired_color[Unpaired.NO_PARTNER] += 1
                out.append(Pair(t_ns, color, None, None))
        return out

    def _best(self, n_colors: int, n_depths: int) -> list[tuple[int, int]]:
        colors = [self._colors[i][0] for i in range(n_colors)]
        depths = [self._depths[j][0] for j in range(n_depths)]
        return best_pairs(colors, depths, self._tolerance_ns)


def best_pairs(
    colors_ns: Sequence[int], depths_ns: Sequence[int], tolerance_ns: int
) -> list[tuple[int, int]]:
    """Indices (colour, depth) of the pairs whose sum of (tolerance + 1 - distance) is largest.

    Both are sorted. Takes n x m steps: for a handful of pictures.
    """
    n, m = len(colors_ns), len(depths_ns)
    # best[i][j]: the largest sum from colours i.. and depths j..
    best = [[0] * (m + 1) for _ in range(n + 1)]
    for i in range(n - 1, -1, -1):
        for j in range(m - 1, -1, -1):
            worth = tolerance_ns + 1 - abs(colors_ns[i] - depths_ns[j])
            together = worth + best[i + 1][j + 1] if worth > 0 else 0
            best[i][j] = max(best[i + 1][j], best[i][j + 1], together)
    pairs: list[tuple[int, int]] = []
    i = j = 0
    while i < n and j < m:
        worth = tolerance_ns + 1 - abs(colors_ns[i] - depths_ns[j])
        if worth > 0 and best[i][j] == worth + best[i + 1][j + 1]:
            pairs.append((i, j))
            i, j = i + 1, j + 1
        elif best[i][j] == best[i + 1][j]:
            i += 1
        else:
            j += 1
    return pairs


def pair_lists(
    colors_ns: Sequence[int], depths_ns: Sequence[int], tolerance_ns: int
) -> list[int | None]:
    """For each colour the index of its depth; both lists are sorted and may be long."""
    pairer: Pairer[int, int] = Pairer(tolerance_ns)
    pairs: list[Pair[int, int]] = []
    j = 0
    for i, t_ns in enumerate(colors_ns):
        while j < len(depths_ns) and depths_ns[j] <= t_ns:
            pairs += pairer.add_depth(depths_ns[j], j)
            j += 1
        pairs += pairer.add_color(t_ns, i)
    for k in range(j, len(depths_ns)):
        pairs += pairer.add_depth(depths_ns[k], k)
    pairs += pairer.flush()
    return [pair.depth for pair in pairs]


def _misplaced(t_ns: int, newest_ns: int | None) -> Unpaired | None:
    if newest_ns is None or t_ns > newest_ns:
        return None
    return Unpaired.DUPLICATE if t_ns == newest_ns else Unpaired.OUT_OF_ORDER
