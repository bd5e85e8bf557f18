"""Guidance and filter flown together on a kinematic drone: it arrives, gently, and stays inside.

The drone follows each command with a first-order lag, holds it for 20 ms, and sees its tip with
noise. It is a model for the mathematics, not for the aerodynamics.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import pytest

from drone_client.cbf import (
    FilterInput,
    FilterSettings,
    Funnel,
    SafeCommand,
    Status,
    Variant,
    filter_command,
)
from drone_client.guidance import GuidanceSettings, guide
from rgbd_wire.geometry import Pose, rotation_from_vector

UP = (0.0, 0.0, 1.0)
ARM_BODY = np.array([0.55, 0.0, 0.0])
CAMERA_BEHIND_TIP_M = 0.43
AGE_NS = 100_000_000


@dataclass
class Flight:
    """Every tick of one flight."""

    tips: np.ndarray  # (n, 3)
    speeds: np.ndarray  # (n, 3)
    commands: list[SafeCommand]

    @property
    def touched(self) -> bool:
        return bool((self.tips[:, 0] <= 0).any())

    @property
    def reversals(self) -> int:
        """How often a command points against the one before."""
        u = np.array([command.velocity_body_target for command in self.commands])
        return int((np.einsum("ij,ij->i", u[1:], u[:-1]) < 0).sum())


def fly(
    start, seed: int, *, lag_s: float, noise_m: float, seconds: float, settings: FilterSettings
) -> Flight:
    """Fly until the tip has pressed 15 mm or the time is up."""
    rng = np.random.default_rng(seed)
    yaw, yaw_rate = math.pi + rng.uniform(-0.4, 0.4), 0.0
    body = np.array(start) - rotation_from_vector(np.array([0, 0, yaw])) @ ARM_BODY
    velocity, follow = np.zeros(3), 1.0 - math.exp(-settings.period_s / lag_s)
    tips, speeds, commands = [], [], []
    for _ in range(round(seconds / settings.period_s)):
        rotation = rotation_from_vector(np.array([0, 0, yaw]))
        tip = body + rotation @ ARM_BODY
        estimate = tip + noise_m * rng.normal(size=3)
        wish = guide(Pose.from_rotation(rotation, estimate), GuidanceSettings(), UP)
        inp = FilterInput(
            tip_target=tuple(estimate.tolist()),
            velocity_tip_nominal_target=wish.velocity_tip_target,
            yaw_rate_nominal_radps=wish.yaw_rate_radps,
            lever_arm_target=tuple((rotation @ ARM_BODY).tolist()),
            up_target=UP,
            age_ns=AGE_NS,
            range_m=max(CAMERA_BEHIND_TIP_M, float(estimate[0]) + CAMERA_BEHIND_TIP_M),
            sigma_m=0.0005,
        )
        command = filter_command(inp, settings)
        velocity = velocity + follow * (np.array(command.velocity_body_target) - velocity)
        yaw_rate += follow * (command.yaw_rate_radps - yaw_rate)
        tips.append(tip)
        speeds.append(velocity + yaw_rate * np.cross(UP, rotation @ ARM_BODY))
        commands.append(command)
        body, yaw = body + settings.period_s * velocity, yaw + settings.period_s * yaw_rate
        if tip[0] <= -0.015:
            break
    return Flight(np.array(tips), np.array(speeds), commands)


def random_start(seed: int) -> tuple[float, float, float]:
    """Half of these lie outside the funnel."""
    rng = np.random.default_rng(seed)
    return tuple(rng.uniform((0.5, -1.0, -1.0), (3.0, 1.0, 1.0)).tolist())


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize(("lag_s", "noise_m"), [(1e-6, 0.0), (0.2, 0.002)])
def test_every_start_ends_in_a_gentle_touch(seed, lag_s, noise_m) -> None:
    """It presses the target, through the mouth, no faster than allowed, and hardly turns back."""
    flight = fly(
        random_start(seed),
        seed,
        lag_s=lag_s,
        noise_m=noise_m,
        seconds=40.0,
        settings=FilterSettings(),
    )
    assert flight.tips[-1, 0] <= -0.015
    touch = int(np.argmax(flight.tips[:, 0] <= 0.0))
    assert math.hypot(*flight.tips[touch, 1:]) < 0.005
    assert -flight.speeds[touch, 0] <= 0.08
    assert flight.reversals <= 10
    assert Status.ABORT not in {command.status for command in flight.commands}

    h = np.array([Funnel().h(tuple(tip)) for tip in flight.tips])
    inside = int(np.argmax(h >= 0))
    assert (h[inside:] >= -0.01).all()


def test_as_printed_the_paper_hangs_in_front_of_the_target_and_chatters() -> None:
    """The same flights with the printed gradient never touch and reverse hundreds of times."""
    printed = FilterSettings(variant=Variant.PAPER, allow_unsafe_variant=True)
    for seed in range(2):
        start = random_start(seed)
        flight = fly(start, seed, lag_s=0.2, noise_m=0.002, seconds=40.0, settings=printed)
        assert not flight.touched
        assert flight.tips[-100:, 0].min() > 0.05
        assert flight.reversals > 200
