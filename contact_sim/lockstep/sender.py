"""How frames leave in lockstep: the client's departure clock and its choice of encoding.

``drone_client/uplink.py`` runs the same parts in a thread; here simulated time is handed to them,
and there is one worker, so nothing is handed over and nothing is sent twice.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

from contact_sim.lockstep.eyes import Sizes
from drone_client.departures import Departures
from drone_client.encoding_choice import ChosenEncoding, EncodingChoice
from drone_client.goodput import Goodput
from drone_client.newest import Newest
from drone_client.rate_control import RateSettings
from drone_client.target import TargetEstimate
from drone_client.uplink import REMEMBERED_FRAMES, UplinkSettings
from rgbd_wire.frame import RgbdFrame
from rgbd_wire.geometry import Pose

ENCODE_NS: Final = 15_000_000
"""From the decision to send a frame to its first byte on the link."""


@dataclass(frozen=True, slots=True, eq=False)
class Exposed:
    """A frame, and the truth of it."""

    frame: RgbdFrame
    """Of black pictures, where nobody looks at them."""
    camera_from_target: Pose


@dataclass(frozen=True, slots=True)
class Leaving:
    """A frame that leaves now."""

    exposed: Exposed
    chosen: ChosenEncoding
    t1_ns: int


class Sender:
    """The newest frame waits; it leaves when the link will be free for it."""

    def __init__(
        self,
        uplink: UplinkSettings,
        rate: RateSettings,
        estimate: Callable[[], TargetEstimate | None],
        round_trip_ns: int,
    ) -> None:
        """Nothing waits yet.

        Args:
            uplink: window, time-out and the age past which a frame is of no use.
            rate: what the ladder of encodings is held to.
            estimate: where the target is believed to be.
            round_trip_ns: of a small message on the empty link; a flight knows it by its probes.
        """
        self.counts: Counter[str] = Counter()
        """What became of frames that did not leave, by the ledger's names."""
        self._settings = uplink
        self._round_trip_ns = round_trip_ns
        self._choice = EncodingChoice(rate, estimate)
        self._departures = Departures(uplink.window, uplink.ack_timeout_ns)
        self._goodput = Goodput()
        self._sent: dict[int, tuple[int, int]] = {}
        """Bytes and t1 of the frames that were not acknowledged, the oldest first."""
        self._slot: Newest[Exposed] = Newest()

    def submit(self, exposed: Exposed) -> None:
        """Offer a frame; one that still waits is displaced."""
        if self._slot.put(exposed) is not None:
            self.counts["superseded_on_board"] += 1

    def next(self, now_ns: int) -> Leaving | None:
        """The frame that waits, if it may leave."""
        for sequence in self._departures.expire(now_ns):
            self.counts["ack_timeout"] += 1
            if (sent := self._sent.get(sequence)) is not None:
                self._goodput.timed_out(*sent, now_ns)
        if self._departures.wait_ns(now_ns, ENCODE_NS) != 0:
            return None
        exposed = self._slot.take(0)
        if exposed is None:
            return None
        t1_ns = now_ns + ENCODE_NS
        age_ns = t1_ns - exposed.frame.t_capture_ns
        if self._settings.age_max_ns - age_ns - self._round_trip_ns <= 0:
            self.counts["too_old_on_board"] += 1
            return None
        chosen = self._choice.choose(exposed.frame, now_ns, self._goodput.bytes_per_s)
        return Leaving(exposed, chosen, t1_ns)

    def sent(self, sequence: int, leaving: Leaving, sizes: Sizes, worker: str) -> None:
        """It left.

        Args:
            sequence: its number.
            leaving: what left.
            sizes: of it.
            worker: whom it goes to.
        """
        self._choice.weighed(leaving.chosen, sizes.color, sizes.depth)
        goodput = self._goodput.bytes_per_s
        serialisation_ns = 0 if goodput is None else round(1e9 * sizes.message / goodput)
        self._departures.send(sequence, worker, leaving.t1_ns, serialisation_ns)
        self._sent[sequence] = sizes.message, leaving.t1_ns
        while len(self._sent) > REMEMBERED_FRAMES:
            del self._sent[next(iter(self._sent))]

    def heard(self, sequence: int, t_ns: int) -> None:
        """An ack or a result of a frame is here."""
        self._departures.release(sequence, t_ns, self._round_trip_ns)
        sent = self._sent.pop(sequence, None)
        if sent is not None:
            self._goodput.acked(*sent, t_ns, self._round_trip_ns)
