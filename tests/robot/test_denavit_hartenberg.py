"""Arms by Denavit and Hartenberg's parameters: transforms by hand, known arms, dynamics, refusals."""

import itertools
import math
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from numpy.testing import assert_allclose

import trajopt
from tests.support.refusals import refused
from trajopt.errors import InputError
from trajopt.robot import DhJoint, frame_pose, robot_from_dh
from trajopt_library import robots

EXACT = 1e-12
# Parameters of data sheets are rounded to 1e-5 m, those of descriptions to more digits.
DATA_SHEET = 1e-4
RIGHT = math.pi / 2
LINK = {"mass": 1.0, "inertia": 0.01 * np.eye(3)}


def rot(axis: str, angle: float) -> np.ndarray:
    matrix = np.eye(4)
    matrix[:3, :3] = pin.utils.rotate(axis, angle)
    return matrix


def trans(axis: str, way: float) -> np.ndarray:
    matrix = np.eye(4)
    matrix["xyz".index(axis), 3] = way
    return matrix


def by_hand(joints: list[DhJoint], q: np.ndarray, convention: str) -> np.ndarray:
    pose = np.eye(4)
    for joint, value in zip(joints, q, strict=True):
        turns = joint.kind == "revolute"
        about = rot("z", joint.theta + value * turns) @ trans("z", joint.d + value * (not turns))
        along = trans("x", joint.a) @ rot("x", joint.alpha)
        pose = pose @ (about @ along if convention == "standard" else along @ about)
    return pose


@pytest.mark.parametrize("convention", ["standard", "modified"])
@pytest.mark.parametrize("seed", range(5))
def test_links_are_where_the_transforms_put_them(convention: Any, seed: int) -> None:
    random = np.random.default_rng(seed)
    joints = [
        DhJoint(a=a, alpha=alpha, d=d, theta=theta, kind="prismatic" if slides else "revolute", **LINK)
        for (a, alpha, d, theta), slides in zip(
            random.uniform(-2, 2, (6, 4)), random.random(6) < 0.5, strict=True
        )
    ]
    robot = robot_from_dh(joints, convention=convention)
    q = random.uniform(-1, 1, 6)
    for number in range(1, 7):
        expected = by_hand(joints[:number], q[:number], convention)
        assert_allclose(frame_pose(robot, q, f"link{number}").homogeneous, expected, atol=EXACT)


def test_the_ur5_of_its_data_sheet_is_that_of_its_urdf() -> None:
    rows = zip(
        (0.0, -0.425, -0.39225, 0.0, 0.0, 0.0),
        (RIGHT, 0.0, 0.0, RIGHT, -RIGHT, 0.0),
        (0.089159, 0.0, 0.0, 0.10915, 0.09465, 0.0823),
        strict=True,
    )
    arm = robot_from_dh([DhJoint(a=a, alpha=alpha, d=d, **LINK) for a, alpha, d in rows], name="ur5")
    random, known = np.random.default_rng(0), robots.load("ur5")
    moves = []
    for q in random.uniform(-1.0, 1.0, (8, 6)):
        moves.append((frame_pose(arm, q, "link6"), frame_pose(known, q, "wrist_3_link")))
    # The frames differ by a constant at each end: angles and pitches of the screws between them are the same.
    for (first, its), (second, other) in itertools.pairwise(moves):
        screws = [pin.log6(first.actInv(second)).vector, pin.log6(its.actInv(other)).vector]
        angles = [np.linalg.norm(screw[3:]) for screw in screws]
        pitches = [screw[:3] @ screw[3:] for screw in screws]
        assert_allclose(angles[0], angles[1], atol=DATA_SHEET)
        assert_allclose(pitches[0], pitches[1], atol=DATA_SHEET)


def test_the_panda_of_its_data_sheet_is_that_of_its_urdf() -> None:
    rows = zip(
        (0.0, 0.0, 0.0, 0.0825, -0.0825, 0.0, 0.088),
        (0.0, -RIGHT, RIGHT, RIGHT, -RIGHT, RIGHT, RIGHT),
        (0.333, 0.0, 0.316, 0.0, 0.384, 0.0, 0.0),
        strict=True,
    )
    joints = [DhJoint(a=a, alpha=alpha, d=d, **LINK) for a, alpha, d in rows]
    arm, known = robot_from_dh(joints, convention="modified"), robots.load("panda")
    q = np.array([0.1, -0.4, 0.2, -1.5, 0.3, 1.2, -0.6])
    for number in range(1, 8):
        expected = frame_pose(known, np.append(q, np.zeros(known.nq - 7)), f"panda_link{number}")
        assert_allclose(frame_pose(arm, q, f"link{number}").homogeneous, expected.homogeneous, atol=EXACT)


def test_masses_are_in_the_frames_of_their_links() -> None:
    # A pendulum in a vertical plane: the base's axis is turned level by the first, fixed twist.
    length, mass, inertia = 0.8, 2.0, 0.03
    joint = DhJoint(
        a=length,
        alpha=0.0,
        mass=mass,
        centre=(-length / 2, 0.0, 0.0),
        inertia=inertia * np.eye(3),
        armature=0.1,
    )
    robot = robot_from_dh([joint], convention="standard")
    matrix = pin.crba(robot.model, robot.model.createData(), np.zeros(1))
    assert matrix[0, 0] == pytest.approx(inertia + mass * (length / 2) ** 2 + 0.1)


def test_limits_are_the_robots() -> None:
    turns = DhJoint(a=0.5, lower=-1.0, upper=2.0, velocity=3.0, torque=40.0, **LINK)
    slides = DhJoint(kind="prismatic", upper=0.3, **LINK)
    robot = robot_from_dh([turns, slides], name="scara", reference=[0.5, 0.1])
    assert robot.name == "scara"
    assert list(robot.model.names)[1:] == ["joint1", "joint2"]
    assert_allclose(robot.position_lower, [-1.0, -np.inf])
    assert_allclose(robot.position_upper, [2.0, 0.3])
    assert_allclose(robot.velocity_limit, [3.0, np.inf])
    assert robot.torque_limit is not None
    assert_allclose(robot.torque_limit, [40.0, np.inf])
    assert_allclose(robot.reference, [0.5, 0.1])


@pytest.mark.parametrize(
    ("joints", "options", "said"),
    [
        ([], {}, "robot_from_dh has no joints"),
        ([DhJoint()], {}, "has no mass"),
        ([DhJoint(**LINK)], {"convention": "classic"}, "convention of robot_from_dh is 'classic'"),
        (
            [DhJoint(lower=1.0, upper=-1.0, **LINK)],
            {},
            "position limits of joint 'joint1' of 'arm' are empty",
        ),
        (
            [DhJoint(mass=1.0, inertia=-np.eye(3))],
            {},
            "inertia of joint 1 of robot_from_dh is not that of a rigid body",
        ),
        ([3], {}, r"joints\[0\] of robot_from_dh is 3; allowed: a DhJoint"),
    ],
)
def test_what_is_no_arm_is_one_line(joints: list[Any], options: dict[str, Any], said: str) -> None:
    with refused(said):
        robot_from_dh(joints, **options)


def test_wrong_parameters_are_one_line() -> None:
    with pytest.raises(InputError, match=r"alpha of DhJoint is nan"):
        DhJoint(alpha=math.nan)
    with pytest.raises(InputError, match=r"centre of DhJoint"):
        DhJoint(centre=(1.0, 2.0))
    with pytest.raises(InputError, match=r"kind of DhJoint is 'ball'"):
        DhJoint(kind="ball")  # type: ignore[arg-type]


@pytest.mark.long
def test_an_arm_of_parameters_is_solved() -> None:
    rows = ((0.0, RIGHT, 0.3), (0.4, 0.0, 0.0), (0.35, 0.0, 0.0))
    limits = {"lower": -2.5, "upper": 2.5, "velocity": 3.0, "torque": 80.0}
    arm = robot_from_dh(
        [DhJoint(a=a, alpha=alpha, d=d, **LINK, **limits) for a, alpha, d in rows], reference=[0.0, 0.6, -1.0]
    )
    goal = {"x": 0.3, "y": 0.3, "z": 0.5}
    problem = trajopt.load("arm-reach", robot=arm, orientation="free", **goal)
    solution = trajopt.solve(problem)
    assert solution.success
    reached = frame_pose(arm, solution.q[-1], "link3").translation
    assert_allclose(reached, list(goal.values()), atol=1e-5)
