"""Joints that follow others, through kinematics, dynamics, solves, files, checks, simulation and control."""

from dataclasses import replace
from functools import lru_cache
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from numpy.testing import assert_allclose

import trajopt
from trajopt import Contact, InputError, Phase, Problem, Robot, Schedule, Solution, terms
from trajopt.errors import UnsupportedJointError
from trajopt.robot import JointForce, MimicJoint, frame_pose, inverse_kinematics
from trajopt_library import problems, robots

RATIO, OFFSET = -0.5, 0.3
# Rows hold to the solver's tolerance, over weight times reach.
SOLVED = 1e-5
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
    problem = Problem(
        name="move",
        robot=robot,
        schedule=Schedule((Phase(name="move", duration=1.0),)),
        terms=(
            *(*terms.effort_costs(), terms.TorqueLimits(), terms.PositionLimits(), terms.VelocityLimits()),
            *(terms.TerminalState(q=end), terms.TerminalRest(q=end)),
        ),
        guess=lambda t: robot.reference + t * (end - robot.reference),
    )
    return trajopt.solve(problem)


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
        assert_allclose(np.delete(force, 4), read.tau[k], atol=SOLVED * 100)


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
