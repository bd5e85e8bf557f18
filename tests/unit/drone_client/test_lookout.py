"""Who leads, in simulated time: edge, own eyes, and the edge again; and what puts an end to it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from drone_client.lookout import MAX_OUTLIERS, Lookout, LookoutSettings
from drone_client.onboard import Look, LookVerdict, Prediction, judge
from drone_client.reception import EdgeWord
from drone_client.target import Source, TargetMeasurement
from rgbd_wire.camera import RgbdCamera
from rgbd_wire.frame import RgbdFrame
from tests.unit.drone_client import onboard_world as world
from tests.unit.drone_client.builders import MS, SECOND

FRESH_NS, ALONE_NS = 300 * MS, 5 * SECOND
PERIOD_NS = 33 * MS
LOOK_NS = 12 * MS
T0_NS = world.T0_NS


def new_lookout() -> Lookout:
    return Lookout(world.TARGET, LookoutSettings(FRESH_NS, ALONE_NS))


def blank(t_ns: int, camera: RgbdCamera = world.CAMERA) -> RgbdFrame:
    """A frame of which nobody looks at the picture."""
    size = (camera.color.height, camera.color.width, 3)
    return RgbdFrame(np.zeros(size, np.uint8), None, camera, t_ns, world.WORLD_FROM_CAMERA)


def seen(t_ns: int, word: EdgeWord, step=(0, 0, 0, 0, 0, 0)) -> Look:
    """An accepted look at the target, off by ``step``."""
    at = world.perturbed(world.WORLD_FROM_TARGET, step)
    m = TargetMeasurement(at, world.COVARIANCE, t_ns, 1.5)
    return judge(m, word.estimate, world.TARGET)


class Drone:
    """Frames every 33 ms, each of them looked at where it is due; a word of the edge at will."""

    def __init__(self) -> None:
        self.lookout = new_lookout()
        self.word = world.said()
        self.verdicts: list[LookVerdict] = []
        self.looked_at: list[int] = []

    def fly(self, from_ns: int, to_ns: int) -> list[tuple[int, Source, int]]:
        """Time, source and age at each control tick, every 20 ms; frames in between."""
        ticks = []
        next_frame_ns = from_ns
        for now_ns in range(from_ns, to_ns, 20 * MS):
            while next_frame_ns <= now_ns:
                self.frame(next_frame_ns)
                next_frame_ns += PERIOD_NS
            estimate = self.lookout.leading(now_ns, self.word)
            assert estimate is not None
            ticks.append((now_ns, estimate.source, now_ns - estimate.t_capture_ns))
        return ticks

    def frame(self, t_ns: int) -> None:
        now_ns = t_ns + 5 * MS
        if not self.lookout.is_due(t_ns, now_ns, self.word):
            return
        planned = self.lookout.plan(blank(t_ns), world.WORLD_FROM_CAMERA, now_ns, self.word)
        if isinstance(planned, Prediction):
            self.looked_at.append(t_ns)
            done = self.lookout.take(seen(t_ns, self.word), now_ns, now_ns + LOOK_NS, self.word)
            self.verdicts.append(done)
        else:
            self.verdicts.append(planned)


def test_edge_then_own_eyes_then_edge_without_a_stale_tick():
    """The link is gone for two seconds: every tick is fresh, and the lead goes there and back."""
    drone = Drone()
    ticks = drone.fly(T0_NS + 100 * MS, T0_NS + 2 * SECOND)
    assert {age <= FRESH_NS for *_, age in ticks} == {True}
    sources = [s for _, s, _ in ticks]
    first = sources.index(Source.ONBOARD)
    assert set(sources[:first]) == {Source.EDGE}
    assert set(sources[first:]) == {Source.ONBOARD}
    drone.word = world.said(T0_NS + 1950 * MS)
    after = drone.fly(T0_NS + 2 * SECOND, T0_NS + 2 * SECOND + 200 * MS)
    assert {s for _, s, _ in after} == {Source.EDGE}
    assert set(drone.verdicts) == {LookVerdict.ACCEPTED}


def test_nothing_is_looked_at_while_the_edge_speaks():
    """Results of 120 ms, at every frame: no frame is due, no work is done."""
    drone = Drone()
    for i in range(60):
        t_ns = T0_NS + i * PERIOD_NS
        drone.word = world.said(t_ns - 120 * MS)
        drone.frame(t_ns)
        assert drone.lookout.leading(t_ns, drone.word).source is Source.EDGE
    assert drone.looked_at == []
    assert drone.verdicts == []


def test_slow_looks_do_not_make_it_look_while_the_edge_answers_as_it_should():
    """A machine that takes 250 ms for a look, 12 frames a second, results of 120 ms."""
    lookout, word = new_lookout(), world.said()
    for i in range(20):
        t_ns = T0_NS + (350 + 33 * i) * MS
        lookout.take(seen(t_ns, word), t_ns, t_ns + 250 * MS, word)
    for i in range(60):
        t_ns = T0_NS + 2 * SECOND + i * 83 * MS
        word = world.said(t_ns - 166 * MS)
        assert not lookout.is_due(t_ns, t_ns + 10 * MS, word)


def test_after_its_time_alone_it_looks_no_more_and_what_is_known_grows_old():
    """Five seconds, then hold, brake and retreat come from the age, as ever."""
    drone = Drone()
    ticks = drone.fly(T0_NS + 100 * MS, T0_NS + 8 * SECOND)
    assert max(drone.looked_at) - T0_NS <= ALONE_NS
    assert max(drone.looked_at) - T0_NS > ALONE_NS - 2 * PERIOD_NS
    assert LookVerdict.EXPIRED in drone.verdicts
    last = ticks[-1]
    assert last[1] is Source.ONBOARD
    assert last[2] > 2 * SECOND
    ages = [age for now, _, age in ticks if now > T0_NS + ALONE_NS + PERIOD_NS]
    assert ages == sorted(ages)


def test_the_growing_doubt_is_told_with_the_estimate():
    """Time since the edge's word, and a covariance that grows with it."""
    drone = Drone()
    sigmas = []
    for now_ns in range(T0_NS + 300 * MS, T0_NS + 3 * SECOND, PERIOD_NS):
        drone.frame(now_ns)
        estimate = drone.lookout.leading(now_ns + 20 * MS, drone.word)
        if estimate.source is Source.ONBOARD:
            assert estimate.unconfirmed_ns(now_ns) == now_ns - T0_NS
            sigmas.append(estimate.sigma_m)
    assert len(sigmas) > 20
    assert sigmas == sorted(sigmas)
    assert sigmas[-1] > 0.02


def outage(until_ms: int = 1000) -> Drone:
    """A drone on its own for a while."""
    drone = Drone()
    drone.fly(T0_NS + 100 * MS, T0_NS + until_ms * MS)
    assert drone.lookout.leading(T0_NS + until_ms * MS, drone.word).source is Source.ONBOARD
    return drone


def test_a_late_word_of_the_edge_leads_while_it_is_fresh_and_confirms_the_look_after():
    """Captured before the newest look: fresh, it leads; stale, the look goes on from it."""
    drone = outage()
    now_ns = T0_NS + 1000 * MS
    late_ns = now_ns - 290 * MS
    drone.word = world.said(late_ns)
    assert drone.lookout.leading(now_ns, drone.word) is drone.word.estimate
    after = drone.lookout.leading(now_ns + 20 * MS, drone.word)
    assert after.source is Source.ONBOARD
    assert after.t_confirmed_ns == late_ns
    assert drone.lookout.contradicted == 0


def test_a_late_word_that_disagrees_puts_an_end_to_what_was_seen():
    """The edge saw it 30 cm beside, before the newest look: that look is gone."""
    drone = outage()
    now_ns = T0_NS + 1000 * MS
    aside = world.perturbed(world.WORLD_FROM_TARGET, [0, 0.3, 0, 0, 0, 0])
    drone.word = world.said(now_ns - 400 * MS, world_from_target=aside)
    assert drone.lookout.leading(now_ns, drone.word) is drone.word.estimate
    assert drone.lookout.contradicted == 1


def test_an_edge_that_looked_and_saw_nothing_puts_an_end_to_it():
    """The link is back, the target is not there: nobody flies to what he alone sees."""
    drone = outage()
    now_ns = T0_NS + 1000 * MS
    drone.word = replace(drone.word, t_denied_ns=T0_NS + 600 * MS)
    assert drone.lookout.leading(now_ns, drone.word) is drone.word.estimate
    drone.verdicts.clear()
    drone.frame(now_ns + PERIOD_NS)
    assert drone.verdicts == [LookVerdict.DENIED]
    assert drone.lookout.contradicted == 1


def test_an_edge_that_saw_nothing_before_it_saw_the_target_denies_nothing():
    """What counts is what it said last."""
    word = replace(world.said(), t_denied_ns=T0_NS - 1)
    assert new_lookout().objection(T0_NS + 350 * MS, T0_NS + 355 * MS, word) is None


@pytest.mark.parametrize(("outliers", "may"), [(0, True), (MAX_OUTLIERS, True), (2, False)])
def test_an_edge_that_disagrees_with_itself_is_no_anchor(outliers, may):
    """One outlier may be chance, two are a doubt."""
    word = world.said(outliers=outliers)
    got = new_lookout().objection(T0_NS + 350 * MS, T0_NS + 355 * MS, word)
    assert (got is None) is may
    assert may or got is LookVerdict.CONTESTED


def test_before_the_edge_has_ever_seen_the_target_nothing_is_due():
    """The drone's own eyes keep a target, they find none."""
    lookout, word = new_lookout(), EdgeWord(None, None)
    assert not lookout.is_due(T0_NS, T0_NS + 5 * MS, word)
    assert lookout.leading(T0_NS, word) is None
    assert lookout.plan(blank(T0_NS), None, T0_NS, word) is LookVerdict.DENIED


def test_a_drone_without_its_own_pose_does_not_look():
    """Nobody knows where the window would be."""
    lookout, t_ns = new_lookout(), T0_NS + 350 * MS
    assert lookout.plan(blank(t_ns), None, t_ns, world.said()) is LookVerdict.NO_OWN_POSE


def test_a_frame_of_another_camera_is_not_looked_at():
    """The airframe says where one camera sits; an equal one is the same."""
    lookout, t_ns, pose = new_lookout(), T0_NS + 350 * MS, world.WORLD_FROM_CAMERA
    assert isinstance(lookout.plan(blank(t_ns), pose, t_ns, world.said()), Prediction)
    again = replace(world.CAMERA)
    assert isinstance(lookout.plan(blank(t_ns, again), pose, t_ns, world.said()), Prediction)
    other = replace(world.CAMERA, color=replace(world.LENS, fx=500.0))
    got = lookout.plan(blank(t_ns, other), pose, t_ns, world.said())
    assert got is LookVerdict.OTHER_CAMERA


def test_a_frame_that_lay_too_long_is_not_looked_at():
    """What is seen in it would be stale at once."""
    lookout, t_ns = new_lookout(), T0_NS + 350 * MS
    got = lookout.plan(blank(t_ns), world.WORLD_FROM_CAMERA, t_ns + FRESH_NS + 1, world.said())
    assert got is LookVerdict.TOO_OLD


def test_a_look_that_took_too_long_is_not_taken():
    """A pose has to be fresh when it comes, whoever made it."""
    lookout, t_ns, word = new_lookout(), T0_NS + 350 * MS, world.said()
    got = lookout.take(seen(t_ns, word), t_ns, t_ns + FRESH_NS + 1, word)
    assert got is LookVerdict.TOO_OLD
    assert lookout.leading(t_ns, word).source is Source.EDGE


def test_looks_are_taken_in_the_order_of_their_exposures():
    """An older one never replaces a newer one."""
    lookout, word = new_lookout(), world.said()
    newer, older = T0_NS + 400 * MS, T0_NS + 380 * MS
    assert lookout.take(seen(newer, word), newer, newer + MS, word) is LookVerdict.ACCEPTED
    assert lookout.take(seen(older, word), newer, newer + MS, word) is LookVerdict.DISPLACED
    assert lookout.leading(newer, word).t_capture_ns == newer


def test_a_word_that_came_while_it_looked_judges_the_look():
    """The edge, late, says 30 cm aside; or agrees, and the look rests on it."""
    t_ns, before = T0_NS + 450 * MS, world.said()
    aside = world.perturbed(world.WORLD_FROM_TARGET, [0, 0.3, 0, 0, 0, 0])
    disagrees = world.said(T0_NS + 200 * MS, world_from_target=aside)
    got = new_lookout().take(seen(t_ns, before), t_ns, t_ns + LOOK_NS, disagrees)
    assert got is LookVerdict.CONTRADICTED
    lookout, agrees = new_lookout(), world.said(T0_NS + 100 * MS)
    assert lookout.take(seen(t_ns, before), t_ns, t_ns + LOOK_NS, agrees) is LookVerdict.ACCEPTED
    now_ns = T0_NS + 460 * MS
    assert lookout.leading(now_ns, agrees).t_confirmed_ns == T0_NS + 100 * MS


def test_a_rejected_look_changes_nothing():
    """Whatever the reason."""
    lookout, t_ns, word = new_lookout(), T0_NS + 400 * MS, world.said()
    for verdict in (LookVerdict.REFUSED, LookVerdict.WRONG_RINGS, LookVerdict.OFF_PREDICTION):
        assert lookout.take(Look(verdict), t_ns, t_ns, word) is verdict
    assert lookout.leading(t_ns, word) is word.estimate


@given(
    st.lists(
        st.tuples(st.integers(0, 400), st.sampled_from(["frame", "word", "deny", "aside", "tick"])),
        min_size=1,
        max_size=60,
    )
)
def test_whatever_comes_in_whatever_order_the_lead_is_one_of_two_and_never_lies(happenings):
    """The lead is the edge's own estimate, or a younger look that the newest word agrees with."""
    drone, now_ns = Drone(), T0_NS
    for step_ms, what in happenings:
        now_ns += step_ms * MS
        newer = max(drone.word.estimate.t_capture_ns + 1, now_ns - 200 * MS)
        if what == "frame":
            drone.frame(now_ns)
        elif what == "word":
            drone.word = world.said(newer)
        elif what == "deny":
            drone.word = replace(drone.word, t_denied_ns=newer)
        elif what == "aside":
            aside = world.perturbed(world.WORLD_FROM_TARGET, [0, 0.5, 0, 0, 0, 0])
            drone.word = world.said(newer, world_from_target=aside)
        lead = drone.lookout.leading(now_ns, drone.word)
        edge = drone.word.estimate
        if lead.source is Source.EDGE:
            assert lead is edge
            continue
        assert not drone.word.denies
        assert now_ns - edge.t_capture_ns > FRESH_NS
        assert lead.t_capture_ns > edge.t_capture_ns
        assert lead.t_confirmed_ns == edge.t_capture_ns
        assert lead.t_capture_ns - edge.t_capture_ns <= ALONE_NS
        off = lead.world_from_target.translation - edge.world_from_target.translation
        assert np.linalg.norm(off) < world.TARGET.discs[0].diameter_m


@pytest.mark.parametrize(("fresh_ns", "alone_ns"), [(0, 1), (-1, 5), (10, 9)])
def test_bounds_that_cannot_be_are_refused(fresh_ns, alone_ns):
    """Said where they are made."""
    with pytest.raises(ValueError, match="must hold"):
        LookoutSettings(fresh_ns, alone_ns)
