"""Capsules around links: every vertex is inside, little else is."""

import coal
import numpy as np
import pinocchio as pin
import pytest

from trajopt.collision.link_capsules import (
    enclosing_capsule,
    inflated,
    least_circle,
    robot_capsules,
    spanning_points,
)
from trajopt.collision.shapes import LinkShape
from trajopt.errors import InputError
from trajopt.robot.robot import Robot
from trajopt_library import robots

ROUNDING = 1e-9  # m; sums of numbers around one


def vertices(robot: Robot, kind: pin.GeometryType) -> list[tuple[str, int, np.ndarray]]:
    """(link, joint, points (n, 3) in the joint's axes) of every mesh that moves."""
    source = robot.visual
    directories = [str(path) for path in source.package_dirs]
    geometry = pin.buildGeomFromUrdf(robot.model, str(source.urdf), kind, package_dirs=directories)
    found = []
    for entry in geometry.geometryObjects:
        if entry.parentJoint and isinstance(entry.geometry, coal.BVHModelBase):
            link = robot.model.frames[entry.parentFrame].name
            points = [entry.placement.act(point) for point in np.asarray(entry.geometry.vertices())]
            found.append((link, entry.parentJoint, np.array(points)))
    return found


def depth(capsule: LinkShape, frame: pin.SE3, points: np.ndarray) -> np.ndarray:
    """How deep world points (n, 3) lie in a capsule on a frame, m."""
    start, end = (frame.act(end) for end in capsule.axis)
    along = end - start
    share = np.clip((points - start) @ along / max(along @ along, 1e-300), 0, 1)
    return capsule.radius - np.linalg.norm(points - start - share[:, None] * along, axis=1)


MESHES = [
    ("ur5", "collision"),
    ("ur5", "visual"),
    ("panda", "collision"),
    ("kinova", "visual"),
    ("go1", "visual"),
]


@pytest.mark.long
@pytest.mark.parametrize(("name", "source"), MESHES)
def test_every_vertex_of_a_moving_link_is_in_a_capsule_of_it(name, source):
    robot = robots.load(name)
    model, data = robot.model, robot.model.createData()
    capsules = robot_capsules(robot, source=source)
    step = np.random.default_rng(0).uniform(-1, 1, robot.nv)
    pin.framesForwardKinematics(model, data, pin.integrate(model, robot.reference, step))
    frames = {c.name: data.oMf[model.getFrameId(c.frame)] for c in capsules}
    kind = pin.GeometryType.COLLISION if source == "collision" else pin.GeometryType.VISUAL
    for link, joint, points in vertices(robot, kind):
        world = points @ data.oMi[joint].rotation.T + data.oMi[joint].translation
        own = [c for c in capsules if c.name == link or c.name.startswith(f"{link}_")]
        deepest = np.max([depth(c, frames[c.name], world) for c in own], axis=0)
        assert deepest.min() > -ROUNDING, link


def test_capsules_are_the_same_each_time():
    first, second = (robot_capsules(robots.load("ur5")) for _ in range(2))
    assert [c.describe() for c in first] == [c.describe() for c in second]


@pytest.mark.parametrize("turn", [0.0, 0.7])
def test_capsule_around_points_of_a_capsule_is_that_capsule(turn):
    rng = np.random.default_rng(0)
    normal = rng.normal(size=(4000, 3))
    points = 0.1 * normal / np.linalg.norm(normal, axis=1)[:, None]
    points[:, 2] += np.where(points[:, 2] > 0, 0.25, -0.25)
    found = enclosing_capsule(points @ pin.exp3(turn * np.array([0.6, 0.8, 0.0])).T + 0.3)
    assert found.radius == pytest.approx(0.1, rel=0.02)  # as far as 4000 points fill the surface
    assert np.linalg.norm(found.end - found.start) == pytest.approx(0.5, rel=0.02)


def test_capsule_around_a_box_is_no_larger_than_along_its_longest_side():
    corners = np.array(np.meshgrid([-0.3, 0.3], [-0.1, 0.1], [-0.05, 0.05])).reshape(3, -1).T
    radius = np.hypot(0.1, 0.05)
    along = np.pi * radius**2 * (0.6 + 4 / 3 * radius)  # ends at the box's faces
    assert enclosing_capsule(corners).volume <= along


FEW = {
    "one": [[0.2, 0.1, 0.3]],
    "two": [[0, 0, 0], [0, 0, 1]],
    "three": np.eye(3),
    "in line": [[0, 0, 0], [1, 1, 1], [2, 2, 2]],
    "twice": [[0, 0, 0], [0, 0, 0], [1, 0, 0], [1, 0, 0], [0, 1, 0], [0, 1, 0]],
}


@pytest.mark.parametrize("case", FEW)
def test_few_and_flat_points_have_a_capsule(case):
    points = np.array(FEW[case], dtype=float)
    assert enclosing_capsule(points).depth(points).min() > -ROUNDING


@pytest.mark.parametrize("seed", range(5))
def test_least_circle_is_least(seed):
    points = np.random.default_rng(seed).normal(size=(30, 2))
    centre, radius = least_circle(points)
    assert np.linalg.norm(points - centre, axis=1).max() == pytest.approx(radius)
    touching = points[np.linalg.norm(points - centre, axis=1) > radius - ROUNDING] - centre
    angles = np.sort(np.arctan2(touching[:, 1], touching[:, 0]))
    gaps = np.diff([*angles, angles[0] + 2 * np.pi])
    assert gaps.max() <= np.pi + ROUNDING  # no half circle is free: it cannot shrink


@pytest.mark.parametrize(
    ("shape", "volume"),
    [
        (coal.Sphere(0.1), 4 / 3 * np.pi * 1e-3),
        (coal.Capsule(0.1, 0.4), np.pi * 0.01 * (0.4 + 4 / 30)),
    ],
)
def test_round_shapes_are_their_own_capsules(shape, volume):
    points, radius = spanning_points(shape)
    length = np.linalg.norm(points[-1] - points[0])
    assert np.pi * radius**2 * (length + 4 / 3 * radius) == pytest.approx(volume)


def test_capsules_without_geometry_hold_boxes_of_the_inertias():
    robot = robots.load("irb1600")
    assert robot.visual is None
    assert {c.frame for c in robot_capsules(robot)} == set(robot.model.names[1:])


def test_capsules_may_be_given_by_hand():
    robot = robots.load("ur5")
    mine = LinkShape.capsule("mine", "tool0", np.zeros(3), [0, 0, 0.1], 0.02)
    capsules = robot_capsules(robot, override={"ee_link": [mine], "wrist_1_link": []})
    names = {c.name for c in capsules}
    assert mine in capsules
    assert not names & {"ee_link", "wrist_1_link"}
    assert inflated([mine], 0.01)[0].radius == pytest.approx(0.03)
    with pytest.raises(InputError, match=r"elbow.*links: "):
        robot_capsules(robot, override={"elbow": []})
    with pytest.raises(InputError, match="allowed: collision, visual, inertia"):
        robot_capsules(robot, source="mesh")
