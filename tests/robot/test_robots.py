"""The robots of the package: they stand, their limits and masses make sense, their meshes are found."""

from xml.etree import ElementTree

import coal
import numpy as np
import pinocchio as pin
import pytest
from scipy.spatial import ConvexHull

from tests.support.models import placement
from tests.support.refusals import refused
from trajopt import InputError, Robot
from trajopt.robot import contact_positions, legs_only
from trajopt_library import robots

ROUNDING = 1e-12  # metres, after a few multiplications of numbers near one
# A robot may push off from where it stands only if its legs can lengthen by this part of their length.
LEAST_EXTENSION = 0.1
# A foot is at most this deep in the ground over all leans of the shank, and at most so high over it, m. Go2's
# is no ball.
DEEPEST, HIGHEST = 1e-3, {"go2": 2e-3}
# Postures are written to four digits; a robot on two points or soles stands over their middle to this, m.
MIDDLE = 1e-3
# Descriptions differ from data sheets by batteries, cables and payload mounts.
MASS_SHARE = 0.2

# Published masses in kg. Makers' data sheets: Unitree A1 (12), Go1 (12), Go2 (15, with battery), B1 (50),
# Laikago (24), G1 (35, with battery), Z1 (4.5), Franka Panda (18), Kinova Jaco 2 with two fingers (4.4 and
# 0.6), UFACTORY xArm 7 (13.7), Universal Robots UR5 (18.4), PAL Talos (95), ANYbotics ANYmal C (50).
# ANYmal B: Hutter et al., IROS 2016 (30). HyQ: Semini et al., IMechE I 2011 (about 90). Solo12, Bolt:
# Grimminger et al., RA-L 2020, and the Open Dynamic Robot Initiative (2.5 and 1.3).
PUBLISHED = {
    "a1": 12.0,
    "anymal_b": 30.0,
    "anymal_c": 50.0,
    "b1": 50.0,
    "bolt": 1.3,
    "g1": 35.0,
    "g1_arms": 35.0,
    "go1": 12.0,
    "go2": 15.0,
    "hyq": 90.0,
    "kinova": 5.0,
    "laikago": 24.0,
    "panda": 18.0,
    "solo12": 2.5,
    "talos": 95.0,
    "talos_arms": 95.0,
    "ur5": 18.4,
    "xarm7": 13.7,
    "z1": 4.5,
}

LEGGED = tuple(name for kind in ("quadruped", "biped", "hopper") for name in robots.names(kind))
MASSLESS = ("hip_roll",)  # of the hopper in space: the cross of its hip, with the inertia of a motor
POINT_MASSES = ("swing",)  # of the cart-pole's pole, as in its publication
BUILT_HERE = ("cart_pole", "furuta", "hopper", "hopper_space", "irb1600")  # links without a description file

ONE_LEG = "from trajopt_library.robots.hopper_space import build\n"


def poses(robot: Robot, frames: list[str]) -> list[pin.SE3]:
    return [placement(robot.model, robot.reference, frame) for frame in frames]


def corners(robot: Robot) -> np.ndarray:
    """Points (n, 2) of the ground that the feet touch in the reference, m."""
    found = []
    for name in robots.feet(robot):
        contact = robot.contact(name)
        pose = poses(robot, [contact.frame])[0]
        for x in {-contact.half_length, contact.half_length}:
            for y in {-contact.half_width, contact.half_width}:
                found.append(pose.act(np.array([x, y, 0.0]))[:2])
    return np.array(found)


def centre_of_mass(robot: Robot) -> np.ndarray:
    return pin.centerOfMass(robot.model, robot.model.createData(), robot.reference)


def extension_left(robot: Robot, frame: str) -> float:
    """Part of a leg's length, from its first joint to its foot, by which one joint alone can lengthen it."""
    model, data = robot.model, robot.model.createData()
    foot = model.getFrameId(frame)
    leg = [joint for joint in model.supports[model.frames[foot].parentJoint] if joint > 1]

    def length(q: np.ndarray) -> float:
        pin.framesForwardKinematics(model, data, q)
        return float(np.linalg.norm(data.oMf[foot].translation - data.oMi[leg[0]].translation))

    longest = 0.0
    for index in (model.joints[joint].idx_q for joint in leg[1:]):
        low, high = max(robot.position_lower[index], -np.pi), min(robot.position_upper[index], np.pi)
        for angle in np.linspace(low, high, 200):
            q = robot.reference.copy()
            q[index] = angle
            longest = max(longest, length(q))
    return 1 - length(robot.reference) / longest


@pytest.mark.parametrize("name", LEGGED)
def test_a_legged_robot_stands_with_its_feet_on_level_ground_at_height_zero(name):
    robot = robots.load(name)
    for contact in (robot.contact(foot) for foot in robots.feet(robot)):
        pose = poses(robot, [contact.frame])[0]
        assert pose.translation[2] == pytest.approx(contact.radius, abs=1e-4)
        if contact.kind == "surface":
            np.testing.assert_allclose(pose.rotation[:, 2], [0, 0, 1], atol=1e-4)


@pytest.mark.parametrize("name", [*robots.names("quadruped"), "bolt"])
def test_a_foot_touches_the_ground_with_its_contacts_radius_however_the_shank_leans(name):
    robot = robots.load(name)
    assert robot.visual is not None
    shapes = robot.visual.geometry(robot.model, pin.GeometryType.COLLISION)
    for contact in robot.contacts:
        frame = robot.model.frames[robot.model.getFrameId(contact.frame)]
        joint, centre = int(frame.parentJoint), frame.placement.translation
        down, across = centre / np.linalg.norm(centre), np.array([0.0, 1.0, 0.0])
        for angle in np.radians(np.arange(-40, 41, 10)):
            turn = pin.exp3(angle * across)
            reach = max(
                extent(shape.geometry, shape.placement, turn @ down)
                for shape in shapes.geometryObjects
                if shape.parentJoint == joint
            )
            deep = reach - centre @ turn @ down - contact.radius
            assert -HIGHEST.get(name, 1e-3) < deep < DEEPEST


def extent(shape, placement: pin.SE3, along: np.ndarray) -> float:
    """Greatest component along a direction (3,) of the points of a placed shape, m."""
    local = placement.rotation.T @ along
    if isinstance(shape, coal.Sphere):
        farthest = shape.radius
    elif isinstance(shape, coal.Box):
        farthest = np.abs(local) @ shape.halfSide
    elif isinstance(shape, coal.Cylinder):
        farthest = shape.halfLength * abs(local[2]) + shape.radius * np.hypot(local[0], local[1])
    else:
        farthest = (shape.vertices() @ local).max()
    return float(farthest + placement.translation @ along)


@pytest.mark.parametrize("name", robots.names("quadruped"))
def test_the_centre_of_mass_of_a_quadruped_lies_well_within_its_feet(name):
    robot = robots.load(name)
    hull = ConvexHull(corners(robot))
    inside = -(hull.equations[:, :2] @ centre_of_mass(robot)[:2] + hull.equations[:, 2])
    assert inside.min() > 0.1 * robot.length


@pytest.mark.parametrize("name", ["bolt", "g1", "hopper", "hopper_space"])
def test_the_centre_of_mass_lies_over_the_middle_of_what_stands(name):
    robot = robots.load(name)
    np.testing.assert_allclose(centre_of_mass(robot)[:2], corners(robot).mean(axis=0), atol=MIDDLE)


@pytest.mark.parametrize("name", [name for name in LEGGED if "talos" not in name])  # half sitting: less
def test_legs_can_still_lengthen_from_the_reference(name):
    robot = robots.load(name)
    for foot in robots.feet(robot):
        assert extension_left(robot, robot.contact(foot).frame) > LEAST_EXTENSION


@pytest.mark.parametrize("name", robots.names())
def test_limits_are_positive_and_inertias_of_bodies_that_can_be(name):
    robot = robots.load(name)
    assert robot.torque_limit is not None
    assert (robot.torque_limit > 0).all()
    assert (robot.velocity_limit > 0).all()
    limited = np.isfinite(robot.position_lower)
    assert (robot.position_lower < robot.position_upper)[limited].all()
    for body, inertia in zip(list(robot.model.names)[1:], list(robot.model.inertias)[1:], strict=True):
        if body in (*MASSLESS, *POINT_MASSES):
            continue
        moments = np.linalg.eigvalsh(inertia.inertia)
        assert inertia.mass > 0
        assert moments[0] > 0
        assert moments[2] < (moments[0] + moments[1]) * (1 + 1e-2)  # digits of description files


@pytest.mark.parametrize("name", robots.names("arm"))
def test_motors_hold_an_arm_in_its_reference(name):
    robot = robots.load(name)
    gravity = pin.computeGeneralizedGravity(robot.model, robot.model.createData(), robot.reference)
    assert (np.abs(gravity[robot.n_unactuated :]) < robot.torque_limit).all()


@pytest.mark.parametrize("name", sorted(PUBLISHED))
def test_mass_is_near_the_published_figure(name):
    robot = robots.load(name)
    base = robot.model.inertias[0].mass  # of an arm's base, which does not move
    assert robot.mass + base == pytest.approx(PUBLISHED[name], rel=MASS_SHARE)


@pytest.mark.parametrize("name", [name for name in robots.names() if name not in BUILT_HERE])
def test_meshes_of_a_replay_are_found(name):
    visual = robots.load(name).visual
    meshes = {mesh.get("filename") for mesh in ElementTree.parse(visual.urdf).iterfind(".//visual//mesh")}
    assert meshes
    for mesh in meshes:
        places = [directory / mesh.removeprefix("package://") for directory in visual.package_dirs]
        assert any(place.is_file() for place in places), mesh


def test_the_hopper_in_space_moves_in_the_plane_like_the_planar_one():
    plane, space = robots.load("hopper"), robots.load("hopper_space")
    assert space.mass == plane.mass
    np.testing.assert_allclose(centre_of_mass(space), centre_of_mass(plane), atol=ROUNDING)
    inertias = [
        pin.crba(robot.model, robot.model.createData(), robot.reference)[-2:, -2:] for robot in (plane, space)
    ]
    np.testing.assert_allclose(inertias[1], inertias[0], atol=ROUNDING)


def test_a_pendulum_hangs_and_an_acrobot_has_one_motor():
    pendulum, acrobot = robots.load("double_pendulum"), robots.load("acrobot")
    assert (pendulum.nu, acrobot.nu, acrobot.passive) == (2, 1, ("joint1",))
    for robot in (pendulum, acrobot):
        lowest = centre_of_mass(robot)[2]
        assert all(
            pin.centerOfMass(robot.model, robot.model.createData(), q)[2] >= lowest - 1e-3
            for q in (pin.integrate(robot.model, robot.reference, step) for step in 0.3 * np.eye(2))
        )


def test_a_talos_on_its_legs_has_twelve_joints_and_two_soles():
    talos = robots.load("talos")
    legs = legs_only(talos)
    assert (legs.nu, tuple(contact.name for contact in legs.contacts)) == (12, ("left", "right"))
    assert legs.mass == pytest.approx(talos.mass)
    np.testing.assert_allclose(centre_of_mass(legs), centre_of_mass(talos), atol=ROUNDING)


def test_a_robot_that_is_all_legs_keeps_its_joints():
    robot = robots.load("a1")
    assert legs_only(robot) is robot


@pytest.mark.parametrize("name", robots.names("arm"))
def test_the_tool_of_an_arm_is_a_frame_behind_its_last_joint(name):
    model = robots.load(name).model
    assert model.frames[model.getFrameId(robots.tool_frame(name))].parentJoint == model.njoints - 1


def test_every_robot_has_one_kind():
    found = [name for kind in robots.KINDS for name in robots.names(kind)]
    assert sorted(found) == list(robots.names())
    assert robots.kind("hyq") == "quadruped"


def test_a_robot_may_come_from_a_file(tmp_path):
    path = tmp_path / "mine.py"
    path.write_text(ONE_LEG)
    assert robots.load(str(path)).nu == 3
    assert robots.kind(str(path)) == "hopper"  # it stands on one foot
    arm = tmp_path / "arm.py"
    arm.write_text("from trajopt_library.robots.z1 import build\n")
    assert (robots.kind(str(arm)), robots.tool_frame(str(arm))) == ("arm", "gripperMover")


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("build = 3\n", "has no build"),
        ("def build():\n    return 3\n", "returns int"),
        ("def build():\n    raise ValueError('no such mesh')\n", "no such mesh"),
        ("import there_is_no_such_module\n", "cannot be run"),
        ("KIND = 'snake'\ndef build():\n    pass\n", "snake"),
    ],
)
def test_a_file_that_builds_no_robot_is_refused_in_one_line(tmp_path, content, message):
    path = tmp_path / "wrong.py"
    path.write_text(content)
    with refused(message):
        robots.load(str(path)) if "KIND" not in content else robots.kind(str(path))


def test_unknown_names_kinds_and_tools_are_refused_with_what_is_allowed(tmp_path):
    with pytest.raises(InputError, match="solo12"):
        robots.load("solo13")
    with pytest.raises(InputError, match="does not exist"):
        robots.load(str(tmp_path / "none.py"))
    with pytest.raises(InputError, match="quadruped"):
        robots.names("snake")
    with pytest.raises(InputError, match="panda"):
        robots.tool_frame("a1")


def _turned(angles):
    """Solo12 with joints of its standing posture turned by ``angles`` rad, by name."""
    solo = robots.load("solo12")
    model = solo.model
    standing = {name: solo.reference[model.joints[i].idx_q] for i, name in enumerate(model.names) if i > 1}
    by_name = {name: angle + angles.get(name, 0.0) for name, angle in standing.items()}
    return Robot.from_model(model, base="freeflyer", contacts=solo.contacts, reference=by_name), by_name


def _gaps(robot):
    heights = contact_positions(robot, robot.reference)
    return np.array([heights[contact.name][2] - contact.radius for contact in robot.contacts])


def test_feet_of_a_rounded_posture_are_on_the_ground():
    robot, given = _turned({"FL_HFE": 4e-4, "HR_KFE": -5e-4})
    assert np.abs(_gaps(robot)).max() < 1e-9
    assert np.abs(robot.reference[7:] - list(given.values())).max() < 1e-3


def test_a_raised_foot_stays_raised():
    robot, given = _turned({"FL_KFE": -0.2})
    assert _gaps(robot).max() > 5e-3
    np.testing.assert_allclose(robot.reference[7:], list(given.values()), atol=1e-15)
