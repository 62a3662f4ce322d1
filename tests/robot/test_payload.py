"""Carried bodies, and inputs that make forces: passive joints, thrusters."""

from dataclasses import replace
from functools import lru_cache
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from numpy.testing import assert_allclose, assert_array_equal

import trajopt
from tests.support.refusals import refused
from tests.support.solved_problems import motion
from trajopt.certify.report import AT_POINTS, RESIDUAL
from trajopt.errors import InputError
from trajopt.motion.samples import payload_wrenches
from trajopt.motion.solution import Solution
from trajopt.problem.problem import Problem
from trajopt.robot import Drive, Robot, Thruster, robot_file
from trajopt.robot.contact import Contact
from trajopt.robot.payload import Payload, loaded, payload_wrench
from trajopt.schedule import Phase, Schedule
from trajopt.terms import TerminalRest, TerminalState, TorqueLimits, effort_costs
from trajopt.terrain.flat import FlatGround
from trajopt_library import robots
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


INPUT_ROUNDING = 1e-12
# Rows of the dynamics hold to the solver's tolerance, over weight.
SOLVED = 1e-6


def hexarotor() -> Robot:
    """Borinot with its arm of two joints and six tilted rotors: more inputs than its base has rows."""
    body = Robot.from_urdf(robot_file("borinot_description/urdf/borinot_flying_arm_2.urdf"))
    model = body.model
    for k, angle in enumerate(np.arange(6) * np.pi / 3):
        tilt = pin.rpy.rpyToMatrix(0.0, 0.0, angle) @ pin.rpy.rpyToMatrix((-1) ** k * 0.3, 0.0, 0.0)
        place = pin.SE3(tilt, 0.2 * np.array([np.cos(angle), np.sin(angle), 0.0]))
        model.addFrame(pin.Frame(f"rotor{k}", 1, 0, place, pin.FrameType.OP_FRAME))
    robot = Robot.from_model(model, name="hexarotor", reference=pin.neutral(model))
    return robot.with_thrusters(
        [Thruster(name=f"u{k}", frame=f"rotor{k}", drag=(-1) ** k * 0.02, most=15.0) for k in range(6)]
    )


def test_the_force_of_a_thruster_is_that_of_its_wrench_at_any_configuration() -> None:
    robot = robots.load("iris")
    random = np.random.default_rng(0)
    data = robot.model.createData()
    for _ in range(5):
        q = pin.randomConfiguration(robot.model, -np.ones(7), np.ones(7))
        thrust = random.uniform(0.0, 7.0, 4)
        needed = np.zeros(6)
        for u, thruster in zip(thrust, robot.thrusters, strict=True):
            frame = robot.model.getFrameId(thruster.frame)
            jacobian = pin.computeFrameJacobian(robot.model, data, q, frame, pin.LOCAL_WORLD_ALIGNED)
            axis = data.oMf[frame].rotation @ np.array(thruster.axis)
            needed += jacobian.T @ np.concatenate([u * axis, thruster.drag * u * axis])
        assert_allclose(robot.actuation.force(thrust), needed, atol=1e-9)


@pytest.mark.parametrize("build", [hexarotor, lambda: robots.load("iris"), lambda: robots.load("cart_pole")])
def test_inputs_and_balance_split_every_force(build) -> None:
    actuation, random = build().actuation, np.random.default_rng(1)
    nv, nu = actuation.matrix.shape
    inputs, force = random.normal(size=nu), random.normal(size=(3, nv))
    assert_allclose(actuation.balanced(actuation.force(inputs)), 0.0, atol=INPUT_ROUNDING)
    assert_allclose(actuation.force(inputs), actuation.matrix @ inputs, atol=INPUT_ROUNDING)
    assert_allclose(actuation.rates(force), force @ actuation.matrix, atol=INPUT_ROUNDING)
    made = actuation.force(actuation.inputs(actuation.force(random.normal(size=nu))))
    assert_allclose(actuation.balanced(made), 0.0, atol=INPUT_ROUNDING)
    reached = actuation.force(random.normal(size=nu))
    assert_allclose(actuation.force(actuation.inputs(reached)), reached, atol=1e-10)
    assert len(actuation.balance) == nv - np.linalg.matrix_rank(actuation.matrix)


def test_more_inputs_than_rows_share_a_force_with_the_least_norm() -> None:
    robot = hexarotor()
    assert (robot.nv, robot.nu) == (8, 8)
    force = robot.actuation.force(np.full(8, 1.0))
    assert np.linalg.norm(robot.actuation.inputs(force)) <= np.sqrt(8) + INPUT_ROUNDING


@pytest.mark.parametrize(
    ("robot", "changed", "message"),
    [
        ("iris", {"frame": "nowhere"}, "'nowhere', which is unknown; frames of the base: .*iris__rotor_0"),
        ("solo12", {"frame": "FL_FOOT"}, "'FL_FOOT', which is a link that moves against the base"),
        ("ur5", {"frame": "tool0"}, "on a fixed base; allowed: base 'freeflyer' or 'planar'"),
        ("solo12", {"frame": "base_link", "name": "FL_HFE"}, "two inputs named 'FL_HFE'"),
        ("iris", {"axis": (0.0, 0.0, 0.0)}, "allowed: a direction"),
        ("iris", {"least": 2.0, "most": 1.0}, "least of thruster 'u' is 2 N; at most 1"),
        ("iris", {"most": -1.0}, "most"),
        ("iris", {"drag": float("nan")}, "drag"),
    ],
)
def test_thrusters_that_cannot_be_are_refused_in_one_line(robot, changed, message) -> None:
    with refused(message):
        robots.load(robot).with_thrusters([Thruster(**{"name": "u", "frame": "iris__rotor_0", **changed})])


def test_joints_keep_their_limits_and_drives_beside_thrusters() -> None:
    robot = robots.load("solo12")
    drive = Drive(gear_ratio=9.0, torque_limit=0.3)
    driven = robot.with_drives({"FL_KFE": drive})
    flying = driven.with_thrusters([Thruster(name="jet", frame="base_link", least=1.0, most=9.0)])
    assert flying.nu == 13
    assert flying.drives[-1] is None
    assert_array_equal(flying.torque_limit[:12], driven.torque_limit)
    assert_array_equal(flying.least_torque(flying.torque_limit)[-1:], [1.0])
    assert flying.with_drives({"FL_KFE": None}).drives == (None,) * 13
    locked = flying.with_locked(["FL_KFE"])
    assert (locked.nu, locked.thrusters, locked.torque_limit[-1]) == (12, flying.thrusters, 9.0)
    assert flying.with_thrusters([]).nu == 12


def flight(robot: Robot) -> Solution:
    """A step of 0.5 m aside, from rest to rest, with both joints of the arm turned."""
    end = robot.reference.copy()
    end[:3] += [0.5, 0.2, 0.3]
    end[7:] += 0.5
    problem = Problem(
        name="step",
        robot=robot,
        schedule=Schedule((Phase(name="fly", duration=1.0),)),
        initial_q=robot.reference,
        initial_v=np.zeros(robot.nv),
        terms=(*effort_costs(), TorqueLimits(), TerminalState(q=end), TerminalRest(q=end)),
        guess=lambda t: pin.interpolate(robot.model, robot.reference, end, t),
    )
    return trajopt.solve(problem)


@pytest.mark.long
def test_a_flying_arm_with_more_inputs_than_rows_is_solved_saved_and_checked(tmp_path) -> None:
    robot = hexarotor()
    solution = flight(robot)
    assert solution.success, solution.statistics.failures
    read = Solution.load(solution.save(tmp_path / "flight.npz"))
    assert read.torque_names[-6:] == tuple(f"u{k}" for k in range(6))
    assert read.description.thrusters == robot.thrusters
    data, weight = robot.model.createData(), robot.weight
    for k in np.flatnonzero(read.collocation):
        needed = pin.rnea(robot.model, data, read.q[k], read.v[k], read.a[k])
        assert_allclose(needed, robot.actuation.matrix @ read.tau[k], atol=SOLVED * weight)
        assert read.tau[k, 2:].min() >= -SOLVED * weight
        assert read.tau[k, 2:].max() <= 15.0 + SOLVED * weight
    assert trajopt.check(read).ok


def test_torques_below_the_least_of_a_thruster_are_found_by_the_check() -> None:
    solution = motion("quadrotor-flip")
    assert trajopt.check(solution).ok
    hovering = solution.with_description(
        thrusters=tuple(
            Thruster(**{**vars(thruster), "least": 1.0}) for thruster in solution.description.thrusters
        )
    )
    assert any("effort" in failure for failure in trajopt.check(hovering).failures())
