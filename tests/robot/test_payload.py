"""Carried bodies, and inputs that make forces: passive joints, thrusters, joints that follow others."""

from dataclasses import replace
from functools import lru_cache, partial
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from numpy.testing import assert_allclose, assert_array_equal

import trajopt
from tests.support.models import placement
from tests.support.problems import one_phase
from tests.support.refusals import refusals
from tests.support.solved_problems import motion
from trajopt import Contact, FlatGround, InputError, Phase, Problem, Robot, Schedule, Solution, terms
from trajopt.certify.report import AT_POINTS, RESIDUAL
from trajopt.errors import UnsupportedJointError
from trajopt.motion.samples import payload_wrenches
from trajopt.robot import (
    Drive,
    JointForce,
    MimicJoint,
    Payload,
    Thruster,
    frame_pose,
    inverse_kinematics,
    robot_file,
)
from trajopt.robot.payload import loaded, payload_wrench
from trajopt.terms import TerminalRest, TerminalState, TorqueLimits, effort_costs
from trajopt_library import problems, robots
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
    lever = placement(robot.model, robot.reference, "tool0").rotation @ CENTRE
    np.testing.assert_allclose(wrench[3:], np.cross(lever, wrench[:3]), atol=1e-9)


def test_loaded_robot_weighs_more_and_keeps_its_limits() -> None:
    robot = _empty().robot
    heavy = loaded(robot, _payload())
    assert heavy.mass == pytest.approx(robot.mass + MASS)
    np.testing.assert_array_equal(heavy.torque_limit, robot.torque_limit)


test_invalid_payloads_are_refused = refusals(
    lambda given: Payload(contact="tool", **given),
    ({"mass": -1.0}, "mass"),
    ({"mass": float("nan")}, "mass"),
    ({"mass": "heavy"}, "mass"),
    ({"mass": 1.0, "centre": [0, 0]}, "centre"),
    ({"mass": 1.0, "inertia": -np.eye(3)}, "inertia"),
    ({"mass": 1.0, "inertia": np.diag([1.0, 0.1, 0.1])}, "moments"),
    ({"mass": 1.0, "radius": 0.1}, "no points"),
    ({"mass": 1.0, "points": np.zeros((0, 3))}, "no points"),
)


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


test_thrusters_that_cannot_be_are_refused_in_one_line = refusals(
    lambda robot, changed: robots.load(robot).with_thrusters(
        [Thruster(**{"name": "u", "frame": "iris__rotor_0", **changed})]
    ),
    ("iris", {"frame": "nowhere"}, "'nowhere', which is unknown; frames of the base: .*iris__rotor_0"),
    ("solo12", {"frame": "FL_FOOT"}, "'FL_FOOT', which is a link that moves against the base"),
    ("ur5", {"frame": "tool0"}, "on a fixed base; allowed: base 'freeflyer' or 'planar'"),
    ("solo12", {"frame": "base_link", "name": "FL_HFE"}, "two inputs named 'FL_HFE'"),
    ("iris", {"axis": (0.0, 0.0, 0.0)}, "allowed: a direction"),
    ("iris", {"least": 2.0, "most": 1.0}, "least of thruster 'u' is 2 N; at most 1"),
    ("iris", {"most": -1.0}, "most"),
    ("iris", {"drag": float("nan")}, "drag"),
)


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
    goal = *effort_costs(), TorqueLimits(), TerminalState(q=end), TerminalRest(q=end)
    guess = partial(pin.interpolate, robot.model, robot.reference, end)
    return trajopt.solve(one_phase(robot, *goal, guess=guess))


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


RATIO, OFFSET = -0.5, 0.3
# Rows hold to the solver's tolerance, over weight times reach.
MIMICS_SOLVED = 1e-5
COUPLED = """<mujoco><compiler angle="radian"/><worldbody><body>
<joint name="a" axis="0 1 0" range="-2 2" damping="2"/>
<geom size="0.05" fromto="0 0 0 0.3 0 0" type="capsule"/><body pos="0.3 0 0">
<joint name="b" axis="0 1 0" ref="0.1"/>
<geom size="0.05" fromto="0 0 0 0.3 0 0" type="capsule"/><body pos="0.3 0 0"><joint name="c" axis="0 1 0"/>
<geom size="0.05" fromto="0 0 0 0.2 0 0" type="capsule"/></body></body></body></worldbody>
<actuator><motor joint="a" ctrllimited="true" ctrlrange="-90 90"/>{motors}</actuator>
<equality><joint joint1="b" joint2="a" polycoef="0.2 0.5 0 0 0"/><joint joint1="c" joint2="b"/></equality>
</mujoco>"""


def coupled() -> Robot:
    """A UR5 whose second wrist follows the first."""
    rule = MimicJoint(joint="wrist_2_joint", mimics="wrist_1_joint", ratio=RATIO, offset=OFFSET)
    return robots.load("ur5").with_mimics([rule])


@lru_cache
def moved() -> Solution:
    robot = coupled()
    end = robot.reference.copy()
    end[[0, 2, 3]] += [0.5, 0.3, 0.4]
    end[4] = RATIO * end[3] + OFFSET
    limits = terms.TorqueLimits(), terms.PositionLimits(), terms.VelocityLimits()
    goal = *terms.effort_costs(), *limits, terms.TerminalState(q=end), terms.TerminalRest(q=end)
    guess = partial(pin.interpolate, robot.model, robot.reference, end)
    return trajopt.solve(one_phase(robot, *goal, guess=guess))


def test_a_pair_has_one_motor_and_the_limits_of_both() -> None:
    ur5, robot = robots.load("ur5"), coupled()
    assert (robot.nv, robot.nu) == (6, 5)
    assert_allclose(robot.torque_limit, np.delete(ur5.torque_limit, 4))
    assert robot.velocity_limit[3] == min(ur5.velocity_limit[3], ur5.velocity_limit[4] / abs(RATIO))
    assert robot.reference[4] == RATIO * robot.reference[3] + OFFSET
    assert robot.with_locked(["wrist_1_joint"]).nv == 4
    assert robot.with_locked(["wrist_2_joint"]).nu == 5


def test_independent_rates_split_forces_by_virtual_work() -> None:
    actuation, random = coupled().actuation, np.random.default_rng(0)
    rates, force = random.normal(size=5), random.normal(size=6)
    v = actuation.independent @ rates
    assert_allclose(actuation.coupling @ v, 0.0, atol=1e-12)
    assert actuation.rates(v) @ actuation.inputs(force) == pytest.approx(force @ v)
    assert actuation.balanced(force).size == 0
    made = actuation.force(random.normal(size=5))
    assert_allclose(actuation.residual_force(made, actuation.inputs(made)), 0.0, atol=1e-12)


def test_a_motion_is_solved_saved_checked_and_follows_at_any_time(tmp_path: Path) -> None:
    solution = moved()
    assert solution.success, solution.statistics.failures
    read = Solution.load(solution.save(tmp_path / "move.npz"))
    assert read.description.mimics == coupled().mimics
    report = trajopt.check(read)
    assert report.ok, report.failures()
    dense = read.sample(times=np.linspace(0.0, 1.0, 101))
    assert_allclose(dense.q[:, 4], RATIO * dense.q[:, 3] + OFFSET, atol=1e-9)
    model, data = read.model, read.model.createData()
    for k in np.flatnonzero(read.collocation):
        force = pin.rnea(model, data, read.q[k], read.v[k], read.a[k])
        force[3] += RATIO * force[4]
        assert_allclose(np.delete(force, 4), read.tau[k], atol=MIMICS_SOLVED * 100)


def test_what_drifts_apart_is_found_by_the_check() -> None:
    solution = moved()
    q = solution.q.copy()
    q[:, 4] += 0.01 * np.sin(np.pi * solution.t)
    assert "following_error" in trajopt.check(replace(solution, q=q)).failures()


@pytest.mark.long
def test_it_holds_in_mujoco_with_both_controllers() -> None:
    pytest.importorskip("mujoco")
    for controller in ("joints", "whole-body"):
        report = trajopt.simulate(moved(), controller=controller).report
        assert report.passed, report.failures


def test_inverse_kinematics_moves_both() -> None:
    robot = coupled()
    target = frame_pose(robot, robot.reference, "tool0").translation + np.array([0.05, 0.1, 0.05])
    found = inverse_kinematics(robot, robot.reference, {"tool0": target})
    assert found.error < 1e-8
    assert found.q[4] == pytest.approx(RATIO * found.q[3] + OFFSET)


@pytest.mark.parametrize(
    ("rules", "error", "message"),
    [
        ([("wrist_2_joint", "thumb")], InputError, "'thumb' of a mimic joint is unknown"),
        ([("wrist_2_joint", "wrist_2_joint")], InputError, "allowed: each joint once, after one"),
        (
            [("wrist_2_joint", "wrist_1_joint"), ("wrist_3_joint", "wrist_2_joint")],
            InputError,
            "'wrist_3_joint' of robot 'ur5' mimics 'wrist_2_joint'",
        ),
    ],
)
def test_pairs_that_cannot_be_are_refused(rules, error, message) -> None:
    with pytest.raises(error, match=message):
        robots.load("ur5").with_mimics([MimicJoint(joint=one, mimics=two) for one, two in rules])
    with pytest.raises(UnsupportedJointError, match="mimic joints of one coordinate"):
        robots.load("double_pendulum").with_mimics([MimicJoint(joint="joint2", mimics="joint1")])


def test_a_start_with_joints_apart_and_an_impact_are_refused() -> None:
    robot, solo = coupled(), robots.load("solo12")
    still = Schedule((Phase(name="move", duration=1.0),))
    with pytest.raises(InputError, match="has joints apart that follow others"):
        Problem(name="p", robot=robot, schedule=still, terms=(), initial_q=robot.reference + 0.1)
    pair = MimicJoint(joint="FR_HAA", mimics="FL_HAA", ratio=-1.0)
    jump = problems.load("solo12-jump", touchdown="impact")
    with pytest.raises(InputError, match="a phase begins with an impact"):
        replace(jump, robot=solo.with_mimics([pair]))


@pytest.mark.long
def test_legs_that_follow_each_other_jump_and_keep_their_feet() -> None:
    """Solo12 with hips that open together: contacts and couplings hold at once."""
    jump = problems.load("solo12-jump")
    pairs = [MimicJoint(joint=f"{end}R_HAA", mimics=f"{end}L_HAA", ratio=-1.0) for end in "FH"]
    robot = jump.robot.with_mimics(pairs).with_joint_forces([JointForce(joint="FL_KFE", damping=0.01)])
    solution = trajopt.solve(replace(jump, robot=robot))
    assert solution.success, solution.statistics.failures
    assert (robot.nu, solution.tau.shape[1]) == (10, 10)
    report = trajopt.check(solution)
    assert report.ok, report.failures()
    names = list(solution.position_names)
    left, right = (solution.q[:, names.index(f"F{side}_HAA")] for side in "LR")
    assert_allclose(right, -left, atol=1e-9)


@pytest.mark.parametrize("both", [False, True])
def test_a_joint_equality_of_an_mjcf_file_is_followed(both: bool, tmp_path: Path) -> None:
    mujoco = pytest.importorskip("mujoco")
    path = tmp_path / "coupled.xml"
    motors = '<motor joint="b" ctrllimited="true" ctrlrange="-9 9"/>' if both else ""
    path.write_text(COUPLED.format(motors=motors), encoding="utf-8")
    robot = Robot.from_mjcf(path)
    # MuJoCo counts from its reference: b - 0.1 = 0.2 + 0.5 a, and c = b - 0.1.
    assert [(m.joint, m.mimics, m.ratio) for m in robot.mimics] == [("b", "a", 0.5), ("c", "a", 0.5)]
    assert_allclose([m.offset for m in robot.mimics], [0.3, 0.2])
    assert robot.nu == (2 if both else 1)
    model = mujoco.MjModel.from_xml_path(str(path))
    data = mujoco.MjData(model)
    for _ in range(4000):
        mujoco.mj_step(model, data)
    a, b, c = data.qpos
    assert b == pytest.approx(0.5 * a + 0.3, abs=1e-2)
    assert c == pytest.approx(0.5 * a + 0.2, abs=1e-2)


def test_thrusters_contacts_and_followers_keep_their_places() -> None:
    robot = coupled()
    with_foot = Robot.from_model(robot.model, contacts=[Contact(frame="tool0")]).with_mimics(robot.mimics)
    assert with_foot.actuation.inverse.shape == (5, 6)
    assert with_foot.with_mimics([]).nu == 5


def test_a_joint_with_a_motor_leads_in_an_equality_of_an_mjcf_file(tmp_path):
    joints = "".join(
        f'<body name="b{n}" pos="{n} 0 0"><joint name="j{n}" axis="0 1 0"/><geom size="0.1" mass="1"/></body>'
        for n in (1, 2)
    )
    rule = '<equality><joint joint1="j1" joint2="j2" polycoef="0.1 2 0 0 0"/></equality>'
    path = tmp_path / "pair.xml"
    path.write_text(
        f'<mujoco><worldbody>{joints}</worldbody>{rule}<actuator><motor joint="j1"/></actuator></mujoco>',
        encoding="utf-8",
    )
    robot = Robot.from_mjcf(path)
    assert robot.mimics == (MimicJoint(joint="j2", mimics="j1", ratio=0.5, offset=-0.05),)
    assert (robot.nu, robot.passive) == (1, ("j2",))


def test_only_a_joint_that_follows_and_has_a_motor_can_be_driven_beside():
    robot = robots.load("panda")
    leader, follower = list(robot.model.names)[1:3]
    pair = MimicJoint(joint=follower, mimics=leader)
    for name in ("nonsense", leader):
        with pytest.raises(InputError, match=f"driven joint '{name}' follows no other"):
            robot.with_mimics([pair], driven=[name])
    passive = robot.with_mimics([pair])
    with pytest.raises(InputError, match=f"driven joint '{follower}' is passive"):
        passive.with_mimics([pair], driven=[follower])
