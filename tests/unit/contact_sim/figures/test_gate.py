"""The figure of the gate: a slow link, and verdicts that keep the two bounds."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from contact_sim.figures import gate
from contact_sim.figures.bench import FigureBench
from contact_sim.figures.run import Run, fly
from contact_sim.scene import build_scene
from drone_client.gate import Verdict
from drone_client.mission import Phase

TAU_MAX_NS, AGE_MAX_NS = 250_000_000, 300_000_000


def slow_run() -> Run:
    return fly("slow", build_scene(gate.WORLD, gate.SEED), gate.SEED, before_tick=gate.SlowLink())


def test_the_slow_link_is_refused_by_both_bounds_and_the_drone_backs_off_and_comes_again():
    """Every verdict is what the two numbers ask for; the slow time is one stretch."""
    run = slow_run()
    found = gate.by_verdict(run.receptions)
    assert {Verdict.ACCEPTED, Verdict.NETWORK_DELAY, Verdict.TOO_OLD} <= set(found)
    for verdict, receptions in found.items():
        for reception in receptions:
            delay, age = reception.judgement.network_delay_ns, reception.judgement.age_ns
            if verdict is Verdict.ACCEPTED:
                assert delay <= TAU_MAX_NS
                assert age <= AGE_MAX_NS
            elif verdict is Verdict.NETWORK_DELAY:
                assert delay > TAU_MAX_NS
            elif verdict is Verdict.TOO_OLD:
                assert delay <= TAU_MAX_NS
                assert age > AGE_MAX_NS
    refused = [r.t4_ns for r in found[Verdict.NETWORK_DELAY]]
    assert np.ptp(refused) < gate.SLOW_S * 1e9
    phases = [phase for _, phase in run.phases]
    assert phases.count(Phase.APPROACH) == 2
    assert phases[-1] is Phase.DONE


def test_it_is_drawn(bench: FigureBench):
    """With the counts of its verdicts."""
    figure, caption = gate.draw(bench)
    assert len(figure.axes) == 3
    assert "were refused" in caption
    assert "300 ms slower for 6 s" in caption
    assert "it holds, brakes or backs off" in caption
    assert "measured errors instead of pictures" in caption
    plane, times, tip = figure.axes
    assert not plane.texts
    # what is shaded and what is dotted have names of their own
    names = {text.get_text() for text in tip.texts}
    assert {text.get_text() for text in times.texts} == names
    assert {"hold", "brake", "retreat"} <= names
    shaded = {text.get_text() for text in tip.get_legend().get_texts()}
    assert len(shaded) == 3
    assert not shaded & names


def test_a_link_that_never_got_slow_is_not_said_to_have_been(run):
    """It waits for a tip that is near; and what is not judged by times is counted."""
    caption = gate._caption(run, 250.0, 300.0, slowed=False)
    assert "never gets slow, for no approach comes as near as 45 cm" in caption
    assert "slower for" not in caption
    assert "Nothing is shaded" in caption
    assert "not known" not in caption
    judgement = replace(run.receptions[0].judgement, network_delay_ns=None)
    first = replace(run.receptions[0], judgement=judgement)
    unknown = replace(run, receptions=(first, *run.receptions[1:]))
    assert "of 1 more the times are not known" in gate._caption(unknown, 250.0, 300.0, slowed=True)
