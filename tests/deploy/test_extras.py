"""Each role runs with the packages of its own extra, as in an image that was built for it."""

import re
import subprocess
import sys
from importlib.metadata import PackageNotFoundError, distribution, packages_distributions
from pathlib import Path

import pytest

PROJECT = "aerial-contact"
ROOT = Path(__file__).resolve().parents[2]
BLOCKED = """
import sys
from importlib.abc import MetaPathFinder
allowed = set(sys.argv[1].split(","))
class Finder(MetaPathFinder):
    def find_spec(self, name, path=None, target=None):
        top = name.partition(".")[0]
        if path is None and top in set(sys.argv[2].split(",")) - allowed:
            raise ModuleNotFoundError(f"No module named {top!r}: not of this extra", name=top)
sys.meta_path.insert(0, Finder())
"""
OF_A_WORKER = """
import edge_service.cli, edge_service.http.app
from edge_service.detector.engines import open_engine
import numpy as np
open_engine("torch", None, threads=1).detect(np.zeros((96, 96, 3), np.uint8))
"""
OF_A_DRONE = """
import drone_client.cli, drone_client.load_test, drone_client.snap, drone_client.plot
"""
OF_A_SIMULATOR = """
import contact_sim.campaign.command, contact_sim.figures.command, contact_sim.hil.command
import contact_sim.flight.world, contact_sim.recording.film
from contact_sim.campaign.run import Job, fly_job
row = fly_job(Job("tunnel", 0, "clean", "wifi"))
assert not row.error, row.error
"""


def _installed_by(extra: str) -> set[str]:
    """Names of the distributions that an extra brings, with all that they need."""
    wanted, seen = [(PROJECT, frozenset({extra}))], set()
    while wanted:
        name, extras = wanted.pop()
        if (name, extras) in seen:
            continue
        seen.add((name, extras))
        try:
            requirements = distribution(name).requires or []
        except PackageNotFoundError:  # of another platform
            continue
        for line in requirements:
            need, _, marker = line.partition(";")
            asked = re.search(r"extra\s*==\s*[\"']([^\"']+)", marker)
            if asked and asked.group(1) not in extras:
                continue
            found = re.match(r"\s*([A-Za-z0-9._-]+)\s*(?:\[([^\]]*)\])?", need)
            assert found
            more = frozenset(e.strip() for e in (found.group(2) or "").split(",") if e.strip())
            wanted.append((_plain(found.group(1)), more))
    return {name for name, _ in seen}


def _plain(name: str) -> str:
    return re.sub(r"[-_.]+", "-", name).lower()


def _run(extra: str, code: str) -> subprocess.CompletedProcess[str]:
    """Code in a process that sees nothing installed but what an extra brings."""
    names = {top: {_plain(d) for d in of} for top, of in packages_distributions().items()}
    brought = _installed_by(extra)
    allowed = {top for top, of in names.items() if of & brought}
    lists = [",".join(sorted(allowed)), ",".join(sorted(names))]
    command = [sys.executable, "-c", BLOCKED + code, *lists]
    return subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=120)


@pytest.mark.parametrize(
    ("extra", "code"), [("edge", OF_A_WORKER), ("drone", OF_A_DRONE), ("sim", OF_A_SIMULATOR)]
)
def test_a_role_needs_no_package_of_another(extra: str, code: str):
    """The worker opens its detector without onnx, the drone's commands load without torch.

    A simulated drone flies without either, and without any viewer.
    """
    done = _run(extra, code)
    assert done.returncode == 0, done.stderr


def test_the_wall_between_extras_holds():
    """A package of another role is not there in such a process."""
    for extra, other in (
        ("drone", "torch"),
        ("drone", "mujoco"),
        ("sim", "torch"),
        ("sim", "rerun"),
    ):
        done = _run(extra, f"import {other}")
        assert done.returncode != 0
        assert "not of this extra" in done.stderr
