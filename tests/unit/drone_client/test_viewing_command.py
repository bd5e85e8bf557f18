"""``drone-client log`` and the options of ``fly``: what is asked for, and what cannot be had."""

from __future__ import annotations

import socket
from pathlib import Path

import pytest
from rich.console import Console
from typer.testing import CliRunner

from drone_client.cli import app
from drone_client.errors import ClientError, OutputError, WorldError
from drone_client.fly.views import Views, checked, write_views
from drone_client.viewing.live import Address, check_free, parse_address
from drone_client.viewing.viewer import need
from tests.unit.drone_client.view_builders import write_run


def test_a_run_is_written_for_both(tmp_path: Path):
    """Both files, named on stderr; nothing else is printed."""
    run = write_run(tmp_path / "run")
    mcap, rrd = tmp_path / "a.mcap", tmp_path / "a.rrd"
    result = CliRunner().invoke(app, ["log", str(run), "--mcap", str(mcap), "--rerun", str(rrd)])
    assert result.exit_code == 0, result.output
    assert (result.stdout, mcap.stat().st_size > 1000, rrd.stat().st_size > 1000) == (
        *("", True, True),
    )
    assert result.stderr.split() == ["wrote", str(mcap), "wrote", str(rrd)]


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        ((), "nothing to write: give --mcap, --rerun or --foxglove"),
        (("--mcap", "nowhere/a.mcap"), "there is no folder nowhere"),
        (("--mcap", "m" * 300 + ".mcap"), "mcap: File name too long"),
        (("--mcap", "."), "is a folder: give the name of a file"),
        (("--foxglove", "here"), "--foxglove here: give PORT or HOST:PORT, such as 8765"),
        (("--foxglove", "70000"), "give PORT or HOST:PORT"),
        (("--foxglove", "256.1.1.1:8765"), "--foxglove 256.1.1.1:8765: "),
        (("--mcap", "a.mcap"), "holds no run: there is no ledger.jsonl in it"),
    ],
)
def test_a_mistake_is_told(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, arguments: tuple[str, ...], says: str
):
    """In one sentence, before anything is written."""
    monkeypatch.chdir(tmp_path)
    result = CliRunner().invoke(app, ["log", str(tmp_path), *arguments])
    assert isinstance(result.exception, ClientError)
    assert says in str(result.exception)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("text", "address"),
    [("8765", ("127.0.0.1", 8765)), ("0.0.0.0:1", ("0.0.0.0", 1)), ("drone:80", ("drone", 80))],
)
def test_an_address_is_a_port_or_a_host_and_a_port(text: str, address: tuple[str, int]):
    """A port alone is this machine's own."""
    assert parse_address(text) == address


def test_a_port_that_is_taken_is_told():
    """Before the flight, not in it."""
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        with pytest.raises(OutputError, match=rf"127\.0\.0\.1:{port}: Address already in use"):
            check_free(Address("127.0.0.1", port))


def test_a_package_that_is_missing_is_told_with_its_extra():
    """Whoever lacks it is told what to install."""
    need("json", "--mcap")
    with pytest.raises(OutputError, match=r"--rerun needs package no_such: .*\[view\]"):
        need("no_such", "--rerun")


def test_a_film_is_of_a_simulated_flight(tmp_path: Path):
    """Of a real one there is no world to draw; and its name says which kind of file."""

    def ask(video: Path, *, simulated: bool) -> Views:
        return checked(video, None, None, None, simulated=simulated, overwrite=False)

    assert ask(tmp_path / "a.mp4", simulated=True).wants_pictures
    with pytest.raises(WorldError, match="--video shows a simulated world"):
        ask(tmp_path / "a.mp4", simulated=False)
    with pytest.raises(WorldError, match=r"a film is called \.mp4 or \.webm"):
        ask(tmp_path / "a.avi", simulated=True)
    with pytest.raises(OutputError, match="there is no folder"):
        ask(tmp_path / "b" / "a.mp4", simulated=True)
    assert not checked(None, None, None, None, simulated=True, overwrite=False).wants_pictures


@pytest.mark.parametrize(
    ("option", "shows"),
    [("--mcap", "foxglove.McapFile.show"), ("--rerun", "rerun_file.RerunFile.show")],
)
def test_an_interrupt_leaves_nothing_and_says_how_to_write_it_later(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, option: str, shows: str
):
    """Exit code 130 of the command; after a flight it is a sentence of the summary."""

    def interrupted(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(f"drone_client.viewing.{shows}", interrupted)
    run, out = write_run(tmp_path / "run"), tmp_path / "a.out"
    result = CliRunner().invoke(app, ["log", str(run), option, str(out)])
    sentence = f"{out} was given up; this writes it: drone-client log {run} {option} {out}"
    assert (result.exit_code, result.stderr.strip()) == (130, sentence)
    summary = {"unwritten": [], "recording": {"pictures": 8, "unwritten": []}}
    views = Views(mcap=out) if option == "--mcap" else Views(rerun=out)
    write_views(views, run, summary, None, Console(quiet=True), overwrite=False)
    assert summary["unwritten"] == [sentence]
    assert [p.name for p in tmp_path.iterdir()] == ["run"]


def test_what_could_not_be_written_is_in_the_summary(tmp_path: Path):
    """One file that cannot be keeps no other from being."""
    run = write_run(tmp_path / "run")
    there = tmp_path / "there.mcap"
    there.write_bytes(b"precious")
    summary = {"unwritten": [], "recording": {"pictures": 8, "unwritten": ["3 lines"]}}
    views = Views(mcap=there, rerun=tmp_path / "a.rrd")
    write_views(views, run, summary, None, Console(quiet=True), overwrite=False)
    assert summary["files"] == [str(tmp_path / "a.rrd")]
    lines, mcap = summary["unwritten"]
    assert lines == "3 lines"
    assert "there.mcap is there already" in mcap
    assert there.read_bytes() == b"precious"
    assert '"files"' in (run / "summary.json").read_text(encoding="utf-8")
