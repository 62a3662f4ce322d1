"""Walks without optimisation: footsteps, the pendulum over them, postures, torques."""

import json

import numpy as np
import pinocchio as pin
import pytest

from tests.support.command_lines import invoke
from trajopt.errors import InputError
from trajopt.motion.solution import Solution
from trajopt.reduced import Walk, commanded_walk, walk_plan
from trajopt.robot import Robot, legs_only
from trajopt.simulation.simulate import simulate
from trajopt_library import robots

# Velocity of feet on the ground, over natural units.
STILL = 1e-3


@pytest.fixture(scope="module")
def talos() -> Robot:
    return legs_only(robots.load("talos"))


@pytest.fixture(scope="module")
def plan(talos: Robot) -> Solution:
    walk = commanded_walk(talos, steps=4, speed=0.3, turn_rate=0.2)
    return walk_plan(talos, walk)


def test_speeds_give_the_way_of_the_steps(talos: Robot):
    walk = commanded_walk(talos, steps=6, speed=0.3, turn_rate=-0.2, step_time=0.5, double_support=0.1)
    assert (walk.length, walk.turn, walk.side) == pytest.approx((0.18, -0.12, 0.0))
    feet = walk.plan(talos).supports
    way = np.mean([foot.position for foot in feet[-1].feet.values()], axis=0) - np.mean(
        [foot.position for foot in feet[0].feet.values()], axis=0
    )
    assert np.linalg.norm(way) <= 5 * 0.18
    assert feet[-1].feet["left"].yaw - feet[0].feet["left"].yaw == pytest.approx(-5 * 0.12)


@pytest.mark.parametrize("side_speed", [0.1, -0.1])
def test_feet_do_not_come_nearer_than_in_the_stance_when_walking_aside(talos: Robot, side_speed: float):
    walk = commanded_walk(talos, steps=9, speed=0.0, side_speed=side_speed)
    supports = [s.feet for s in walk.plan(talos).supports if len(s.feet) == 2]
    across = [float(feet["left"].position[1] - feet["right"].position[1]) for feet in supports]
    assert min(across) == pytest.approx(across[0]) == pytest.approx(across[-1])
    moved = supports[-1]["left"].position[1] - supports[0]["left"].position[1]
    assert moved == pytest.approx(8 * walk.side)


@pytest.mark.long
def test_the_centre_of_mass_stays_at_one_height_and_feet_on_their_footholds(talos: Robot, plan: Solution):
    data, model = talos.model.createData(), talos.model
    height = [pin.centerOfMass(model, data, q)[2] for q in plan.q]
    assert np.ptp(height) < 1e-3 * talos.length
    for i, frame in enumerate(plan.contact_frames):
        for k in np.flatnonzero(plan.active[:, i]):
            pin.computeJointJacobians(model, data, plan.q[k])
            pin.updateFramePlacements(model, data)
            jacobian = pin.getFrameJacobian(
                model, data, model.getFrameId(frame), pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
            )
            assert np.abs(jacobian @ plan.v[k]).max() < STILL * np.sqrt(9.81 * talos.length)


def test_torques_and_contact_forces_give_the_motion(talos: Robot, plan: Solution):
    assert plan.success
    model, data = talos.model, talos.model.createData()
    for k in range(0, len(plan.t), 7):
        needed = pin.rnea(model, data, plan.q[k], plan.v[k], plan.a[k])
        pin.computeJointJacobians(model, data, plan.q[k])
        pin.updateFramePlacements(model, data)
        for i, frame in enumerate(plan.contact_frames):
            jacobian = pin.getFrameJacobian(
                model, data, model.getFrameId(frame), pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
            )
            needed -= jacobian.T @ plan.f[k, i]
        needed[6:] -= plan.tau[k]
        weight = pin.computeTotalMass(model) * 9.81
        assert np.abs(needed).max() < 1e-2 * weight * talos.length


def test_a_saved_plan_is_a_solution_like_any_other(plan: Solution, tmp_path):
    file = plan.save(tmp_path / "walk.npz")
    loaded = Solution.load(file)
    assert loaded.description.problem == "walk"
    assert loaded.description.parameters["steps"] == 4
    assert invoke("check", file).exit_code in (0, 1)


@pytest.mark.long
def test_talos_walks_in_physics(plan: Solution):
    report = simulate(plan, controller="whole-body").report
    assert report.passed
    assert report.missed == 0
    assert report.base_error_max is not None
    assert report.base_error_max < 0.01
    assert report.controller is not None
    assert report.controller.relaxed == {"nothing": report.controller.ticks}


@pytest.mark.long
def test_the_command_writes_plan_and_simulation(tmp_path):
    plan, motion = tmp_path / "plan.npz", tmp_path / "motion.npz"
    done = invoke(
        "walk", "g1", "--steps", "3", "--plan", plan, "-o", motion, "--json", "--side-speed", "0.03"
    )
    assert done.exit_code == 0
    assert json.loads(done.stdout)["passed"]
    assert Solution.load(plan).description.parameters["side"] > 0
    assert Solution.load(motion).statistics.simulated


@pytest.mark.parametrize(
    ("given", "message"),
    [
        (("bolt",), "stands on points"),
        (("ur5",), "fixed base"),
        (("talos", "--steps", "1"), "steps of Walk is 1; allowed: a whole number >= 2"),
        (("talos", "--speed", "nan"), "speed of commanded_walk is nan"),
        (("talos", "--turn-rate", "30", "--crouch", "0"), "at the end of its range"),
        (("talos", "--steps", "2", "--step-time", "0.01", "--crouch", "0"), "turns at"),
        (("talos", "--crouch", "2"), "do not bend by a crouch of 2 m"),
    ],
)
def test_bad_input_is_one_line(given: tuple[str, ...], message: str):
    done = invoke("walk", *given)
    assert done.exit_code == 2
    assert message in done.stderr
    assert done.stderr.count("\n") == 1


def test_side_must_be_a_number():
    with pytest.raises(InputError, match="side of Walk is nan"):
        Walk(side=float("nan"))
