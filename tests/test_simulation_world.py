"""What a simulated robot touches: ground of every kind, boards, obstacles; drives and sources."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from synthetic import arm_motion, sampled, standing

import robots
from trajopt import Solution
from trajopt.actuators.drive import Drive
from trajopt.certify.samples import evaluate
from trajopt.collision.shapes import LinkCapsule, SphereObstacle
from trajopt.simulation import simulate
from trajopt.surface import UP, Surface
from trajopt.terrain import Bump, PiecewiseTerrain, SmoothTerrain

# A standing robot moves by what its contacts give way, m.
STANDS = 1e-3
# MuJoCo's iterations on constraints end here, N m: some 1e-6 of what moves the arm.
SOLVER = 1e-4


@pytest.fixture(scope="module")
def stand() -> Solution:
    robot = robots.load("solo12")
    return sampled(robot, [standing(robot, 0.1)], 4)


def with_meta(plan: Solution, **changes: object) -> Solution:
    return replace(plan, meta={**plan.meta, **changes})


@pytest.mark.parametrize(
    "terrain",
    [
        PiecewiseTerrain.gap(0.5, at=(1.0, 0.0)),
        PiecewiseTerrain.steps([0.1], 0.3, at=(1.0, 0.0)),
        SmoothTerrain(shapes=(Bump(rise=0.1, centre=(3.0, 0.0), radius=0.2),)),
    ],
    ids=["gap", "step", "bump"],
)
def test_robot_stands_on_every_kind_of_ground(terrain, stand):
    found = simulate(with_meta(stand, terrain=terrain.describe()))
    assert found.report.passed
    assert found.report.base_error_max < STANDS
    assert found.record.force[-1, :, 2].sum() == pytest.approx(found.world.units.weight, rel=1e-3)


def test_robot_falls_into_a_hole(stand):
    stones = PiecewiseTerrain.stepping_stones([(5.0, 5.0)], 0.2)
    report = simulate(with_meta(stand, terrain=stones.describe())).report
    assert not report.passed
    assert report.missed == 4


def test_board_of_a_phase_carries_only_what_the_plan_puts_on_it(stand):
    board = Surface(point=np.zeros(3), normal=np.array(UP), friction=0.7).describe()
    frames = stand.meta["contact_frames"]
    whole = with_meta(stand, terrain=None, surfaces=[dict.fromkeys(frames, board)])
    assert simulate(whole).report.base_error_max < STANDS
    # Front feet alone: the hind ones have nothing under them.
    half = with_meta(stand, terrain=None, surfaces=[dict.fromkeys(frames[:2], board)])
    found = simulate(half)
    assert not found.report.passed
    assert not found.record.force[:, 2:].any()


def test_capsule_that_passes_through_an_obstacle_is_found():
    robot = robots.load("ur5")
    plan, data = sampled(robot, [arm_motion(robot)], 10), robot.model.createData()
    pin.framesForwardKinematics(robot.model, data, plan.q[plan.n_samples // 2])
    place = data.oMf[robot.model.getFrameId("tool0")].translation
    capsule = LinkCapsule(name="tool", frame="tool0", start=np.zeros(3), end=np.zeros(3), radius=0.03)
    for distance, hit in ((0.0, True), (5.0, False)):
        ball = SphereObstacle(name="ball", centre=place + np.array([0, 0, distance]), radius=0.05)
        scene = {"capsules": [capsule.describe()], "obstacles": [ball.describe()], "self_pairs": []}
        report = simulate(with_meta(plan, collision=scene)).report
        assert report.obstacle_hit is hit
        assert report.passed is not hit


def test_friction_of_drives_is_overcome_by_the_planned_torques():
    robot, drive = robots.load("ur5"), Drive(gear_ratio=100.0, viscous_friction=0.1, coulomb_friction=0.5)
    plan = sampled(robot, [arm_motion(robot)], 20, drives=[drive.to_meta()] * robot.nu)
    found, without = simulate(plan), simulate(with_meta(plan, drives=None))
    assert found.report.passed
    rate = plan.v[plan.collocation]
    more = np.abs(found.record.torque - without.record.torque).max(axis=0)
    np.testing.assert_allclose(more, 0.5 + 0.1 * np.abs(rate).max(axis=0), rtol=0.2)
    # What moves the robot is the same: a file has torques without the friction that drives overcome.
    moved = found.as_solution()
    points = moved.collocation
    force = evaluate(moved).generalized_force[points]
    np.testing.assert_allclose(force, moved.tau[points], atol=SOLVER)


def test_source_of_velocities_has_no_torque_limits():
    robot = robots.load("ur5")
    weak = sampled(robot, [arm_motion(robot)], 10, effort_limit=[1.0] * robot.nu)
    assert simulate(weak).report.saturated > 0.5
    source = simulate(with_meta(weak, actuation="acceleration")).report
    assert source.saturated == 0
    assert source.passed
    assert any("no torque limits" in note for note in source.notes)


def test_passive_joints_get_no_torque():
    robot = robots.load("acrobot")
    hanging = standing_pendulum(robot)
    found = simulate(hanging, noise=0.01)
    assert found.record.torque.shape[1] == robot.nu == 1
    assert found.report.joint_error_max < 0.1


def standing_pendulum(robot) -> Solution:
    still = np.zeros(robot.nv)
    motion = replace(
        arm_motion(robots.load("ur5")),
        q=lambda t: robot.reference,
        v=lambda t: still,
        a=lambda t: still,
        tau=lambda t: np.zeros(robot.nu),
    )
    return sampled(robot, [motion], 4)


def test_joints_that_the_plan_takes_into_the_ground_are_named(stand):
    buried = replace(stand, q=stand.q - np.eye(stand.q.shape[1])[2] * 0.2)
    notes = simulate(buried).report.notes
    assert any("KFE" in note and "mm into the ground" in note for note in notes)
