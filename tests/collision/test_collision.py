"""Scenes of links and obstacles: their distances by Coal, and what is refused."""

import coal
import numpy as np
import pinocchio as pin
import pytest

from trajopt.collision.coal_shapes import coal_link, coal_obstacle
from trajopt.collision.description import robot_shapes
from trajopt.collision.near import CollisionScene, separable_pairs
from trajopt.collision.shapes import (
    BoxObstacle,
    CapsuleObstacle,
    LinkShape,
    SphereObstacle,
    obstacle_from_description,
)
from trajopt.errors import InputError
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
BAD = {
    "flat box": (lambda: BoxObstacle(name="b", sides=[1, 0, 1], position=ZERO), "sides of obstacle 'b'"),
    "mirrored": (
        lambda: BoxObstacle(name="b", sides=ONE, position=ZERO, rotation=-np.eye(3)),
        "not a rotation",
    ),
    "text": (lambda: SphereObstacle(name="s", centre="here", radius=1.0), "centre of SphereObstacle 's'"),
    "no radius": (lambda: SphereObstacle(name="s", centre=ZERO, radius=0.0), "radius of SphereObstacle 's'"),
    "nan": (lambda: CapsuleObstacle(name="c", start=[0, 0, np.nan], end=ZERO, radius=1.0), "start of"),
    "kind": (lambda: obstacle_from_description({"kind": "cone"}), "kinds: sphere, capsule, box"),
    "keys": (lambda: obstacle_from_description({"kind": "sphere"}), "keys: name, centre, radius"),
    "capsule": (lambda: LinkShape.from_description({}), "keys: name, frame"),
    "frame": (lambda: arm_scene(shapes=[NOSE]), "nose"),
    "two names": (lambda: arm_scene(obstacles=[BALL, BALL]), "named a"),
    "own pair": (lambda: arm_scene(self_pairs=[("ee_link", "ee_link")]), "a pair of shapes"),
}


@pytest.mark.parametrize("case", BAD)
def test_bad_input_is_refused_in_one_line(case):
    build, message = BAD[case]
    with pytest.raises(InputError, match=message) as caught:
        build()
    assert "\n" not in str(caught.value)
