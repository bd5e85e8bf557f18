"""``python -m detector_training target``: what is printed, and what is told in one line."""

import json

import pytest
import typer
from typer.testing import CliRunner

from detector_training.commands import target as command
from detector_training.errors import TargetPrintError
from target_pose.errors import TargetFileError
from target_pose.target import packaged_targets, target_file

APP = typer.Typer()
command.register(APP)


def run(*arguments):
    """Run a command that should work, and give what it wrote to stdout."""
    result = CliRunner().invoke(APP, ["target", *map(str, arguments)], catch_exceptions=False)
    assert result.exit_code == 0, result.output
    return result.stdout


def test_list():
    """Every packaged target, for people and for machines."""
    assert all(name in run("list") for name in packaged_targets())
    assert [t["name"] for t in json.loads(run("list", "--json"))] == list(packaged_targets())


def test_show():
    """Sizes, levels and reach; a longer lens sees it from farther."""
    told = json.loads(run("show", "bullseye-200", "--fx", "700", "--height", "350", "--json"))
    assert told["board"] == {"side_m": 0.2, "shade": "white"}
    assert told["levels"] == {"T_good": 0.2, "T_better": 0.15, "T_best": 0.07}
    assert (told["board_14px_m"], told["board_fills_picture_m"]) == pytest.approx((10.0, 0.4))
    text = run("show", "bullseye-200", "--fx", "700", "--height", "350")
    assert "at 10.00 m and fills the picture at 0.40 m" in text
    assert told["hash"] in text


PANEL = """name = "panel"
board = {side_m = 0.3, shade = "white"}
points = [
  {name = "a", y_m = -0.12, z_m = 0.12}, {name = "b", y_m = 0.12, z_m = 0.12},
  {name = "c", y_m = 0.12, z_m = -0.12}, {name = "d", y_m = -0.12, z_m = -0.12},
]
"""


def test_a_target_of_points_is_shown_and_not_drawn(tmp_path):
    """Where its points are can be checked; what it looks like is not known."""
    toml = tmp_path / "panel.toml"
    toml.write_text(PANEL)
    told = json.loads(run("show", toml, "--json"))
    assert told["discs"] == []
    assert told["levels"] == {"T_good": 0.3}
    assert told["points"][1] == {"name": "b", "y_m": 0.12, "z_m": 0.12}
    text = run("show", toml)
    assert "size [mm]" in text
    assert "+120 right, -120 up" in text
    with pytest.raises(TargetFileError, match="no .*discs.*cannot be drawn"):
        run("print", toml, "--pdf", tmp_path / "a.pdf")
    assert not (tmp_path / "a.pdf").exists()


def test_print_of_ones_own(tmp_path):
    """One's own file, with its colours, as PDF and SVG at once; nothing else is left behind."""
    toml = tmp_path / "mine.toml"
    text = target_file("bullseye-200").read_text()
    toml.write_text(f'{text}\n[colours]\nblack = "#102040"\n')
    run("print", toml, "--pdf", tmp_path / "a.pdf", "--svg", tmp_path / "a.svg", "--paper", "a4")
    assert sorted(p.name for p in tmp_path.iterdir()) == ["a.pdf", "a.svg", "mine.toml"]
    assert (tmp_path / "a.svg").read_text().count("<circle") == 3
    assert "#102040" in (tmp_path / "a.svg").read_text()
    assert (tmp_path / "a.pdf").read_bytes().startswith(b"%PDF")


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        ([], "--pdf or --svg"),
        (["--pdf", "a.png"], "name a .pdf file"),
        (["--svg", "a.svg", "--paper", "A4", "--tiles"], "use --pdf for tiles"),
        (["--pdf", "a.pdf", "--paper", "A4"], "--paper A2 or --tiles"),
        (["--pdf", "a.pdf", "--tiles"], "name a --paper"),
        (["--pdf", "a.pdf", "--margin-mm", "-1"], "margin of -1.0 mm"),
    ],
)
def test_what_cannot_be_printed_is_told(arguments, told, tmp_path, monkeypatch):
    """A wrong request names the option that is wrong, and writes nothing."""
    monkeypatch.chdir(tmp_path)
    with pytest.raises(TargetPrintError, match=told):
        run("print", "bullseye-400", *arguments)
    assert not list(tmp_path.iterdir())


def test_unknown_target():
    """A target that is not there is told with those that are."""
    with pytest.raises(TargetFileError, match="packaged: bullseye-200, bullseye-400"):
        run("show", "bullseye-999")
