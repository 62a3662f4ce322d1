"""A carried body: dynamics of the loaded robot, and what its file tells of it."""

from dataclasses import replace
from functools import lru_cache
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

import trajopt
from trajopt.certify.report import AT_POINTS, RESIDUAL
from trajopt.errors import InputError
from trajopt.motion.carried import payload_wrenches
from trajopt.problem.problem import Problem
from trajopt.robot.contact import Contact
from trajopt.robot.payload import Payload, loaded, payload_wrench
from trajopt.terrain.flat import FlatGround
from trajopt_library.problems import ur5_reach

MASS, CENTRE = 3.0, np.array([0.0, 0.02, 0.1])
INERTIA = np.diag([0.01, 0.02, 0.015])
# Torques of two ways of writing the same dynamics, N m: rounding.
ROUNDING = 1e-10
# Error of the open loop at 60 intervals, rad: 3.5e-4, which falls with the fourth power of the step.
OPEN_LOOP = 1e-3


def _payload() -> Payload:
    return Payload(contact="tool", mass=MASS, centre=CENTRE, inertia=INERTIA)


@lru_cache(maxsize=1)
def _empty() -> Problem:
    problem = replace(ur5_reach.FAMILY.load({}), terrain=FlatGround(height=-2.0))
    return replace(problem, robot=replace(problem.robot, contacts=(Contact(frame="tool0", name="tool"),)))


@lru_cache(maxsize=1)
def _solution() -> trajopt.Solution:
    problem = _empty()
    carrying = replace(problem, payloads={problem.schedule.phases[0].name: _payload()})
    return trajopt.solve(carrying, intervals=60)


@pytest.mark.long
def test_torques_are_those_of_the_model_with_the_body_welded_on() -> None:
    solution, robot = _solution(), _empty().robot
    assert solution.converged
    model = pin.Model(robot.model)
    frame = model.frames[model.getFrameId("tool0")]
    model.appendBodyToJoint(frame.parentJoint, pin.Inertia(MASS, CENTRE, INERTIA), frame.placement)
    data = model.createData()
    for row in np.flatnonzero(solution.collocation):
        torque = pin.rnea(model, data, solution.q[row], solution.v[row], solution.a[row])
        np.testing.assert_allclose(torque, solution.tau[row], atol=ROUNDING)


def test_file_is_consistent() -> None:
    report = trajopt.check(_solution())
    assert report.actuated_residual is not None
    assert report.actuated_residual < RESIDUAL
    assert report.inactive_force is not None
    assert report.inactive_force < RESIDUAL
    assert report.open_loop_joints < OPEN_LOOP
    assert report.within(AT_POINTS)


def test_forgetting_the_payload_is_found() -> None:
    solution = _solution()
    report = trajopt.check(solution.with_description(payloads=()))
    assert report.actuated_residual is not None
    assert report.actuated_residual > 0.01
    assert report.open_loop_joints > 10 * OPEN_LOOP
    assert not report.within(AT_POINTS)


def test_the_holding_contact_has_no_force() -> None:
    solution = _solution()
    assert not solution.active.any()
    assert not solution.f.any()


def test_the_robots_own_model_with_the_wrench_of_the_body_gives_the_torques() -> None:
    solution = _solution()
    model, data = solution.model, solution.model.createData()
    frame, wrenches = model.getFrameId("tool0"), payload_wrenches(solution)[:, 0]
    for row in np.flatnonzero(solution.collocation):
        pin.computeJointJacobians(model, data, solution.q[row])
        jacobian = pin.computeFrameJacobian(model, data, solution.q[row], frame, pin.LOCAL_WORLD_ALIGNED)
        own = pin.rnea(model, data, solution.q[row], solution.v[row], solution.a[row])
        np.testing.assert_allclose(own - jacobian.T @ wrenches[row], solution.tau[row], atol=ROUNDING)


def test_earlier_files_with_the_wrench_as_a_force_are_read_without_it(tmp_path: Path) -> None:
    solution = _solution()
    earlier = replace(solution, f=payload_wrenches(solution)).save(tmp_path / "earlier.npz")
    read = trajopt.Solution.load(earlier)
    assert not read.f.any()
    assert trajopt.check(read).to_dict() == trajopt.check(solution).to_dict()


def test_wrench_of_a_body_at_rest_is_its_weight() -> None:
    robot = _empty().robot
    still = np.zeros(robot.nv)
    wrench = payload_wrench(
        robot.model, robot.model.createData(), "tool0", _payload().spatial, (robot.reference, still, still)
    )
    np.testing.assert_allclose(wrench[:3], [0, 0, -MASS * 9.81], atol=1e-9)
    data = robot.model.createData()
    pin.framesForwardKinematics(robot.model, data, robot.reference)
    lever = data.oMf[robot.model.getFrameId("tool0")].rotation @ CENTRE
    np.testing.assert_allclose(wrench[3:], np.cross(lever, wrench[:3]), atol=1e-9)


def test_loaded_robot_weighs_more_and_keeps_its_limits() -> None:
    robot = _empty().robot
    heavy = loaded(robot, _payload())
    assert heavy.mass == pytest.approx(robot.mass + MASS)
    np.testing.assert_array_equal(heavy.torque_limit, robot.torque_limit)


@pytest.mark.parametrize(
    ("given", "says"),
    [
        ({"mass": -1.0}, "mass"),
        ({"mass": float("nan")}, "mass"),
        ({"mass": "heavy"}, "mass"),
        ({"mass": 1.0, "centre": [0, 0]}, "centre"),
        ({"mass": 1.0, "inertia": -np.eye(3)}, "inertia"),
        ({"mass": 1.0, "inertia": np.diag([1.0, 0.1, 0.1])}, "moments"),
    ],
)
def test_invalid_payloads_are_refused(given: dict[str, object], says: str) -> None:
    with pytest.raises(InputError, match=says):
        Payload(contact="tool", **given)


def test_payloads_that_do_not_fit_the_problem_are_refused() -> None:
    problem = _empty()
    with pytest.raises(InputError, match="phase 'carry'"):
        replace(problem, payloads={"carry": _payload()})
    name = problem.schedule.phases[0].name
    with pytest.raises(InputError, match="no contact 'hand'"):
        replace(problem, payloads={name: Payload(contact="hand", mass=1.0)})
