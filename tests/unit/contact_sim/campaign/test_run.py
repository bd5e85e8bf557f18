"""Campaigns: what is planned, kept, resumed, and told."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import pytest
from scipy.stats import binomtest
from typer.testing import CliRunner

from contact_sim.campaign.faults import Fault, Kind
from contact_sim.campaign.report import page, summary, wilson
from contact_sim.campaign.row import (
    NAMES,
    UNFINISHED,
    FlightRow,
    as_cells,
    failed_row,
    flight_row,
    from_cells,
)
from contact_sim.campaign.run import Job, Table, ablated, fly_campaign, fly_job, plan, read_table
from contact_sim.chance import stream
from contact_sim.commands import app
from contact_sim.errors import CampaignError, ServiceError, SimulatorError
from contact_sim.lockstep.eyes import ModelEyes
from contact_sim.lockstep.flight import LockstepFlight, LockstepSettings
from contact_sim.scene import build_scene
from contact_sim.sensing import d455
from drone_client.mission import Phase
from link_emulator.profiles import PROFILES
from tests.unit.contact_sim.flights import lockstep_flight

ROW = FlightRow(
    world="tunnel",
    seed=3,
    board="clean",
    link="wifi",
    eyes="model",
    fault="none",
    ablation="none",
    phase="done",
    reason="back",
    ends="contact",
    attempts=1,
    struck_m=None,
    touched=True,
    offset_m=0.004,
    touch_left_m=0.001,
    touch_up_m=-0.0039,
    touch_age_s=0.12,
    closing_mps=0.03,
    peak_force_n=1.2,
    press_force_n=1.0,
    pressed_s=2.0,
    outside_m=0.0,
    collisions="",
    nearest_m=-0.01,
    end_m=0.95,
    flown_s=27.0,
    drift_m=0.02,
    found=380,
    frames=400,
    accepted=395,
    gated=2,
    wall_s=3.0,
)


def test_a_row_comes_back_from_its_cells() -> None:
    """None, text, numbers and yes or no."""
    for row in (ROW, replace(ROW, touched=False, offset_m=None, collisions="a on b; c on d")):
        cells = {k: str(v) for k, v in as_cells(row).items()}
        assert from_cells(cells) == row
    with pytest.raises(ValueError, match="column seed is missing"):
        from_cells({"world": "tunnel"})


def test_a_table_goes_on_where_it_was(tmp_path: Path) -> None:
    """What was flown is not flown again; a line that was cut off is."""
    path = tmp_path / "flights.csv"
    table = Table(path, goes_on=False)
    table.add(ROW)
    table.add(replace(ROW, seed=4))
    table.close()
    path.write_text(path.read_text()[:-40])
    assert read_table(path) == [ROW]
    again = Table(path, goes_on=True)
    assert again.rows == [ROW]
    again.add(replace(ROW, seed=4))
    again.close()
    assert [row.seed for row in read_table(path)] == [3, 4]
    with pytest.raises(CampaignError, match="there already: --resume goes on"):
        Table(path, goes_on=False)
    assert [row.seed for row in read_table(path)] == [3, 4]
    anew = Table(path, goes_on=False, overwrites=True)
    anew.close()
    assert read_table(path) == []


def test_a_table_that_is_none_or_cannot_be_written_is_named(tmp_path: Path) -> None:
    """A folder in its place, a file of something else."""
    (tmp_path / "taken").mkdir()
    with pytest.raises(CampaignError, match="taken"):
        Table(tmp_path / "taken", goes_on=False)
    other = tmp_path / "other.csv"
    other.write_text("a,b\n1,2\n3,4\n")
    with pytest.raises(CampaignError, match=r"other.csv is no table of flights: column world is"):
        Table(other, goes_on=True)
    assert other.read_text().startswith("a,b")
    cells = {k: str(v) for k, v in as_cells(ROW).items()}
    with pytest.raises(ValueError, match="touched = 'maybe' is neither"):
        from_cells(cells | {"touched": "maybe"})
    for name, text in (("peak_force_n", ""), ("seed", ""), ("seed", "1.5"), ("end_m", "x")):
        with pytest.raises(ValueError, match="could not convert|invalid literal"):
            from_cells(cells | {name: text})
    with pytest.raises(ValueError, match="not finite"):
        from_cells(cells | {"outside_m": "nan"})
    failed = failed_row(ROW.flight, "no reason", 1.0)
    assert from_cells({k: str(v) for k, v in as_cells(failed).items()}).error == "no reason"


def test_a_disk_that_is_full_is_told(tmp_path: Path) -> None:
    """Before anything is flown."""
    (tmp_path / "flights.csv.part").symlink_to("/dev/full")
    with pytest.raises(CampaignError, match="No space left"):
        Table(tmp_path / "flights.csv", goes_on=False)


def test_the_plan_has_every_flight_once() -> None:
    """Each ablation with every fault, too."""
    faults = (None, Fault(Kind.GUST), Fault(Kind.VIO_OUT))
    jobs = plan(["tunnel", "refinery"], range(5), faults, ["no_gate"], "clean", "wifi")
    assert len(jobs) == len({job.flight for job in jobs}) == 2 * 5 * 3 * 2
    with pytest.raises(CampaignError, match="no ablation 'magic'"):
        plan(["tunnel"], range(1), (), ["magic"], "clean", "wifi")
    with pytest.raises(CampaignError, match="nothing to fly"):
        plan(["tunnel"], range(1), (), [], "clean", "wifi")
    assert len(plan(["tunnel", "tunnel"], range(2), (None,), [], "clean", "wifi")) == 2


def test_an_ablation_leaves_out_what_it_says() -> None:
    """And nothing else."""
    whole = LockstepSettings()
    assert ablated(whole, "none") is whole
    assert ablated(whole, "composes_now") == replace(whole, composes_now=True)
    assert ablated(whole, "no_gate") == replace(whole, gates=False)
    late = ablated(whole, "no_age")
    assert not late.gates
    assert late.parts.control.filter.age_max_ns == 2_000_000_000
    assert late.parts.control.filter.drift_mps == 0.0
    funnel = ablated(whole, "no_funnel").parts.control.filter.funnel
    assert funnel.r_c_m == 0.5


def test_a_flight_that_cannot_be_flown_is_a_row_with_its_reason() -> None:
    """A world that there is not; nothing is raised."""
    row = fly_job(Job("moon", 0, "clean", "wifi"))
    assert "no world 'moon'" in row.error
    assert (row.ends, row.safe) == ("failed", False)


def test_what_nobody_thought_of_is_a_row_too(monkeypatch: pytest.MonkeyPatch) -> None:
    """The others go on, and its kind is told."""
    monkeypatch.setattr("contact_sim.campaign.run.build_scene", lambda *_: 1 // 0)
    row = fly_job(Job("tunnel", 0, "clean", "wifi"))
    assert row.error == "ZeroDivisionError: integer division or modulo by zero"


def test_an_environment_of_a_drone_changes_no_flight(monkeypatch: pytest.MonkeyPatch) -> None:
    """A machine that is set up for a real drone flies the same, and none of it ends a campaign."""
    usual = LockstepSettings().parts
    for name, value in (("TAU_MAX_MS", "40"), ("CONTROL_HZ", "100"), ("NONSENSE", "1")):
        monkeypatch.setenv(f"DRONE_{name}", value)
    parts = LockstepSettings().parts
    same_boot = replace(parts.uplink, boot_id=usual.uplink.boot_id)
    assert replace(parts, uplink=same_boot) == usual


def test_a_touch_counts_however_the_flight_ended() -> None:
    """Where it touched is told of a flight that was broken off, too; contact it is not."""
    broken_off = replace(ROW, seed=4, ends="retreat", phase="abort", offset_m=0.044)
    untouched = replace(ROW, seed=5, ends="retreat", touched=False, offset_m=None, touch_age_s=None)
    of = summary([ROW, broken_off, untouched])
    assert (of["flights"], of["touched"], of["contact"], of["within_2cm"]) == (3, 2, 1, 1)
    assert of["offset_mm"]["max"] == pytest.approx(44.0)
    assert of["false_contact"] == 0
    words = page([replace(ROW, ablation="no_funnel"), broken_off, ROW], "it", "")
    assert "| nothing | 2 | 2 | 50 % [9, 91] | 50 % [9, 91] | 24.0 / 42.0 / 44.0 |" in words


def test_a_contact_that_was_none_is_told() -> None:
    """The client says done, the witness saw nothing."""
    world = build_scene("tunnel", 3)
    rig = d455()
    flight = LockstepFlight(
        world, 3, PROFILES["lan"], lambda s: ModelEyes(rig.color, stream(3, "eyes")), rig
    )
    flight.tick()
    flown = replace(flight.flown(), given_back=True)
    assert not flown.outcome.touched
    row = flight_row(ROW.flight, replace(flown, phase=Phase.DONE), None, 1.0)
    assert (row.ends, row.touched) == ("false_contact", False)
    of = summary([row])
    assert (of["contact"], of["false_contact"]) == (0, 1)
    assert "took for contact what was none | 0 | 1 |" in page([row], "it", "")


def test_a_flight_that_does_not_end_is_told() -> None:
    """Wherever it is as time is up, it has not retreated."""
    settings = LockstepSettings(longest_s=1.0)
    flown = lockstep_flight(settings=settings).fly()
    row = flight_row(ROW.flight, flown, None, 1.0)
    assert (row.ends, row.safe) == (UNFINISHED, True)
    of = summary([row])
    assert (of["unfinished"], of["retreat"], of["no_approach"]) == (1, 0, 0)


def test_when_nothing_can_be_flown_it_ends_early(tmp_path: Path) -> None:
    """Three of three: the fourth would be the same."""
    table = Table(tmp_path / "flights.csv", goes_on=False)
    jobs = [Job("moon", seed, "clean", "wifi") for seed in range(10)]
    with pytest.raises(ServiceError, match="no flight succeeds; the last: no world 'moon'"):
        fly_campaign(jobs, table, 1)
    table.close()
    assert len(table.rows) == 3
    resumed = Table(tmp_path / "flights.csv", goes_on=True)
    resumed.add(ROW)
    with pytest.raises(ServiceError, match="no flight succeeds"):
        fly_campaign(jobs, resumed, 1)
    resumed.close()
    assert len(resumed.rows) == 3 + 1 + 3


@pytest.mark.parametrize(("hits", "of"), [(0, 10), (3, 10), (98, 100), (100, 100)])
def test_the_intervals_are_wilsons(hits: int, of: int) -> None:
    """SciPy says the same."""
    expected = binomtest(hits, of).proportion_ci(0.95, "wilson")
    assert wilson(hits, of) == pytest.approx((expected.low, expected.high), abs=1e-6)


def test_the_numbers_are_those_of_the_rows() -> None:
    """Contacts, retreats, collisions; what failed is counted apart."""
    rows = [
        ROW,
        replace(ROW, seed=4, offset_m=0.015, attempts=2),
        replace(ROW, seed=5, ends="retreat", phase="abort", offset_m=None, touched=False),
        replace(ROW, seed=6, collisions="drone/propeller_0 on board", outside_m=0.002),
        replace(ROW, seed=7, error="no OpenGL"),
    ]
    assert summary([replace(ROW, ends="no_approach", attempts=0)])["no_approach"] == 1
    s = summary(rows)
    assert (s["flights"], s["failed"], s["contact"], s["retreat"]) == (4, 1, 3, 1)
    assert (s["within_2cm"], s["within_1cm"], s["first_attempt"]) == (3, 2, 2)
    assert (s["collided"], s["outside"], s["safe"]) == (1, 1, 3)
    assert s["outside_mm"] == 2.0
    assert s["offset_mm"]["max"] == 15.0
    assert s["real_time_factor"]["p50"] == 9.0
    text = page(
        [*rows, replace(ROW, fault="gust 2s"), replace(ROW, ablation="no_gate")], "cmd", "."
    )
    text_of_faults = text.split("## With a fault")[1].splitlines()
    widths = {line.count("|") for line in text_of_faults if line.startswith("|")}
    assert len(widths) == 2, widths  # two tables, each of one width
    for words in ("75 % [30, 95]", "gust 2s", "| the delay gate |", "no OpenGL"):
        assert words in text


def test_what_is_compared_stands_together() -> None:
    """Of a world and a fault first what lacks nothing; faults without an ablation are left out."""
    rows = [
        replace(ROW, fault=fault, ablation=ablation, seed=seed)
        for ablation, fault, seed in [
            ("none", "none", 1),
            ("none", "gust 2s", 2),
            ("none", "vio_out", 3),
            ("no_funnel", "none", 4),
            ("no_funnel", "gust 2s", 5),
        ]
    ]
    rows[-1] = replace(rows[-1], outside_m=0.004, touch_age_s=0.31)
    text = page(rows, "cmd", ".").split("## Without a part of the contract")[1]
    cells = [line.split(" | ") for line in text.splitlines() if line.startswith("| tunnel")]
    assert [(c[1], c[2][:10]) for c in cells] == [
        ("gust 2s", "nothing"),
        ("gust 2s", "the funnel"),
        ("none", "nothing"),
        ("none", "the funnel"),
    ]
    assert cells[1][8:11] == ["310 / 310 / 310", "1", "4.0"]


def test_the_command_flies_and_tells(tmp_path: Path) -> None:
    """Two flights in the tunnel by the model's eyes: a table, a page, JSON for machines."""
    arguments = ["campaign", "--world", "tunnel", "--flights", "2", "--jobs", "1", "--json"]
    arguments += ["--out", str(tmp_path)]
    result = CliRunner().invoke(app, arguments)
    assert result.exit_code == 0, result.output
    told = json.loads(result.stdout)
    assert told["tunnel / none / none"]["contact"] == 2
    rows = read_table(tmp_path / "flights.csv")
    assert [row.seed for row in rows] == [0, 1]
    assert all(row.safe for row in rows)
    assert (tmp_path / "flights.csv").read_text().splitlines()[0] == ",".join(NAMES)
    text = (tmp_path / "flights.md").read_text()
    assert "contact within 2 cm" in text
    # What was given and changes what is flown; where it is kept and how it is told does not
    assert "`python -m contact_sim campaign --world tunnel --flights 2`" in text
    assert all(0.05 < row.touch_age_s < 0.3 for row in rows)
    before = (tmp_path / "flights.csv").read_bytes()
    again = CliRunner().invoke(app, [*arguments, "--resume"])
    assert again.exit_code == 0
    assert (tmp_path / "flights.csv").read_bytes() == before


@pytest.mark.parametrize("endpoint", ["nonsense", "tcp/127.0.0.1:99999"])
def test_an_endpoint_that_is_none_is_told_at_once(tmp_path, endpoint) -> None:
    """In the words of the link, and before any flight."""
    arguments = ["campaign", "--eyes", "service", "--connect", endpoint, "--out", str(tmp_path)]
    result = CliRunner().invoke(app, arguments)
    assert isinstance(result.exception, ServiceError), result.exception
    assert endpoint in str(result.exception)


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (("--world", "moon"), "no world 'moon'; there are: tunnel, refinery"),
        (("--link", "string"), "no link 'string'"),
        (("--board", "rusty"), "no board 'rusty'; there are: clean, scratched, glossy"),
        (("--no-plain",), "there is nothing to fly"),
        (("--connect", "tcp/127.0.0.1:1"), "--connect is for --eyes service"),
        (("--faults", "nowhere.toml"), "faults nowhere.toml: No such file"),
    ],
)
def test_a_campaign_that_cannot_be_is_told_before_it_begins(tmp_path, arguments, says) -> None:
    """One line, and no table."""
    result = CliRunner().invoke(app, ["campaign", "--out", str(tmp_path / "out"), *arguments])
    assert isinstance(result.exception, SimulatorError)
    assert says in str(result.exception)
    assert not (tmp_path / "out").exists()
