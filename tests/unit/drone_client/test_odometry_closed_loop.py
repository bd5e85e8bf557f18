"""The odometry jumps in flight: the tip never comes nearer before the target was measured again.

Everything from the vehicle's pose to the velocity command is the real thing (watch, pose buffer,
gate, target filter, mission, guidance, safety filter); ``mission_world`` flies the vehicle.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from drone_client.control import OnMission, decide
from drone_client.fly.vehicle_pose import VehiclePose
from drone_client.gate import GateSettings, SentFrame
from drone_client.mission import Phase, Reason, Senses
from drone_client.odometry.jump import Jump
from drone_client.reception import Receiver, Reception
from drone_client.target import Update
from rgbd_wire.geometry import Pose
from rgbd_wire.messages import Ack, Outcome, Result, seal_ack, seal_result
from tests.unit.drone_client.builders import MS, WORKER_BOOT_ID, pose, target_of
from tests.unit.drone_client.mission_world import (
    AIRFRAME,
    ANSWER_TICKS,
    BOARD,
    FLYING,
    SIGMA_M,
    SIGMA_PER_M,
    SIGMA_RAD,
    VIO_NOISE_M,
    World,
)

DRONE, BOOT_ID, WORKER = "drone-1", 7, "w1"
SAG_M = 0.003
"""Noise and the last command's way while the vehicle comes to rest, in no phase a centimetre."""


class JumpyWorld(World):
    """The same world, known through the real receiver and the real watch."""

    def __post_init__(self) -> None:
        super().__post_init__()
        self.resets = 0
        self.told_jumps: list[Jump] = []
        self.receptions: list[Reception] = []
        self.answers: list[tuple[int, int, int, Pose, float]] = []
        self.sequence = 0
        self.odometry: Pose | None = None
        self.pose = VehiclePose(self._state, self._keep, self._on_jump)
        self.receiver = Receiver(
            DRONE,
            BOOT_ID,
            GateSettings(250 * MS, 400 * MS),
            AIRFRAME,
            on_heard=lambda sequence, worker, t_ns: None,
            on_result=self.receptions.append,
        )

    def jump(self, by: Pose, *, resets: int = 0) -> None:
        """The odometry's world moves; nobody says so, unless its count does."""
        self.vio_from_world = by @ self.vio_from_world
        self.resets += resets

    def _keep(self, t_ns: int, world_from_body: Pose) -> None:
        self.receiver.add_pose(t_ns, world_from_body)

    def _on_jump(self, jump: Jump) -> None:
        self.told_jumps.append(jump)
        self.receiver.begin_epoch(jump.t_ns)

    def _state(self):
        velocity = self.vio_from_world.rotation @ self.velocity
        return replace(
            FLYING,
            t_heard_ns=self.now_ns,
            t_pose_ns=self.now_ns,
            world_from_body=self.odometry,
            velocity_world=velocity + 0.01 * self.rng.normal(size=3),
            pose_resets=self.resets,
        )

    def step(self) -> None:
        """One tick, in the order of the control loop: pose, estimate, senses."""
        self.tick += 1
        true = self.vio_from_world @ self.world_from_body
        noise = VIO_NOISE_M * self.rng.normal(size=3)
        self.odometry = Pose(true.translation + noise, true.q_wxyz)
        self._receive()
        here = self.pose(self.now_ns)
        self._send()
        self.estimate = self.receiver.estimate
        jumped = self.pose.jumped(self.now_ns) or self.receiver.lost is not None
        senses = Senses(self._state(), odometry_jumped=jumped, order=self.order)
        decision = decide(
            self.now_ns,
            self.estimate,
            here,
            AIRFRAME,
            self.settings,
            OnMission(self.mission, senses),
        )
        self.mission = decision.mission
        if self.mission.transition is not None:
            self.transitions.append(self.mission.transition)
        self.decisions.append(decision)
        turn = self.vio_from_world.rotation.T
        self.commands.append(
            (turn @ decision.command.velocity_world, decision.command.yaw_rate_radps)
        )
        self._move(*self.commands.pop(0))
        self.tips.append(self.tip)

    def _send(self) -> None:
        if self.tick % self.frame_ticks or not (self.link and self.sees):
            return
        self.sequence += 1
        seen = (self.world_from_body @ AIRFRAME.body_from_camera).inverse() @ BOARD
        sigma_m = SIGMA_M + SIGMA_PER_M * np.linalg.norm(seen.translation)
        seen = seen @ pose(sigma_m * self.rng.normal(size=3), SIGMA_RAD * self.rng.normal(size=3))
        self.receiver.sending(SentFrame(self.sequence, self.now_ns, self.now_ns, WORKER))
        ack = Ack(DRONE, BOOT_ID, self.sequence, WORKER, WORKER_BOOT_ID)
        self.receiver.on_message(seal_ack(ack), self.now_ns)
        self.answers.append(
            (self.tick + ANSWER_TICKS, self.sequence, self.now_ns, seen, float(sigma_m))
        )

    def _receive(self) -> None:
        while self.answers and self.answers[0][0] <= self.tick:
            _, sequence, t_ns, seen, sigma_m = self.answers.pop(0)
            covariance = np.diag([sigma_m**2] * 3 + [SIGMA_RAD**2] * 3)
            result = Result(
                drone=DRONE,
                boot_id=BOOT_ID,
                sequence=sequence,
                t_capture_ns=t_ns,
                t1_ns=t_ns,
                t2_ns=0,
                t3_ns=30 * MS,
                worker=WORKER,
                worker_boot_id=WORKER_BOOT_ID,
                outcome=Outcome.TARGET,
                reason="",
                target=target_of(seen, covariance),
                stages_ns={},
                model="0" * 64,
                draining=False,
            )
            if self.link:
                self.receiver.on_message(seal_result(result), self.now_ns)


def flown_to(phase: Phase, seed: int) -> JumpyWorld:
    """A flight that is in a phase, and near the board where that phase is."""
    world = JumpyWorld(seed)
    world.fly_until(phase, settled_s=0.4)
    if phase is Phase.APPROACH:
        while world.tip[0] > 0.25:
            world.step()
    assert world.told_jumps == []
    assert world.phase is phase
    return world


def remeasured(world: JumpyWorld, since_ns: int) -> bool:
    """Whether a measurement from after the jump has come in."""
    return any(
        r.update in (Update.FIRST, Update.FUSED) and r.result.t_capture_ns > since_ns
        for r in world.receptions
    )


PHASES = [Phase.ALIGN, Phase.APPROACH, Phase.CONTACT]
AWAY = [(0.3, 0, 0), (-0.3, 0, 0), (0.1, -0.2, 0.2)]


def coast_m(world: JumpyWorld) -> float:
    """How far a vehicle with this lag still goes by what it was told before the jump."""
    closing = max(0.0, -float((BOARD.rotation.T @ world.velocity)[0]))
    for command, _ in world.commands:
        closing = max(closing, -float((BOARD.rotation.T @ command)[0]))
    return closing * (0.3 + 0.04) + SAG_M


@pytest.mark.parametrize("phase", PHASES)
@pytest.mark.parametrize("away", AWAY)
def test_a_jump_never_brings_the_tip_nearer_before_the_target_is_measured_again(phase, away):
    """30 cm in any direction: told at that tick, brakes, and only coasts to rest."""
    world = flown_to(phase, 1)
    jump_ns, near_m, coasts_m = world.now_ns, world.tip[0], coast_m(world)
    world.jump(pose(away))
    world.step()
    assert len(world.told_jumps) == 1
    assert world.decisions[-1].safe is None  # nothing was flown by
    assert not np.any(world.decisions[-1].command.velocity_world)
    assert world.reasons[-1] is Reason.ODOMETRY_JUMPED
    while not remeasured(world, jump_ns):
        assert not np.any(world.decisions[-1].command.velocity_world)
        assert world.tip[0] >= near_m - coasts_m
        world.step()
    assert Update.BEFORE_JUMP in [r.update for r in world.receptions]


@pytest.mark.parametrize("phase", PHASES)
def test_without_another_measurement_it_stands_until_it_gives_the_vehicle_back(phase):
    """Out of sight after the jump: no search beside a board of which only the distance is known."""
    world = flown_to(phase, 3)
    near_m, coasts_m = world.tip[0], coast_m(world)
    world.sees = False
    world.jump(pose((0.3, 0, 0)))
    world.answers.clear()
    begun = len(world.decisions)
    world.fly(20.0)
    assert world.phase is Phase.ABORT
    assert min(t[0] for t in world.tips[begun:]) >= near_m - coasts_m
    for decision in world.decisions[begun:]:
        assert not np.any(decision.command.velocity_world)
        assert decision.command.yaw_rate_radps == 0.0


@pytest.mark.parametrize("phase", PHASES)
def test_once_measured_again_the_mission_goes_on_to_contact(phase):
    """Away from the board first, aligned anew, touched in the middle, and back."""
    world = flown_to(phase, 4)
    world.jump(pose((0.1, 0.3, -0.05), (0, 0, 0.2)))
    world.fly(120.0)
    assert world.phase is Phase.DONE
    assert len(world.told_jumps) == 1
    assert world.reasons.count(Reason.ODOMETRY_JUMPED) == 1
    after = world.phases[world.reasons.index(Reason.ODOMETRY_JUMPED) :]
    assert after[:2] == [Phase.BRAKE, Phase.RETREAT]
    assert max(world.closing) <= 0.05
    touches = np.array([t for t in world.tips if t[0] < 0.0])
    assert np.hypot(touches[:, 1], touches[:, 2]).max() < 0.02


def test_a_jump_that_only_the_source_knows_of_brakes_as_well():
    """The vehicle's count of resets goes up, the place hardly moves."""
    world = flown_to(Phase.APPROACH, 5)
    world.jump(pose((0.01, 0, 0)), resets=1)
    world.step()
    assert world.reasons[-1] is Reason.ODOMETRY_JUMPED


def test_a_jump_while_searching_does_not_end_the_search():
    """Nothing was known that could be lost: a pause, and on."""
    world = JumpyWorld(6, sees=False)
    world.fly_until(Phase.SEARCH)
    world.jump(pose((0.3, 0, 0)))
    world.fly(3.0)
    assert world.reasons.count(Reason.ODOMETRY_JUMPED) == 1
    assert world.phase is Phase.SEARCH
    world.sees = True
    world.fly(120.0)
    assert world.phase is Phase.DONE


def test_a_flight_without_a_jump_has_none():
    """The whole mission, noise and contact and all: the watch stays silent."""
    for seed in range(2):
        world = JumpyWorld(10 + seed).fly(120.0)
        assert world.phase is Phase.DONE
        assert world.told_jumps == []


@pytest.mark.parametrize("away", [(0.3, 0, 0), (-0.3, 0, 0), (0, 0.3, 0)])
@pytest.mark.parametrize("over_s", [0.3, 1.0])
def test_a_jump_that_an_estimator_smooths_brakes_before_the_board(away, over_s):
    """Seen within the glide, flown by for less than ten centimetres of it, touched right after."""
    world = flown_to(Phase.APPROACH, 7)
    near_m = world.tip[0]
    ticks = round(over_s / 0.02)
    for _ in range(ticks):
        world.jump(pose(np.array(away) / ticks))
        world.step()
    assert world.told_jumps
    assert Reason.ODOMETRY_JUMPED in world.reasons
    assert world.tip[0] >= near_m - 0.1
    world.fly(120.0)
    assert world.phase is Phase.DONE
    assert max(world.closing) <= 0.05
    touches = np.array([t for t in world.tips if t[0] < 0.0])
    assert np.hypot(touches[:, 1], touches[:, 2]).max() < 0.02
