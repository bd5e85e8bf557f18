"""One flight that the tests of the figures share."""

from __future__ import annotations

import pytest

from contact_sim.figures.bench import FigureBench
from contact_sim.figures.run import Run, fly
from contact_sim.scene import build_scene


@pytest.fixture(scope="session")
def run() -> Run:
    """Run 1: from outside the safe set to contact and back."""
    return fly("a run", build_scene("tunnel", 3), 3)


@pytest.fixture
def bench(run: Run) -> FigureBench:
    """A bench whose two runs are flown already."""
    bench = FigureBench(quick=True)
    bench.__dict__.update(run_1=run, run_2=run)
    return bench
