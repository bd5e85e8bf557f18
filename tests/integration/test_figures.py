"""All figures at once, quickly: real flights, and a real service that looks at the pictures."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest
from PIL import Image

from contact_sim.figures.catalogue import CATALOGUE
from contact_sim.figures.style import caption_of

ROOT = Path(__file__).parents[2]
FLOWN = [e.name for e in CATALOGUE if e.name not in ("contact-force", "fly-by", "conditions")]
"""Their captions end with who looked; the others say it on their way."""


OF_A_DRONE = {"DRONE_NONSENSE": "1", "DRONE_TLS": "/nowhere", "DRONE_TAU_MAX_MS": "900"}
"""What a machine may have for its real drone, wrong or right: no flight in lockstep reads it."""


@pytest.mark.timeout(900)
def test_every_figure_is_drawn_and_the_page_shows_them_all(tmp_path):
    """Exit code 0; each carries its caption; the service finds boards, and none where none is."""
    out, page = tmp_path / "figures", tmp_path / "figures.md"
    options = ["--quick", "--json", "--jobs", "1", "--out", str(out), "--page", str(page)]
    done = subprocess.run(
        [sys.executable, "-m", "contact_sim.figures", *options],
        capture_output=True,
        text=True,
        check=False,
        timeout=800,
        cwd=tmp_path,
        env=os.environ | OF_A_DRONE | {"PYOPENGL_PLATFORM": "glx"},  # which mujoco does not take
    )
    assert done.returncode == 0, done.stderr
    result = json.loads(done.stdout)
    assert list(result["drawn"]) == [entry.name for entry in CATALOGUE]
    assert result["failed"] == {}
    text = page.read_text()
    assert f"`scripts/figures --quick --out {out} --page {page}`" in text
    for entry in CATALOGUE:
        assert f"`scripts/figures {entry.name} --quick`" in text
        path = out / f"{entry.name}.png"
        assert caption_of(path) in text
        with Image.open(path) as picture:
            assert picture.width == 1000
    assert "Poses that are at no board: 0." in caption_of(out / "fly-by.png")
    assert "2 of 2 found" in caption_of(out / "conditions.png")
    assert all("Flown with" in caption_of(out / f"{name}.png") for name in FLOWN)
    # the service's log goes beside where one works, and nothing else does
    assert {p.name for p in tmp_path.iterdir()} == {"figures", "figures.md", "runs"}


def test_the_help_of_the_script_sets_nothing_up():
    """It names itself and its options, at once."""
    done = subprocess.run(
        [ROOT / "scripts/figures", "--help"],
        capture_output=True,
        text=True,
        check=False,
        timeout=60,
    )
    assert (done.returncode, done.stderr) == (0, "")
    for word in ("scripts/figures", "--quick", "--table", "--page"):
        assert word in done.stdout
    assert "#" not in done.stdout


def test_an_unknown_figure_ends_in_one_line(tmp_path):
    """Exit code 2, with those that there are."""
    done = subprocess.run(
        [sys.executable, "-m", "contact_sim.figures", "nose"],
        capture_output=True,
        text=True,
        check=False,
        timeout=120,
        cwd=tmp_path,
    )
    assert done.returncode == 2
    assert len(done.stderr.splitlines()) == 1
    assert "'nose'" in done.stderr
    assert "cbf-boundary" in done.stderr
