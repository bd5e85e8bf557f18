"""Threads bounded to affinity and quota."""

from __future__ import annotations

import os

import pytest

from edge_service.detector.threads import available_cpus, cpu_quota, wait_asleep


@pytest.mark.parametrize(
    ("text", "quota"),
    [("150000 100000", 1.5), ("max 100000", None), ("", None), ("1 2 3", None), ("0 100000", None)],
)
def test_version_2_quota(tmp_path, text, quota):
    """``cpu.max`` holds quota and period, or max."""
    (tmp_path / "cpu.max").write_text(text + "\n")
    assert cpu_quota(tmp_path) == quota


@pytest.mark.parametrize(("text", "quota"), [("50000", 0.5), ("-1", None), ("x", None)])
def test_version_1_quota(tmp_path, text, quota):
    """``cpu.cfs_quota_us`` is -1 without a limit."""
    (tmp_path / "cpu").mkdir()
    (tmp_path / "cpu" / "cpu.cfs_quota_us").write_text(text + "\n")
    (tmp_path / "cpu" / "cpu.cfs_period_us").write_text("100000\n")
    assert cpu_quota(tmp_path) == quota


def test_no_cgroup_leaves_the_affinity(tmp_path):
    """On a bare machine the affinity alone counts."""
    assert available_cpus(tmp_path) == len(os.sched_getaffinity(0))


def test_a_part_of_a_cpu_is_one_thread(tmp_path):
    """A quota of 0.2 CPUs still needs a thread, and gets one."""
    (tmp_path / "cpu.max").write_text("20000 100000")
    assert available_cpus(tmp_path) == 1


def test_affinity_bounds_a_generous_quota(tmp_path):
    """A quota over what we may run on adds no threads."""
    (tmp_path / "cpu.max").write_text("99900000 100000")
    assert available_cpus(tmp_path) == len(os.sched_getaffinity(0))


def test_threads_sleep_unless_the_user_says_otherwise(monkeypatch):
    """OpenMP reads it once, when torch is loaded."""
    monkeypatch.delenv("OMP_WAIT_POLICY", raising=False)
    wait_asleep()
    assert os.environ["OMP_WAIT_POLICY"] == "PASSIVE"
    monkeypatch.setenv("OMP_WAIT_POLICY", "ACTIVE")
    wait_asleep()
    assert os.environ["OMP_WAIT_POLICY"] == "ACTIVE"
