"""Scenes of links and obstacles: placements, distances by Coal and by fits, and what is refused."""

import coal
import numpy as np
import pinocchio as pin
import pytest

import trajopt
from tests.support.problems import hop
from tests.support.refusals import refused_calls
from tests.support.solved_problems import motion
from trajopt import _numeric
from trajopt.collision import BoxObstacle, CapsuleObstacle, CollisionScene, robot_shapes
from trajopt.collision.coal_shapes import coal_link, coal_obstacle
from trajopt.collision.joint_distance import REACH, STEP, JointDistances
from trajopt.collision.near import separable_pairs
from trajopt.collision.shapes import LinkShape, SphereObstacle, obstacle_from_description
from trajopt.problem.bodies import bodies_of
from trajopt_library import robots

COAL = 1e-6  # m; what Coal's iterations for a box stop at


def by_coal(first: tuple, second: tuple) -> float:
    placed = [(shape, coal.Transform3s(at.rotation, at.translation)) for shape, at in (first, second)]
    return coal.distance(*placed[0], *placed[1], coal.DistanceRequest(), coal.DistanceResult())


TURN = pin.exp3(np.ones(3))


OBSTACLES = (
    BoxObstacle(name="box", sides=[0.2, 0.3, 0.4], position=[0.5, 0.4, 0.2], rotation=TURN),
    CapsuleObstacle(name="post", start=[0.4, -0.4, 0], end=[0.4, -0.4, 0.8], radius=0.05),
    SphereObstacle(name="ball", centre=[-0.5, 0.2, 0.6], radius=0.1),
)


def arm_scene(**changes: object) -> CollisionScene:
    robot = robots.load("ur5")
    given = {"model": robot.model, "shapes": robot_shapes(robot).shapes, "obstacles": OBSTACLES}
    return CollisionScene(**(given | changes))


def test_distances_of_a_scene_are_those_of_its_shapes():
    scene, model = arm_scene(self_pairs=(("shoulder_link", "wrist_3_link"),)), robots.load("ur5").model
    q = robots.load("ur5").reference + np.random.default_rng(4).uniform(-0.3, 0.3, model.nq)
    data = model.createData()
    pin.framesForwardKinematics(model, data, q)
    shapes = {o.name: coal_obstacle(o) for o in scene.obstacles}
    for c in scene.shapes:
        frame = data.oMf[model.getFrameId(c.frame)]
        solid, place = coal_link(c)
        shapes[c.name] = solid, frame * place
    expected = [by_coal(shapes[first], shapes[second]) for first, second in scene.pairs]
    assert scene.distances(q)[0] == pytest.approx(expected, abs=COAL)
    near = [pair for pair, distance in zip(scene.pairs, expected, strict=True) if distance < 0.3]
    assert scene.near([q], 0.3) == tuple(near)
    assert 0 < len(near) < len(scene.pairs)


@pytest.mark.parametrize("name", ["ur5", "panda", "solo12"])
def test_links_that_can_be_kept_apart_are_so_in_the_reference(name):
    robot = robots.load(name)
    shapes = robot_shapes(robot).shapes
    pairs = separable_pairs(robot.model, shapes, robot.reference, 0.01)
    scene = CollisionScene(model=robot.model, shapes=shapes, self_pairs=pairs)
    assert scene.distances(robot.reference).min() > 0.01
    assert pairs


@pytest.mark.parametrize("obstacle", OBSTACLES, ids=lambda o: o.name)
def test_obstacles_survive_their_description(obstacle):
    assert obstacle_from_description(obstacle.describe()).describe() == obstacle.describe()


ZERO, ONE = np.zeros(3), np.ones(3)
NOSE = LinkShape.sphere("c", "nose", ZERO, 1.0)
BALL = SphereObstacle(name="a", centre=ONE, radius=1.0)
test_bad_input_is_refused_in_one_line = refused_calls(
    (lambda: BoxObstacle(name="b", sides=[1, 0, 1], position=ZERO), "sides of obstacle 'b'"),
    (lambda: BoxObstacle(name="b", sides=ONE, position=ZERO, rotation=-np.eye(3)), "not a rotation"),
    (lambda: SphereObstacle(name="s", centre="here", radius=1.0), "centre of SphereObstacle 's'"),
    (lambda: SphereObstacle(name="s", centre=ZERO, radius=0.0), "radius of SphereObstacle 's'"),
    (lambda: CapsuleObstacle(name="c", start=[0, 0, np.nan], end=ZERO, radius=1.0), "start of"),
    (lambda: obstacle_from_description({"kind": "cone"}), "kinds: sphere, capsule, box"),
    (lambda: obstacle_from_description({"kind": "sphere"}), "keys: name, centre, radius"),
    (lambda: LinkShape.from_description({}), "keys: name, frame"),
    (lambda: arm_scene(shapes=[NOSE]), "nose"),
    (lambda: arm_scene(obstacles=[BALL, BALL]), "named a"),
    (lambda: arm_scene(self_pairs=[("ee_link", "ee_link")]), "a pair of shapes"),
)
ROUNDING = 1e-12  # sums of numbers around one
AXIS = np.array([1.0, 2.0, 2.0]) / 3
KINDS = {
    "free": pin.JointModelFreeFlyer(),
    "planar": pin.JointModelPlanar(),
    "spherical": pin.JointModelSpherical(),
    "angles": pin.JointModelSphericalZYX(),
    "translation": pin.JointModelTranslation(),
    "revolute": pin.JointModelRY(),
    "skew": pin.JointModelRevoluteUnaligned(AXIS),
    "continuous": pin.JointModelRUBZ(),
    "prismatic": pin.JointModelPX(),
    "skew prismatic": pin.JointModelPrismaticUnaligned(AXIS),
    "helical": pin.JointModelHelicalUnaligned(AXIS, 0.3),
}


@pytest.mark.parametrize("kind", KINDS)
def test_placements_are_those_of_forward_kinematics(kind):
    model, random = pin.Model(), np.random.default_rng(0)
    first = model.addJoint(0, KINDS[kind], pin.SE3.Random(), "first")
    second = model.addJoint(first, KINDS[kind], pin.SE3.Random(), "second")
    model.addJoint(second, pin.JointModelRX(), pin.SE3.Random(), "third")
    steps = random.uniform(-2, 2, (5, model.nv))
    q = np.array([pin.integrate(model, pin.neutral(model), step) for step in steps])
    frames = [model.addFrame(pin.Frame(f"{j}", j, pin.SE3.Random(), pin.OP_FRAME)) for j in range(1, 4)]
    bodies, ball = _numeric.Bodies(model), coal.Sphere(0.1)
    for frame in (*frames, -1):
        bodies.add(ball, frame, np.eye(3, 4), np.zeros((1, 3)), 0.1, np.zeros((0, 4)))
    found = bodies.placements(q).reshape(len(q), len(frames) + 1, 12)
    data = model.createData()
    for row, configuration in enumerate(q):
        pin.framesForwardKinematics(model, data, configuration)
        places = [*(data.oMf[frame] for frame in frames), pin.SE3.Identity()]
        for body, place in enumerate(places):
            assert found[row, body, :9] == pytest.approx(place.rotation.ravel(), abs=ROUNDING)
            assert found[row, body, 9:] == pytest.approx(place.translation, abs=ROUNDING)


def test_what_is_no_body_is_refused():
    model = pin.buildSampleModelManipulator()
    bodies, place, point, none = _numeric.Bodies(model), np.eye(3, 4), np.zeros((1, 3)), np.zeros((0, 4))
    with pytest.raises(TypeError, match="CollisionGeometry"):
        bodies.add("ball", 1, place, point, 0.1, none)
    with pytest.raises(ValueError, match="frame"):
        bodies.add(coal.Sphere(0.1), model.nframes, place, point, 0.1, none)
    with pytest.raises(ValueError, match="half-space"):
        bodies.add(None, -1, place, point, 0.0, none)
    bodies.add(coal.Sphere(0.1), 1, place, point, 0.1, none)
    for pair in ((0, 1), (-1, 0)):
        with pytest.raises(ValueError, match="pair"):
            bodies.distances(np.zeros((1, model.nq)), [pair], np.array([np.inf]))
    with pytest.raises(ValueError, match="q has"):
        bodies.distances(np.zeros((1, model.nq + 1)), [(0, 0)], np.array([np.inf]))


HIP = ("left_hip_roll_link", "pelvis_contour_link")
# Errors of a fit over its cell, m: hulls of meshes have edges.
ERROR = 1e-3


@pytest.fixture(scope="module")
def scene() -> CollisionScene:
    return bodies_of(trajopt.load("biped-jump-up", robot="g1")).scene


def test_a_row_is_the_distance_where_it_is_laid_and_near_it_around(scene: CollisionScene) -> None:
    fits, generator = JointDistances(scene), np.random.default_rng(0)
    model, column = scene.model, scene.pairs.index(HIP)
    rows = [model.joints[joint].idx_q for joint in fits.joints(HIP)]
    q = np.tile(robots.load("g1").reference, (20, 1))
    q[:, rows] = generator.uniform([-2.0, -0.3], [0.5, 0.5], size=(20, 2))
    parameters = fits.rows(HIP, q, 0.002)
    moved = q.copy()
    moved[:, rows] += generator.uniform(STEP / 2 - REACH, REACH - STEP / 2, size=(20, 2))
    for at, error in ((q, 1e-12), (moved, ERROR)):
        found = fits.values(HIP, at, parameters)
        np.testing.assert_allclose(found, scene.distances(at)[:, column] - 0.002, atol=error)


@pytest.mark.parametrize(
    ("pair", "joints"),
    [
        (HIP, ["left_hip_pitch_joint", "left_hip_roll_joint"]),
        (("left_hip_yaw_link", "right_hip_yaw_link"), []),
        (("left_hip_roll_link", "ground"), []),
    ],
)
def test_few_revolute_joints_lie_between_two_links(
    scene: CollisionScene, pair: tuple[str, str], joints: list[str]
) -> None:
    assert [scene.model.names[joint] for joint in JointDistances(scene).joints(pair)] == joints


def test_links_that_a_slide_moves_are_not_fitted() -> None:
    scene = bodies_of(hop()).scene
    fits = JointDistances(scene)
    for pair in scene.pairs:
        assert all(scene.model.joints[joint].shortname()[-1] in "XYZ" for joint in fits.joints(pair))


@pytest.mark.long
@pytest.mark.slow
def test_near_links_of_a_jump_take_few_iterations() -> None:
    solution = motion("biped-jump-up", robot="g1")
    first, *others = solution.statistics.rounds
    assert solution.success
    assert trajopt.check(solution).ok
    assert sum(each.iterations for each in others) < 5 * first.iterations
