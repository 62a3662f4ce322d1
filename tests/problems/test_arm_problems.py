"""Families for any arm: goals reached, limits that bind, a tool that slides with Coulomb's friction."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

import trajopt
from tests.support.refusals import refused
from trajopt.certify.report import AT_POINTS
from trajopt.errors import InputError
from trajopt.robot.kinematics import frame_pose
from trajopt_library.problems import arm_reach, arm_transfer, arm_wipe, arms
from trajopt_library.problems.arm_wipe import Stroke

# Rows of a solved problem hold to 1e-6 of the reach.
PLACE = 1e-5  # m
TURN = 1e-5  # rad
# The stroke's place follows from its acceleration by a scheme of fourth order over 40 intervals.
ON_STROKE = 1e-4  # m
# Collocation leaves a velocity within the plane at the end, of the same order.
AT_REST = 1e-3  # m/s
# Step of central differences, and what they leave of a second derivative of order 1.
STEP, DIFFERENCE = 1e-4, 1e-5


def solve(family, **values):
    problem = family.load(values)
    solution = trajopt.solve(problem, fixed_mesh=True)
    assert solution.converged
    assert trajopt.check(solution).within(AT_POINTS)
    return problem, solution


@pytest.mark.parametrize("name", arms.ARMS)
def test_a_pose_of_the_tool_is_its_reference_turned_and_moved(name):
    arm = arms.load(name)
    turn, out, up = 0.7, -0.05, 0.1
    pose, reference = arm.pose(turn, out, up), arm.at_reference
    about = pin.rpy.rpyToMatrix(0.0, 0.0, turn)
    np.testing.assert_allclose(pose.rotation, about @ reference.rotation, atol=1e-12)
    assert pose.translation[2] - reference.translation[2] == pytest.approx(up * arm.robot.length)
    np.testing.assert_allclose(arm.cylinder(pose.translation), (turn, out, up), atol=1e-12)


@pytest.mark.parametrize("name", arms.ARMS)
def test_the_tool_points_out_of_the_arm(name):
    arm = arms.load(name)
    outward, robot = arm.at_reference.rotation @ arm.outward, arm.robot
    data = robot.model.createData()
    pin.forwardKinematics(robot.model, data, robot.reference)
    wrist = data.oMi[robot.model.njoints - 3].translation
    assert np.linalg.norm(outward) == pytest.approx(1.0)
    assert outward @ (arm.at_reference.translation - wrist) > 0


@pytest.mark.parametrize("name", arms.ARMS)
@pytest.mark.parametrize("module", [arm_reach, arm_transfer, arm_wipe])
def test_families_build_on_every_arm_with_a_guess_within_the_limits(name, module):
    problem = module.FAMILY.load({"robot": name})
    robot, duration = problem.robot, problem.schedule.duration
    assert problem.parameters["robot"] == name
    for t in np.linspace(0.0, duration, 9):
        q = problem.guess(t)
        assert pin.isNormalized(robot.model, q, 1e-9)
        assert (q >= robot.position_lower - 1e-9).all()
        assert (q <= robot.position_upper + 1e-9).all()
    np.testing.assert_allclose(problem.guess(0.0), problem.initial_q, atol=1e-12)


def test_a_reach_ends_at_rest_at_its_pose():
    problem, solution = solve(arm_reach.FAMILY, robot="ur5", x=0.3, y=0.4, roll=0.3)
    arm = arms.load("ur5")
    pose = frame_pose(problem.robot, solution.q[-1], arm.tool)
    where = arm.cylinder(pose.translation)
    goal = pin.rpy.rpyToMatrix(0.3, 0.0, 0.0) @ arm.pose(*where).rotation
    np.testing.assert_allclose(pose.translation[:2], (0.3, 0.4), atol=PLACE)
    default = arm.pose(arm_reach.TURN, 0.0, arm_reach.UP).translation
    assert pose.translation[2] == pytest.approx(default[2], abs=PLACE)
    assert np.linalg.norm(pin.log3(goal.T @ pose.rotation)) < TURN
    np.testing.assert_allclose(solution.v[-1], 0.0, atol=TURN)


def test_the_fastest_transfer_binds_limits_and_beats_its_guess():
    problem, solution = solve(arm_transfer.FAMILY, robot="ur5")
    robot, points = problem.robot, solution.collocation
    assert solution.t[-1] < problem.schedule.duration
    used = np.maximum(
        np.abs(solution.tau[points] / robot.torque_limit).max(axis=1),
        np.abs(solution.v[points] / robot.velocity_limit).max(axis=1),
    )
    assert np.mean(used > 0.99) > 0.9  # of the motion some limit binds


@pytest.mark.long
def test_a_slower_transfer_needs_less_torque_than_the_fastest():
    _, fast = solve(arm_transfer.FAMILY, robot="ur5")
    _, slow = solve(arm_transfer.FAMILY, robot="ur5", goal="effort")
    squares = [np.mean(s.tau[s.collocation] ** 2) for s in (fast, slow)]
    assert squares[1] < squares[0]


@pytest.mark.parametrize("shape", ["line", "circle"])
def test_a_stroke_moves_as_its_acceleration_says(shape):
    stroke = Stroke(
        shape=shape,
        size=0.4,
        centre=np.array([0.5, 0.1, 0.2]),
        across=np.array([0.0, 1.0, 0.0]),
        along=np.array([0.6, 0.0, 0.8]),
    )
    duration = 1.7

    def place(t: float) -> np.ndarray:
        s = t / duration
        return stroke(10 * s**3 - 15 * s**4 + 6 * s**5)

    for t in np.linspace(0.1, 1.6, 7):
        second = (place(t + STEP) - 2 * place(t) + place(t - STEP)) / STEP**2
        np.testing.assert_allclose(stroke.acceleration(t, duration), second, atol=DIFFERENCE)


@pytest.mark.parametrize("shape", ["line", "circle"])
def test_a_wiping_tool_follows_its_stroke_with_the_force_and_friction_asked_for(shape):
    force, friction = 30.0, 0.4
    problem, solution = solve(
        arm_wipe.FAMILY, robot="ur5", shape=shape, force=force, friction=friction, tilt=0.3, out=0.1
    )
    robot, surface = problem.robot, problem.schedule.phases[0].surfaces[arm_wipe.TOOL]
    frame, data = robot.model.getFrameId(arms.load("ur5").tool), robot.model.createData()
    length = math.pi * problem.parameters["size"] if shape == "circle" else problem.parameters["size"]
    travelled, last = 0.0, None
    for row in range(solution.n_samples):
        pin.forwardKinematics(robot.model, data, solution.q[row], solution.v[row])
        place = pin.updateFramePlacement(robot.model, data, frame).translation.copy()
        assert abs(surface.distance(place)) < ON_STROKE
        travelled += 0.0 if last is None else float(np.linalg.norm(place - last))
        last = place
        if solution.collocation[row]:
            velocity = pin.getFrameVelocity(robot.model, data, frame, pin.LOCAL_WORLD_ALIGNED).linear
            along = velocity - (surface.normal @ velocity) * surface.normal
            wanted = force * (
                surface.normal - friction * along / np.sqrt(along @ along + surface.slip_speed**2)
            )
            np.testing.assert_allclose(solution.f[row, 0, :3], wanted, atol=1e-5 * robot.weight)
    assert travelled == pytest.approx(length, rel=1e-2)  # samples are chords of a circle
    end = pin.getFrameVelocity(robot.model, data, frame, pin.LOCAL_WORLD_ALIGNED).linear
    assert np.linalg.norm(end) < AT_REST


def test_the_check_notices_friction_along_the_sliding():
    _, solution = solve(arm_wipe.FAMILY, robot="ur5")
    assert trajopt.check(solution).sliding_friction < 1e-6
    turned = solution.f.copy()
    turned[:, 0, :2] *= -1.0
    report = trajopt.check(replace(solution, f=turned))
    assert "sliding_friction" in report.failures(AT_POINTS)


@pytest.mark.parametrize(
    ("module", "values", "message"),
    [
        (arm_reach, {"robot": "solo12"}, "not an arm"),
        (arm_reach, {"robot": "ur5", "x": 5.0}, "reach"),
        (arm_transfer, {"robot": "ur5", "out": 1.0}, "reach"),
        (arm_transfer, {"robot": "ur5", "turn": 0.0, "out": 0.0, "up": 0.0}, "same posture"),
        (arm_wipe, {"robot": "ur5", "size": 4.0}, "stroke"),
        (arm_wipe, {"robot": "ur5", "shape": "spiral"}, "line"),
    ],
)
def test_what_an_arm_cannot_do_is_refused_in_one_line(module, values, message):
    with refused(message):
        module.FAMILY.load(values)


LINK = (
    '<inertial><mass value="1"/><inertia ixx=".01" ixy="0" ixz="0" iyy=".01" iyz="0" izz=".01"/></inertial>'
)
LIMIT = '<limit lower="-2.5" upper="2.5" effort="80" velocity="3"/>'


@pytest.fixture
def three_joints(tmp_path: Path) -> str:
    """The file of an arm that turns, lifts and bends."""
    axes = enumerate(("0 0 1", "0 1 0", "0 1 0"))
    joints = "".join(
        f'<joint name="j{k}" type="revolute"><parent link="l{k}"/><child link="l{k + 1}"/>'
        f'<origin xyz="0 0 0.3"/><axis xyz="{axis}"/>{LIMIT}</joint>'
        for k, axis in axes
    )
    links = "".join(f'<link name="l{k}">{LINK}</link>' for k in range(4))
    tool = '<link name="tool"/><joint name="end" type="fixed"><parent link="l3"/><child link="tool"/>'
    tool += '<origin xyz="0 0 0.3"/></joint>'
    (tmp_path / "three.urdf").write_text(f'<robot name="three">{links}{joints}{tool}</robot>')
    file = tmp_path / "three.py"
    file.write_text(
        "from pathlib import Path\nfrom trajopt import Robot\nTOOL = 'tool'\ndef build():\n"
        "    file = Path(__file__).parent / 'three.urdf'\n"
        "    return Robot.from_urdf(file, base='fixed', reference={'j1': 0.5, 'j2': 0.8})\n"
    )
    return str(file)


GOAL = {"x": 0.3, "y": 0.2, "z": 0.6}


@pytest.mark.parametrize(
    ("family", "values"),
    [
        ("arm-reach", GOAL),
        ("arm-transfer", {}),
        ("arm-pick-place", {}),
        ("arm-avoid", {}),
        ("arm-wipe", {"tilt": 0.3}),
    ],
)
def test_an_arm_with_few_joints_is_told_that_a_pose_has_six_rows(family, values, three_joints):
    with refused(r"six rows.*'three' 3 joints.*orientation=free"):
        trajopt.load(family, robot=three_joints, **values)


def test_an_arm_with_few_joints_reaches_a_place(three_joints):
    problem, solution = solve(arm_reach.FAMILY, robot=three_joints, orientation="free", **GOAL)
    place = frame_pose(problem.robot, solution.q[-1], "tool").translation
    np.testing.assert_allclose(place, list(GOAL.values()), atol=PLACE)


def test_a_free_orientation_contradicts_a_turn():
    with pytest.raises(InputError, match=r"orientation=free and a turn.*orientation=given"):
        trajopt.load("arm-reach", orientation="free", yaw=0.3)


def test_a_plane_that_faces_sideways_is_one_line(three_joints):
    with pytest.raises(InputError, match=r"faces sideways.*tilt"):
        trajopt.load("arm-wipe", robot=three_joints)
