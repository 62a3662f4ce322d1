"""Smooth distances keep what they promise, measured by Coal; scenes of capsules and obstacles."""

from __future__ import annotations

from functools import lru_cache

import casadi as ca
import coal
import numpy as np
import pinocchio as pin
import pytest

from trajopt.errors import InputError
from trajopt.robot.collision.coal_shapes import coal_capsule, coal_obstacle
from trajopt.robot.collision.distances import Box, SymbolicAxis, box_distance, segment_distance
from trajopt.robot.collision.link_capsules import robot_capsules
from trajopt.robot.collision.near import CollisionScene, separable_pairs
from trajopt.robot.collision.shapes import (
    BoxObstacle,
    CapsuleObstacle,
    LinkShape,
    SphereObstacle,
    obstacle_from_description,
)
from trajopt_library import robots

COAL = 1e-6  # m; what Coal's iterations for a box stop at
SMOOTHING = 1e-3
STEP = 1e-6  # of finite differences; their error is about the square root of rounding
DIFFERENCES = 1e-6
KINKS = 0.02  # part of random cases in which a difference straddles a jump of the second derivative
CASES, DIFFERENTIATED = 600, 150


V, W, B, R = ca.SX.sym("v", 6), ca.SX.sym("w", 6), ca.SX.sym("b", 15), ca.SX.sym("r")


@lru_cache
def distance_function(kind: str) -> ca.Function:
    """(axis (6,), other, reach) -> distance minus reach, its gradient and second derivative in the axis."""
    axis = SymbolicAxis(V[:3], V[3:])
    if kind == "box":
        box = Box(ca.reshape(B[:9], 3, 3), B[9:12], B[12:])
        other, value = B, box_distance(axis, box, R, SMOOTHING)
    else:
        other, value = W, segment_distance(axis, SymbolicAxis(W[:3], W[3:]), R, SMOOTHING)
    hessian, gradient = ca.hessian(value, V)
    return ca.Function(kind, [V, other, R], [value, gradient, hessian])


def evaluated(kind: str, *inputs: object) -> tuple[float, np.ndarray, np.ndarray]:
    value, gradient, hessian = distance_function(kind)(*inputs)
    return float(value), np.array(gradient).ravel(), np.array(hessian)


def random_case(kind: str, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray, float, float, object]:
    """Axis, other shape's numbers, its radius, the axis' radius, and Coal's shape with its placement."""
    axis, radius = rng.uniform(-0.5, 0.5, 6), rng.uniform(0.03, 0.12)
    if kind == "box":
        turn, place = pin.exp3(rng.uniform(-2, 2, 3)), rng.uniform(-0.2, 0.2, 3)
        half = rng.uniform(0.03, 0.3, 3)
        shape = coal_obstacle(BoxObstacle(name="box", sides=2 * half, position=place, rotation=turn))
        return axis, np.r_[turn.flatten(order="F"), place, half], 0.0, radius, shape
    other, own = rng.uniform(-0.5, 0.5, 6), rng.uniform(0.03, 0.12)
    if kind == "sphere":
        other[3:] = other[:3]
    return axis, other, own, radius, coal_capsule(other[:3], other[3:], own)


def by_coal(first: tuple, second: tuple) -> float:
    placed = [(shape, coal.Transform3s(at.rotation, at.translation)) for shape, at in (first, second)]
    return coal.distance(*placed[0], *placed[1], coal.DistanceRequest(), coal.DistanceResult())


@pytest.mark.parametrize(("kind", "band"), [("box", 3**0.5), ("capsule", 1.0), ("sphere", 1.0)])
def test_smooth_distance_is_on_the_safe_side_within_its_bound(kind, band):
    rng = np.random.default_rng(1)
    for _ in range(CASES):
        axis, other, own, radius, shape = random_case(kind, rng)
        margin = rng.uniform(0, 0.02)
        beyond = evaluated("box" if kind == "box" else "capsule", axis, other, own + radius + margin)[0]
        true = by_coal(coal_capsule(axis[:3], axis[3:], radius), shape)
        if true > margin:
            assert beyond < true - margin + COAL
        else:
            assert beyond < COAL  # kept never means violated
        if true > margin + band * SMOOTHING + COAL:
            assert beyond > 0  # nor is more asked than the bound says


@pytest.mark.parametrize("kind", ["box", "capsule", "sphere"])
def test_derivatives_are_those_of_differences(kind):
    rng, first, second = np.random.default_rng(2), [], []
    name = "box" if kind == "box" else "capsule"
    for _ in range(DIFFERENTIATED):
        axis, other, own, radius, _ = random_case(kind, rng)
        value, gradient, hessian = evaluated(name, axis, other, own + radius)
        pairs = [
            [evaluated(name, axis + sign * STEP * unit, other, own + radius) for sign in (1, -1)]
            for unit in np.eye(6)
        ]
        slopes = np.array([(ahead[0] - behind[0]) / (2 * STEP) for ahead, behind in pairs])
        bends = np.array([(ahead[1] - behind[1]) / (2 * STEP) for ahead, behind in pairs])
        first.append(np.abs(slopes - gradient).max())
        second.append(np.abs(bends - hessian).max() / (1 + np.abs(hessian).max()))
        assert np.isfinite(value)
    assert np.quantile(first, 1 - KINKS) < DIFFERENCES
    assert np.quantile(second, 1 - KINKS) < DIFFERENCES


@pytest.mark.parametrize("kind", ["box", "capsule"])
def test_penetration_has_a_way_out(kind):
    rng = np.random.default_rng(3)
    for _ in range(CASES):
        axis, other, own, radius, shape = random_case(kind, rng)
        value, gradient, hessian = evaluated(kind, axis, other, own + radius)
        if by_coal(coal_capsule(axis[:3], axis[3:], radius), shape) > 0:
            continue
        assert np.isfinite(hessian).all()
        assert value < COAL
        assert np.linalg.norm(gradient) > 0.05  # of a length moved at either end


def test_degenerate_places_have_finite_derivatives():
    upright, box = np.r_[np.zeros(3), 0, 0, 0.4], np.r_[np.eye(3).ravel(), 0, 0, 0, 0.1, 0.2, 0.3]
    crossing = np.r_[-0.2, 0, 0.2, 0.2, 0, 0.2]
    point = np.r_[upright[:3], upright[:3]]
    cases = [
        ("box", np.zeros(6), box),  # a sphere at the very middle
        ("box", upright, box),
        ("box", np.r_[0.2, -0.3, 0, 0.2, 0.3, 0], box),  # parallel to a face
        ("capsule", upright, upright),  # the same axis
        ("capsule", upright, crossing),
        ("capsule", upright, upright + 0.2),  # parallel
        ("capsule", point, point + 0.2),
        ("capsule", point, point),
    ]
    for kind, axis, other in cases:
        _, gradient, hessian = evaluated(kind, axis, other, 0.1)
        assert np.isfinite(gradient).all()
        assert np.isfinite(hessian).all()


TURN = pin.exp3(np.ones(3))


OBSTACLES = (
    BoxObstacle(name="box", sides=[0.2, 0.3, 0.4], position=[0.5, 0.4, 0.2], rotation=TURN),
    CapsuleObstacle(name="post", start=[0.4, -0.4, 0], end=[0.4, -0.4, 0.8], radius=0.05),
    SphereObstacle(name="ball", centre=[-0.5, 0.2, 0.6], radius=0.1),
)


def arm_scene(**changes: object) -> CollisionScene:
    robot = robots.load("ur5")
    given = {"model": robot.model, "shapes": robot_capsules(robot), "obstacles": OBSTACLES}
    return CollisionScene(**(given | changes))


def test_distances_of_a_scene_are_those_of_its_shapes():
    scene, model = arm_scene(self_pairs=(("shoulder_link", "wrist_3_link"),)), robots.load("ur5").model
    q = robots.load("ur5").reference + np.random.default_rng(4).uniform(-0.3, 0.3, model.nq)
    data = model.createData()
    pin.framesForwardKinematics(model, data, q)
    shapes = {o.name: coal_obstacle(o) for o in scene.obstacles}
    for c in scene.shapes:
        frame = data.oMf[model.getFrameId(c.frame)]
        shapes[c.name] = coal_capsule(*(frame.act(end) for end in c.axis), c.radius)
    expected = [by_coal(shapes[first], shapes[second]) for first, second in scene.pairs]
    assert scene.distances(q)[0] == pytest.approx(expected, abs=COAL)
    near = [pair for pair, distance in zip(scene.pairs, expected, strict=True) if distance < 0.3]
    assert scene.near([q], 0.3) == tuple(near)
    assert 0 < len(near) < len(scene.pairs)


@pytest.mark.parametrize("name", ["ur5", "panda", "solo12"])
def test_links_that_can_be_kept_apart_are_so_in_the_reference(name):
    robot = robots.load(name)
    capsules = robot_capsules(robot)
    pairs = separable_pairs(robot.model, capsules, robot.reference, 0.01)
    scene = CollisionScene(model=robot.model, shapes=capsules, self_pairs=pairs)
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
    "text": (lambda: SphereObstacle(name="s", centre="here", radius=1.0), "centre of obstacle 's'"),
    "no radius": (lambda: SphereObstacle(name="s", centre=ZERO, radius=0.0), "radius of obstacle 's'"),
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
