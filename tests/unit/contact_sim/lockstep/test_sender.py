"""How frames leave in lockstep: the newest, when the link is free for it, as lean as it takes."""

from __future__ import annotations

import numpy as np

from contact_sim.lockstep.eyes import EyesSettings, Sizes
from contact_sim.lockstep.flight import LockstepSettings
from contact_sim.lockstep.sender import Exposed, Sender
from contact_sim.sensing import d455
from drone_client.flight_settings import flight_settings
from drone_client.settings import load_settings
from link_emulator.impairments import Impairments
from link_emulator.profiles import Profile
from rgbd_wire.frame import RgbdFrame
from rgbd_wire.geometry import Pose
from tests.unit.contact_sim.flights import lockstep_flight

MS = 1_000_000
RIG = d455()
BLACK = np.zeros((RIG.color.height, RIG.color.width, 3), np.uint8)
PARTS = flight_settings(load_settings())


def exposed(t_capture_ns: int) -> Exposed:
    return Exposed(RgbdFrame(BLACK, None, RIG, t_capture_ns, None), Pose.identity())


def sender() -> Sender:
    return Sender(PARTS.uplink, PARTS.rate, lambda: None, 4 * MS)


def test_the_newest_frame_waits_for_its_turn() -> None:
    """As many under way as the window has; of the others the newest; an ack lets it go."""
    s, sizes = sender(), Sizes(60_000, 40_000, 19_000)
    for sequence in range(PARTS.uplink.window):
        s.submit(exposed(0))
        leaving = s.next(0)
        assert leaving is not None
        assert leaving.t1_ns > 0
        s.sent(sequence, leaving, sizes, "w")
    for t_ms in (20, 40):
        s.submit(exposed(t_ms * MS))
        assert s.next(t_ms * MS) is None
    assert s.counts["superseded_on_board"] == 1
    s.heard(0, 50 * MS)
    s.heard(1, 60 * MS)
    leaving = s.next(60 * MS)
    assert leaving is not None
    assert leaving.exposed.frame.t_capture_ns == 40 * MS


def test_what_is_too_old_does_not_leave() -> None:
    """Its answer would be of no use; a slot that no ack frees is freed by time."""
    s = sender()
    s.submit(exposed(0))
    assert s.next(PARTS.uplink.age_max_ns) is None
    assert s.counts["too_old_on_board"] == 1
    for sequence in range(PARTS.uplink.window):
        s.submit(exposed(400 * MS))
        leaving = s.next(400 * MS)
        assert leaving is not None
        s.sent(sequence, leaving, Sizes(60_000, 40_000, 19_000), "w")
    later_ns = 401 * MS + PARTS.uplink.ack_timeout_ns
    s.submit(exposed(later_ns))
    assert s.next(later_ns + 20 * MS) is not None
    assert s.counts["ack_timeout"] == PARTS.uplink.window


def test_on_a_slow_link_a_flight_sends_lean_frames() -> None:
    """3 Mbit/s: a frame as it is takes a quarter of a second; what leaves takes a third of that."""
    slow = Impairments(rate_mbit=3.0, delay_ms=5.0)
    flight = lockstep_flight(
        0, Profile(slow, slow), LockstepSettings(longest_s=8.0), EyesSettings(found=1.0)
    )
    flown = flight.fly()
    delays = [r.judgement.network_delay_ns for r in flight.receptions]
    assert max(delays[:2]) > 150 * MS
    assert np.median(delays[10:]) < 100 * MS
    assert flown.counts["target"] > 40
