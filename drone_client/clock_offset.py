"""Clock offset and skew of a worker against the drone, from the echoes of probes.

For people to look at, and for the choice of a worker. **Never for the gate**: the gate needs
``d1 + d2`` alone, which is exact whatever the two clocks say (docs/freshness.md). How a round trip
splits into its two ways cannot be known better than the bound given here, and a worker that lies
about its stamps moves it.

With ``theta`` = worker's clock minus drone's clock and the four stamps of an echo, no delay being
negative,

    t3 - t4 <= theta <= t2 - t1,                                                        (1)

an interval as wide as the echo's round trip. While the two clocks part by at most
``MAX_SKEW_PPM``, the interval of an old echo holds later too, wider by what they may have drifted.
The intervals of a window all hold at once: the offset is the middle of what they have in common,
and the bound is half its width, at most ``RTT_min / 2`` plus the drift since that echo. When they
have nothing in common, a clock has stepped, and everything starts afresh.

The skew is the slope of the envelopes: the line below all ``t2 - t1`` that is nearest to them, and
the one above all ``t3 - t4`` (S. Moon, P. Skelly, D. Towsley, "Estimation and removal of clock skew
from network delay measurements", 1999). Queues only ever add delay, so an envelope does not see
them. Which slopes (1) allows at all is its hard range.

Pure: time is an argument. Memory is bounded: one point a second and direction.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from enum import StrEnum
from statistics import median_low

MAX_SKEW_PPM = 500
"""How fast two clocks may part at most: quartz is within 100 ppm, and Linux slews by up to 500."""
BUCKET_NS = 1_000_000_000
OFFSET_BUCKETS = 10
"""How much of the past the offset and the least round trip stand on; a route may change."""
SKEW_BUCKETS = 120
"""The longer, the smaller the error of the skew, as long as the room's temperature stands still."""
MIN_SKEW_BUCKETS = 4
RECENT_ROUND_TRIPS = 128
"""What the median is of."""
ROUNDING_NS = 1
"""Clocks are read as whole nanoseconds."""


@dataclass(frozen=True, slots=True)
class Echo:
    """The four stamps of a probe, and which start of the worker gave the inner two."""

    t1_ns: int
    """Sent, drone's clock."""
    t2_ns: int
    """Received, worker's clock."""
    t3_ns: int
    """Sent back, worker's clock."""
    t4_ns: int
    """Received, drone's clock."""
    worker_boot_id: int = 0

    @property
    def rtt_ns(self) -> int:
        """Time on the way, both ways: ``d1 + d2``, exact."""
        return (self.t4_ns - self.t1_ns) - (self.t3_ns - self.t2_ns)


@dataclass(frozen=True, slots=True)
class OffsetEstimate:
    """What is known of a worker's clock at ``at_ns``."""

    at_ns: int
    """Drone's clock."""
    offset_ns: int
    """Worker's clock minus drone's clock."""
    bound_ns: int
    """The true offset is within ``offset_ns`` +- this."""
    skew_ppm: float | None
    """How much faster the worker's clock runs; None: too early to say."""
    skew_bound_ppm: float | None
    """The stamps allow no skew further than this from ``skew_ppm``, if it stands still."""
    rtt_min_ns: int
    """Over the window of the offset."""
    rtt_p50_ns: int
    """Median of the last ones."""


class Taken(StrEnum):
    """What an echo did to the estimate."""

    FIRST = "first"
    USED = "used"
    RESTART = "restart"
    """Another start of the worker: afresh."""
    STEP = "step"
    """No offset fits it and the ones before: a clock has stepped, afresh."""
    OLD_START = "old_start"
    """Of a start of the worker that is over: not used."""
    IMPOSSIBLE = "impossible"
    """Back before it was sent, or held for longer than it was away: not used."""


@dataclass(frozen=True, slots=True)
class _Point:
    """One side of (1) at a time."""

    t_ns: int
    limit_ns: int


@dataclass(slots=True)
class _Bucket:
    """The tightest limits of a second."""

    number: int
    upper: _Point
    lower: _Point
    rtt_min_ns: int

    def add(self, upper: _Point, lower: _Point, rtt_ns: int) -> None:
        # The limits drift apart at one rate, so who is tighter at one time is so at every later.
        at_ns = max(self.upper.t_ns, upper.t_ns, self.lower.t_ns, lower.t_ns)
        self.upper = min(self.upper, upper, key=lambda p: _highest(p, at_ns))
        self.lower = max(self.lower, lower, key=lambda p: _lowest(p, at_ns))
        self.rtt_min_ns = min(self.rtt_min_ns, rtt_ns)


class ClockOffset:
    """Offset and skew of one worker's clock; not thread-safe."""

    def __init__(self) -> None:
        self.restarts = 0
        """Other starts of the worker."""
        self.steps = 0
        """Times that no offset fitted all echoes."""
        self.unused = 0
        """Echoes that were impossible or of a start that is over."""
        self._boot_id: int | None = None
        self._boot_id_before: int | None = None
        self._buckets: deque[_Bucket] = deque(maxlen=SKEW_BUCKETS)
        self._round_trips_ns: deque[int] = deque(maxlen=RECENT_ROUND_TRIPS)
        self._skew_ppm: tuple[float, float] | None = None

    def add(self, echo: Echo) -> Taken:
        """Take an echo; echoes may come in any order, within a second or so."""
        if echo.t4_ns < echo.t1_ns or echo.t3_ns < echo.t2_ns or echo.rtt_ns < 0:
            self.unused += 1
            return Taken.IMPOSSIBLE
        taken = self._start_of(echo)
        if taken is Taken.OLD_START:
            self.unused += 1
            return taken
        upper = _Point(echo.t1_ns, echo.t2_ns - echo.t1_ns + ROUNDING_NS)
        lower = _Point(echo.t4_ns, echo.t3_ns - echo.t4_ns - ROUNDING_NS)
        if self._buckets and not self._fits(upper, lower):
            self.steps += 1
            self._forget()
            taken = Taken.STEP
        self._round_trips_ns.append(echo.rtt_ns)
        number = echo.t4_ns // BUCKET_NS
        if self._buckets and number <= self._buckets[-1].number:
            self._buckets[-1].add(upper, lower, echo.rtt_ns)
        else:
            self._close_bucket()
            self._buckets.append(_Bucket(number, upper, lower, echo.rtt_ns))
        return taken

    def estimate(self, now_ns: int) -> OffsetEstimate | None:
        """What is known at ``now_ns`` [ns, drone's clock]; None: nothing has come back yet.

        Without new echoes the bound grows by ``MAX_SKEW_PPM``.
        """
        if not self._buckets:
            return None
        low_ns, high_ns = self._interval(now_ns)
        skew_ppm, skew_bound_ppm = self._skew_ppm or (None, None)
        return OffsetEstimate(
            at_ns=now_ns,
            offset_ns=(low_ns + high_ns) // 2,
            bound_ns=(high_ns - low_ns + 1) // 2,
            skew_ppm=skew_ppm,
            skew_bound_ppm=skew_bound_ppm,
            rtt_min_ns=min(b.rtt_min_ns for b in self._recent()),
            rtt_p50_ns=median_low(self._round_trips_ns),
        )

    def _start_of(self, echo: Echo) -> Taken:
        boot_id = echo.worker_boot_id
        if boot_id == self._boot_id:
            return Taken.USED
        if boot_id == self._boot_id_before:
            return Taken.OLD_START
        is_first = self._boot_id is None
        self._boot_id, self._boot_id_before = boot_id, self._boot_id
        if is_first:
            return Taken.FIRST
        self.restarts += 1
        self._forget()
        return Taken.RESTART

    def _forget(self) -> None:
        self._buckets.clear()
        self._round_trips_ns.clear()
        self._skew_ppm = None

    def _recent(self) -> list[_Bucket]:
        """The buckets of the offset's window, newest first; at least the newest."""
        oldest = self._buckets[-1].number - OFFSET_BUCKETS
        return [b for b in self._buckets if b.number > oldest]

    def _interval(self, at_ns: int) -> tuple[int, int]:
        """Lowest and highest offset that the window allows at a time."""
        recent = self._recent()
        return (
            max(_lowest(b.lower, at_ns) for b in recent),
            min(_highest(b.upper, at_ns) for b in recent),
        )

    def _fits(self, upper: _Point, lower: _Point) -> bool:
        low_at_upper, _ = self._interval(upper.t_ns)
        _, high_at_lower = self._interval(lower.t_ns)
        return low_at_upper <= upper.limit_ns and lower.limit_ns <= high_at_lower

    def _close_bucket(self) -> None:
        """Estimate the skew anew from the buckets that are complete."""
        if len(self._buckets) < MIN_SKEW_BUCKETS:
            return
        uppers = [b.upper for b in self._buckets]
        lowers = [b.lower for b in self._buckets]
        self._skew_ppm = _skew_ppm(uppers, lowers)
        if self._skew_ppm is None:
            # One line does not fit: the rate has changed. The newest seconds alone speak of it.
            for _ in range(len(self._buckets) - OFFSET_BUCKETS):
                self._buckets.popleft()


def one_way(echo: Echo, estimate: OffsetEstimate) -> tuple[int, int, int]:
    """The two ways apart, for people to look at; their sum is exact, their split is not.

    Args:
        echo: stamps of a probe, or of a frame and its result.
        estimate: of that worker's clock in the same start of it.

    Returns:
        d1 [ns] (drone to worker), d2 [ns] (back), and how far [ns] each may be off, in opposite
        directions; one that is smaller than the bound may come out negative.
    """
    d1_ns = echo.t2_ns - estimate.offset_ns - echo.t1_ns
    d2_ns = echo.t4_ns - (echo.t3_ns - estimate.offset_ns)
    away_ns = max(abs(echo.t1_ns - estimate.at_ns), abs(echo.t4_ns - estimate.at_ns))
    return d1_ns, d2_ns, estimate.bound_ns + _drift_ns(away_ns) + ROUNDING_NS


def envelope_slope(points: list[tuple[int, int]]) -> float:
    """Slope of the line below all points with the least sum of distances to them.

    That line runs along the edge of the lower convex hull above which the mean abscissa lies.

    Args:
        points: (t, value), at least two of different t.
    """
    hull = lower_hull(points)
    total, n = sum(t for t, _ in points), len(points)
    left, right = hull[0], hull[1]
    for left, right in zip(hull, hull[1:], strict=False):  # noqa: B007  # the last one is wanted
        if right[0] * n >= total:
            break
    return (right[1] - left[1]) / (right[0] - left[0])


def lower_hull(points: list[tuple[int, int]]) -> list[tuple[int, int]]:
    """Corners of the lower convex hull, by t (A. M. Andrew, 1979; exact in whole numbers)."""
    hull: list[tuple[int, int]] = []
    for t, value in sorted(points):
        if hull and hull[-1][0] == t:
            continue  # sorted: the lower one came first
        while len(hull) >= 2 and _turns_right(hull[-2], hull[-1], (t, value)):
            hull.pop()
        hull.append((t, value))
    return hull


def _turns_right(a: tuple[int, int], b: tuple[int, int], c: tuple[int, int]) -> bool:
    return (b[0] - a[0]) * (c[1] - a[1]) <= (b[1] - a[1]) * (c[0] - a[0])


def _skew_ppm(uppers: list[_Point], lowers: list[_Point]) -> tuple[float, float] | None:
    """Skew and how far it may be off [ppm]; None: no line lies between the limits."""
    above = [(p.t_ns, p.limit_ns) for p in uppers]
    below = [(p.t_ns, -p.limit_ns) for p in lowers]
    hull_above, hull_below = lower_hull(above), lower_hull(below)
    if min(len(hull_above), len(hull_below)) < 2:
        return None  # all at one time
    slowest, fastest = -float(MAX_SKEW_PPM), float(MAX_SKEW_PPM)
    # A line passes over (t_l, l) and under (t_u, u), or it does not. Corners say it for all points.
    for t_u, u in hull_above:
        for t_l, minus_l in hull_below:
            if t_u > t_l:
                fastest = min(fastest, (u + minus_l) / (t_u - t_l) * 1e6)
            elif t_u < t_l:
                slowest = max(slowest, (u + minus_l) / (t_u - t_l) * 1e6)
    if slowest > fastest:
        return None
    # The slope of either envelope is an estimate; the quieter direction counts more.
    slopes = (envelope_slope(above), -envelope_slope(below))
    weights = [1.0 / (1.0 + _mean_slack(side)) for side in (above, below)]
    skew = sum(s * w for s, w in zip(slopes, weights, strict=True)) / sum(weights) * 1e6
    skew = min(max(skew, slowest), fastest)
    return skew, max(fastest - skew, skew - slowest)


def _mean_slack(points: list[tuple[int, int]]) -> float:
    """Mean distance [ns] of points from the line below them."""
    slope = envelope_slope(points)
    t0 = points[0][0]
    residuals = [value - slope * (t - t0) for t, value in points]
    return sum(residuals) / len(residuals) - min(residuals)


def _drift_ns(span_ns: int) -> int:
    """What the clocks may part by in a span, rounded up."""
    return -(-abs(span_ns) * MAX_SKEW_PPM // 1_000_000)


def _highest(upper: _Point, at_ns: int) -> int:
    return upper.limit_ns + _drift_ns(at_ns - upper.t_ns)


def _lowest(lower: _Point, at_ns: int) -> int:
    return lower.limit_ns - _drift_ns(at_ns - lower.t_ns)
