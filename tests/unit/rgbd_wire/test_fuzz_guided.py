"""A few seconds of the guided fuzzer, and of the one on several processes."""

from __future__ import annotations

import importlib.util
import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[3]


def fuzz(folder: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "tests.perf.fuzz", *arguments],
        cwd=ROOT,
        env=os.environ | {"TMPDIR": str(folder)},
        capture_output=True,
        text=True,
        check=False,
        timeout=120,
    )


@pytest.mark.skipif(importlib.util.find_spec("atheris") is None, reason="atheris is not there")
def test_guided_fuzzing_finds_nothing_and_keeps_a_corpus(tmp_path: Path) -> None:
    """Both targets start from their seeds, run to their end, and leave what they learnt."""
    done = fuzz(tmp_path, "atheris", "--seconds", "2")
    assert done.returncode == 0, done.stderr[-3000:]
    for name in ("tunnel", "messages"):
        corpus = list((tmp_path / "aerial-fuzz" / name / "corpus").iterdir())
        assert any(not path.name.startswith("seed-") for path in corpus)


@pytest.mark.parametrize("what", ["datagrams", "messages"])
def test_two_processes_tell_one_story(tmp_path: Path, what: str) -> None:
    """The summary counts the inputs of both, and says that there was neither crash nor hang."""
    done = fuzz(tmp_path, what, "--count", "8000")
    assert done.returncode == 0, done.stdout + done.stderr
    summary = done.stdout.splitlines()[-1]
    assert int(summary.split()[0]) >= 8000
    assert summary.endswith("no crash, no hang")
