"""The thread that looks for the target on board while the edge is silent.

It gets frames through a one-slot mailbox, and only while the edge is not fresh; it looks at one at
a time, and nobody ever waits for it. Nothing that goes wrong in here reaches who flies.
"""

from __future__ import annotations

import logging
import threading
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from drone_client.lookout import Lookout
from drone_client.newest import Newest
from drone_client.onboard import Look, LookVerdict, Prediction, look
from drone_client.reception import EdgeWord
from drone_client.records import look_record
from drone_client.target import TargetEstimate
from rgbd_wire.clock import Clock
from rgbd_wire.frame import RgbdFrame
from rgbd_wire.geometry import Pose
from target_pose.target import Target

logger = logging.getLogger(__name__)

POLL_S = 0.5
"""How often the thread looks whether it is to end, with nothing else to do."""


@dataclass(frozen=True, slots=True, eq=False)
class _Offered:
    sequence: int
    frame: RgbdFrame


class OwnEyes:
    """Owns the looking thread, its mailbox, and who leads."""

    def __init__(
        self,
        target: Target,
        lookout: Lookout,
        word: Callable[[], EdgeWord],
        world_from_camera: Callable[[int], Pose | None],
        clock: Clock,
        write: Callable[[dict[str, Any]], None],
    ) -> None:
        """Take over the callbacks, which must be quick and may come from any thread.

        Args:
            target: what was printed.
            lookout: decides.
            word: the last that the edge has said.
            world_from_camera: where the colour camera was at a time [ns, drone's clock].
            clock: the drone's.
            write: takes a line for the ledger.
        """
        self.verdicts: Counter[LookVerdict] = Counter()
        """What became of the frames of the moments without a fresh word of the edge."""
        self._target = target
        self._lookout = lookout
        self._word = word
        self._world_from_camera = world_from_camera
        self._clock = clock
        self._write = write
        self._lock = threading.Lock()
        """Guards the lookout and the counts; never held while a picture is looked at."""
        self._slot: Newest[_Offered] = Newest()
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=self._run, name="own eyes", daemon=True)

    def start(self) -> None:
        """Begin to look."""
        self._thread.start()

    def stop(self) -> None:
        """End the thread; what waits is not looked at."""
        self._stopping.set()
        self._slot.close()
        if self._thread.is_alive():
            self._thread.join(timeout=5.0)

    def offer(self, sequence: int, frame: RgbdFrame) -> None:
        """A frame was captured; it is taken if the edge leaves the drone alone."""
        try:
            now_ns, word = self._clock.now_ns(), self._word()
            with self._lock:
                if not self._lookout.is_due(frame.t_capture_ns, now_ns, word):
                    return
                objection = self._lookout.objection(frame.t_capture_ns, now_ns, word)
            offered = _Offered(sequence, frame)
            if objection is not None:
                self._tell(offered, objection)
            elif (displaced := self._slot.put(offered)) is not None:
                self._tell(displaced, LookVerdict.DISPLACED)
        except Exception:
            self._failed(None)

    def leading(self, now_ns: int) -> TargetEstimate | None:
        """The estimate to fly on at a control tick: the edge's, or one seen on board."""
        word = self._word()
        try:
            with self._lock:
                return self._lookout.leading(now_ns, word)
        except Exception:
            self._failed(None)
            return word.estimate

    @property
    def contradicted(self) -> int:
        """Accepted looks that a later word of the edge put an end to."""
        with self._lock:
            return self._lookout.contradicted

    def _run(self) -> None:
        while not self._stopping.is_set():
            offered = self._slot.take(POLL_S)
            if offered is None or self._stopping.is_set():
                continue
            try:
                self._look(offered)
            except Exception:
                self._failed(offered)

    def _look(self, offered: _Offered) -> None:
        started_ns, word, frame = self._clock.now_ns(), self._word(), offered.frame
        world_from_camera = self._world_from_camera(frame.t_capture_ns)
        with self._lock:
            planned = self._lookout.plan(frame, world_from_camera, started_ns, word)
        if not isinstance(planned, Prediction):
            self._tell(offered, planned)
            return
        seen = look(frame, planned, self._target)
        now_ns, word = self._clock.now_ns(), self._word()
        with self._lock:
            verdict = self._lookout.take(seen, started_ns, now_ns, word)
        self._tell(offered, verdict, seen, now_ns - started_ns)

    def _tell(
        self,
        offered: _Offered,
        verdict: LookVerdict,
        seen: Look | None = None,
        look_ns: int | None = None,
    ) -> None:
        with self._lock:
            self.verdicts[verdict] += 1
        line = {
            "t_ns": self._clock.now_ns(),
            "sequence": offered.sequence,
            "t_capture_ns": offered.frame.t_capture_ns,
            "look_ms": None if look_ns is None else look_ns / 1e6,
        }
        self._write(line | look_record(verdict, seen))

    def _failed(self, offered: _Offered | None) -> None:
        """Count an error; a frame's own is told in its line, too."""
        with self._lock:
            first = not self.verdicts[LookVerdict.FAILED]
        if first:
            logger.exception("the drone's own eyes failed")
        if offered is not None:
            self._tell(offered, LookVerdict.FAILED)
        else:
            with self._lock:
                self.verdicts[LookVerdict.FAILED] += 1
