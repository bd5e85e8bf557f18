"""Who leads, the edge or the drone's own eyes: what is known, and when a frame is worth a look.

The edge leads whenever its word is fresh. What was seen on board leads only in between, for a
bounded time after that word, and falls as soon as the edge says otherwise.

Pure: time is an argument. Not thread-safe.
"""

from __future__ import annotations

from dataclasses import dataclass

from drone_client.onboard import Look, LookVerdict, Prediction, judge, predict
from drone_client.reception import EdgeWord
from drone_client.target import TargetEstimate, TargetMeasurement
from rgbd_wire.camera import RgbdCamera
from rgbd_wire.frame import RgbdFrame
from rgbd_wire.geometry import Pose
from target_pose.target import Target

EARLIEST_SHARE = 3
"""At most this part of the time for which a pose is fresh, a look begins before its end: a slow
machine or camera shall not make the drone look while the edge answers as it should."""
MAX_OUTLIERS = 1
"""Measurements of the edge in a row that its own estimate did not fit; with more, the drone does
not look for what that estimate says."""


@dataclass(frozen=True, slots=True)
class LookoutSettings:
    """Bounds of flying on one's own eyes.

    Raises:
        ValueError: a bound is not positive, or the second is below the first.
    """

    fresh_ns: int
    """Up to this age a pose counts as fresh: the safety filter's ``age_max_ns``."""
    alone_max_ns: int
    """So long after the edge's last word no further look is taken."""

    def __post_init__(self) -> None:
        if not 0 < self.fresh_ns <= self.alone_max_ns:
            raise ValueError(
                f"0 < fresh ({self.fresh_ns} ns) <= alone_max ({self.alone_max_ns} ns) must hold"
            )


@dataclass(frozen=True, slots=True, eq=False)
class _Seen:
    """The newest look that was accepted, and the word that it was held against."""

    measurement: TargetMeasurement
    anchor: TargetEstimate
    estimate: TargetEstimate


class Lookout:
    """Decides when to look, remembers the newest accepted look, and says who leads."""

    def __init__(self, target: Target, settings: LookoutSettings) -> None:
        self.contradicted = 0
        """Accepted looks that a later word of the edge put an end to."""
        self._target = target
        self._settings = settings
        self._camera: RgbdCamera | None = None
        self._t_last_ns: int | None = None
        self._interval_ns = 0
        self._work_ns = 0
        self._seen: _Seen | None = None

    def is_due(self, t_capture_ns: int, now_ns: int, word: EdgeWord) -> bool:
        """Whether a frame is of interest: the edge will not be fresh when the next one is done.

        One frame early, so that there is no gap; without an outage nothing is ever due.
        """
        if self._t_last_ns is not None:
            self._interval_ns = max(0, t_capture_ns - self._t_last_ns)
        self._t_last_ns = t_capture_ns
        if word.estimate is None or t_capture_ns <= word.estimate.t_capture_ns:
            return False
        fresh_ns = self._settings.fresh_ns
        early_ns = min(self._interval_ns + self._work_ns, fresh_ns // EARLIEST_SHARE)
        return now_ns + early_ns - word.estimate.t_capture_ns > fresh_ns

    def plan(
        self, frame: RgbdFrame, world_from_camera: Pose | None, now_ns: int, word: EdgeWord
    ) -> Prediction | LookVerdict:
        """The window in a frame that is due, or why none may be looked at."""
        if (reason := self.objection(frame.t_capture_ns, now_ns, word)) is not None:
            return reason
        assert word.estimate is not None
        if self._camera is None:
            self._camera = frame.camera
        if not _same_camera(frame.camera, self._camera):
            return LookVerdict.OTHER_CAMERA
        if world_from_camera is None:
            return LookVerdict.NO_OWN_POSE
        self._review(word)
        newest = word.estimate if self._seen is None else self._seen.estimate
        return predict(
            word.estimate, newest, world_from_camera, frame.t_capture_ns, frame.camera, self._target
        )

    def objection(self, t_capture_ns: int, now_ns: int, word: EdgeWord) -> LookVerdict | None:
        """Why the drone may not look for itself now; None: it may."""
        edge = word.estimate
        if word.denies or edge is None:
            return LookVerdict.DENIED
        if edge.outliers > MAX_OUTLIERS:
            return LookVerdict.CONTESTED
        if t_capture_ns - edge.t_capture_ns > self._settings.alone_max_ns:
            return LookVerdict.EXPIRED
        if now_ns - t_capture_ns > self._settings.fresh_ns:
            return LookVerdict.TOO_OLD
        return None

    def take(self, look: Look, started_ns: int, now_ns: int, word: EdgeWord) -> LookVerdict:
        """Take an accepted look over, if it still holds now; returns what became of it."""
        self._work_ns += (max(0, now_ns - started_ns) - self._work_ns) // 4
        measured, estimate = look.measurement, look.estimate
        if look.verdict is not LookVerdict.ACCEPTED or measured is None or estimate is None:
            return look.verdict
        if (reason := self.objection(measured.t_capture_ns, now_ns, word)) is not None:
            return reason
        if self._seen is not None and measured.t_capture_ns <= self._seen.estimate.t_capture_ns:
            return LookVerdict.DISPLACED
        edge = word.estimate
        assert edge is not None
        if edge.t_capture_ns != estimate.t_confirmed_ns:
            # The edge spoke while we looked
            again = judge(measured, edge, self._target)
            if again.estimate is None:
                return LookVerdict.CONTRADICTED
            estimate = again.estimate
        self._seen = _Seen(measured, edge, estimate)
        return LookVerdict.ACCEPTED

    def leading(self, now_ns: int, word: EdgeWord) -> TargetEstimate | None:
        """The estimate to fly on: the edge's while it is fresh, else the newer of the two.

        A word of the edge that comes late, captured before the newest look, leads if it is fresh;
        either way that look is held against it, and falls or goes on from there.
        """
        edge = word.estimate
        self._review(word)
        if edge is None or self._seen is None:
            return edge
        is_fresh = 0 <= now_ns - edge.t_capture_ns <= self._settings.fresh_ns
        return edge if is_fresh else self._seen.estimate

    def _review(self, word: EdgeWord) -> None:
        """Hold the newest look against the edge's newest word."""
        seen, edge = self._seen, word.estimate
        if seen is None:
            return
        if edge is None or word.denies or edge.outliers > MAX_OUTLIERS:
            self._fall()
        elif edge.t_capture_ns >= seen.estimate.t_capture_ns:
            self._seen = None  # the edge has seen more since: nothing was wrong with the look
        elif edge is not seen.anchor:
            again = judge(seen.measurement, edge, self._target)
            if again.estimate is None:
                self._fall()
            else:
                self._seen = _Seen(seen.measurement, edge, again.estimate)

    def _fall(self) -> None:
        self._seen = None
        self.contradicted += 1


def _same_camera(a: RgbdCamera, b: RgbdCamera) -> bool:
    return a is b or a.to_json() == b.to_json()
