"""The bench of the safety filter: its drone is the real control tick, its page is whole."""

from __future__ import annotations

import dataclasses
import json
import math
import random
import sys

import numpy as np
import pytest

from drone_client.cbf import FilterSettings, Funnel, Status
from drone_client.control import ControlSettings, decide
from drone_client.guidance import GuidanceSettings
from drone_client.target import TargetEstimate
from rgbd_wire.geometry import Pose, rotation_from_vector
from tests.perf import bench_control, bench_control_trials
from tests.perf.bench_control_flight import AIRFRAME, Eyes, QuickEyes, Start, World, fly, seen, tick
from tests.perf.bench_control_states import KINDS, ask
from tests.perf.bench_control_trials import Chunk, Trial, fly_chunk, inside, outside, run


def test_the_tick_of_the_bench_is_the_real_one() -> None:
    """In plain numbers it commands what the control tick commands, to rounding."""
    rng = np.random.default_rng(4)
    for _ in range(200):
        turned = rotation_from_vector(rng.normal(size=3) * 0.1)
        estimate = TargetEstimate(
            Pose.from_rotation(turned, rng.normal(size=3) * 0.02),
            np.diag([1e-6] * 6),
            1_000_000_000,
            0.6,
        )
        yaw = math.pi + rng.uniform(-0.4, 0.4)
        body = rng.uniform((0.6, -0.2, -0.2), (2.0, 0.2, 0.2))
        now_ns = 1_000_000_000 + int(rng.integers(0, 700_000_000))
        level = Pose(body, np.array([math.cos(yaw / 2), 0.0, 0.0, math.sin(yaw / 2)]))
        theirs = decide(now_ns, estimate, level, AIRFRAME, ControlSettings())
        safe, velocity_world, _ = tick(
            seen(estimate),
            tuple(body.tolist()),
            yaw,
            now_ns,
            GuidanceSettings(),
            FilterSettings(),
        )
        assert safe.status is theirs.safe.status
        np.testing.assert_allclose(velocity_world, theirs.command.velocity_world, atol=1e-9)
        assert safe.yaw_rate_radps == pytest.approx(theirs.command.yaw_rate_radps, abs=1e-9)


@pytest.mark.parametrize("world", [World(), World(noise_m=0.0005, noise_per_m=0.001)])
def test_the_quick_target_filter_is_as_sure_as_the_whole_one(world) -> None:
    """It says at least the same doubt, at most a fifth more, and errs as much to 0.2 mm."""
    body, off = (1.0, 0.1, 0.0), (0.0, 0.0, 0.0)
    said, erred = {}, {}
    for eyes_type in (Eyes, QuickEyes):
        rng = random.Random(3)
        eyes, known, errors = eyes_type(world, rng), None, []
        for n in range(2_000):
            eyes.look(n * 20_000_000, body, math.pi, off)
            known = eyes.newest(n * 20_000_000, known)
            if n > 500:
                errors.append(known.origin)
        said[eyes_type] = known.sigma_m
        erred[eyes_type] = float(np.std(errors))
    assert 0.99 * said[Eyes] <= said[QuickEyes] <= 1.2 * said[Eyes]
    assert erred[QuickEyes] == pytest.approx(erred[Eyes], rel=0.2, abs=2e-4)


def test_starts_are_where_they_are_said_to_be() -> None:
    """Inside the funnel or outside it, in front of the board."""
    rng, funnel = random.Random(1), Funnel()
    for _ in range(200):
        assert funnel.h(inside(rng)) >= 0.0
        tip = outside(rng)
        assert funnel.h(tip) < 0.0 < tip[0]


def test_an_approach_ends_in_the_mouth() -> None:
    """With the localiser's noise the tip touches near the centre, gently, and the flight ends."""
    world = World(noise_m=0.0005, noise_per_m=0.001, noise_rad=0.004)
    flight = fly(Start((0.4, 0.02, 0.0), 0.1, 5), world, FilterSettings(), GuidanceSettings())
    assert flight.touch is not None
    assert math.hypot(*flight.touch.tip[1:]) < 0.01
    assert 0.0 < -flight.touch.velocity[0] < 0.05
    assert flight.outside_m < 0.0
    assert flight.last.tip[0] <= -0.015 or flight.last.t_s >= flight.touch.t_s + 0.99


def test_a_lost_link_brakes_and_retreats() -> None:
    """The row of such a flight says when it braked, and that it never came nearer again."""
    (row,) = fly_chunk(Chunk("link lost", 3, 1))
    assert row["approach_mps"] <= 1e-9
    assert row["brake_late_ms"] <= 100
    assert row["lost_m"] <= 0.005
    assert row["out_m"] > 0.9


def test_a_run_goes_on_where_it_was_broken_off(tmp_path, monkeypatch) -> None:
    """Kept flights are not flown again, half a line is, and other sources are refused."""
    short = Trial(World(quick_eyes=True, seconds=1.0), 6)
    monkeypatch.setattr(bench_control_trials, "TRIALS", {"invariance": short})
    kept, steps = tmp_path / "run.jsonl", []
    wanted = [Chunk("invariance", 0, 2), Chunk("invariance", 1, 2)]
    first = run(wanted[:1], 1, kept, steps.append)
    with kept.open("a") as file:
        file.write('["invariance/1/2", [{"se')
    kept.write_text(kept.read_text() + "\n")
    flown = []
    real = bench_control_trials.fly_chunk
    monkeypatch.setattr(
        bench_control_trials, "fly_chunk", lambda chunk: flown.append(chunk) or real(chunk)
    )
    both = run(wanted, 1, kept, steps.append)
    assert flown == wanted[1:]
    assert both["invariance"][:2] == first["invariance"]
    assert len(both["invariance"]) == 4

    monkeypatch.setattr(bench_control_trials, "fingerprint", lambda: "another")
    with pytest.raises(ValueError, match="other sources"):
        run(wanted, 1, kept, steps.append)


def test_every_kind_of_state_gets_its_answer() -> None:
    """A few thousand of them: nothing is wrong, and every status is met."""
    answers = ask(4_000, 3, lambda done: None)
    assert not answers.wrong
    assert set(answers.states) == set(KINDS)
    assert set(answers.statuses) == set(Status)


def test_a_wrong_answer_is_counted(monkeypatch) -> None:
    """A filter that is too fast, not finite or silent would not pass."""
    from tests.perf import bench_control_states as states

    real = states.filter_command
    for change, expected in (
        (lambda c: dataclasses.replace(c, velocity_body_target=(0.5, 0.0, 0.0)), "too fast"),
        (lambda c: dataclasses.replace(c, yaw_rate_radps=math.nan), "not finite"),
        (lambda c: dataclasses.replace(c, status=Status.MAX_HDOT), "status max_hdot"),
        (lambda c: None, "no command"),
        (lambda c: 1 / 0, "ZeroDivisionError"),
    ):
        monkeypatch.setattr(
            states, "filter_command", lambda inp, limits, change=change: change(real(inp, limits))
        )
        wrong = ask(800, 3, lambda done: None).wrong
        assert any(what.endswith(expected) for what in wrong)


def test_a_quick_run_writes_its_page(tmp_path, monkeypatch, capsys) -> None:
    """Page and picture are there, with all goals, and the safety figures are met."""
    written = tmp_path / "results" / "control.md"
    options = ["--quick", "--jobs", "1", "--json", "--write", str(written)]
    monkeypatch.setattr(sys, "argv", ["bench", *options])
    assert bench_control.main() == 0
    result = json.loads(capsys.readouterr().out)
    assert result["trials"]["invariance"]["outside"] == []
    assert result["agreement"]["CVXPY, polished"]["max"] < 1e-8
    assert result["variants"][0]["touched"] == 0
    text = written.read_text()
    assert text.count("| met |") + text.count("| missed |") == 11
    assert (written.parent / "figures" / "control-stall.png").read_bytes()[1:4] == b"PNG"
    assert not list(written.parent.rglob("*.part"))


@pytest.mark.parametrize("options", [["--share", "2"], ["--jobs", "0"], ["--share", "much"]])
def test_bad_options_are_refused(monkeypatch, capsys, options) -> None:
    """With one line and exit status 2."""
    monkeypatch.setattr(sys, "argv", ["bench", *options])
    with pytest.raises(SystemExit) as refused:
        bench_control.main()
    assert refused.value.code == 2
    assert options[0] in capsys.readouterr().err
