"""What all tests share: how hypothesis runs, and a seeded generator."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import HealthCheck, settings

# The suite says the same thing every time; ``--hypothesis-profile explore`` looks for news.
settings.register_profile(
    "suite",
    deadline=None,
    derandomize=True,
    database=None,
    max_examples=60,
    suppress_health_check=[HealthCheck.too_slow],
)
settings.register_profile(
    "explore",
    deadline=None,
    max_examples=2000,
    print_blob=True,
    suppress_health_check=[HealthCheck.too_slow],
)
settings.load_profile("suite")


@pytest.fixture
def rng() -> np.random.Generator:
    """Random numbers that are the same in every run."""
    return np.random.default_rng(20240229)
