"""Separating planes: their least row is Coal's signed distance less the margin, with its gradient."""

from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise

import coal
import numpy as np
import pinocchio as pin
import pytest
from scipy.optimize import nnls

import trajopt
from tests.support.ground import HILLS, STAIRS
from trajopt.collision.coal_shapes import coal_capsule, coal_hull
from trajopt.collision.description import robot_shapes, sampled_postures
from trajopt.collision.planes import (
    DEPTH,
    FOOT_SLACK,
    MOST_CORNERS,
    Approach,
    PlacedBody,
    SeparatingPlane,
    beyond_foot,
    nearest,
    nearest_along,
    separating_plane,
)
from trajopt.collision.shapes import box_corners
from trajopt.problem.bodies import bodies_of
from trajopt.terrain.flat import FlatGround
from trajopt_library import robots

# m; what Coal's iterations leave at this tolerance of theirs, and its thickening of flat hulls.
COAL, TIGHT = 2e-6, 1e-9
STEP, SLOPE = 1e-4, 2e-3  # m and rad; of differences, whose error is Coal's over the step, and curvature
EQUAL = 1e-5  # m; heights of the ends of an edge along the normal that Coal finds
HEAVY = 1e3  # weight of the condition that a combination is convex
MARGIN = 0.013
CASES = 60


def body(points: object, radius: float = 0.0, at: object = (0, 0, 0), turn: object = (0, 0, 0)) -> PlacedBody:
    """A body on a frame of its own."""
    position, rotation = np.array(at, dtype=float), pin.exp3(np.array(turn, dtype=float))
    placed = {"rotation": rotation, "position": position}
    return PlacedBody(frame="own", points=np.atleast_2d(points).astype(float), radius=radius, **placed)


def block(sides: object, **place: object) -> PlacedBody:
    half = np.array(sides, dtype=float) / 2
    return body(box_corners(-half, half), **place)


def rod(length: float, radius: float, **place: object) -> PlacedBody:
    return body([[-length / 2, 0, 0], [length / 2, 0, 0]], radius, **place)


def ball(radius: float, **place: object) -> PlacedBody:
    return body(np.zeros(3), radius, **place)


def lump(random: np.random.Generator, **place: object) -> PlacedBody:
    return body(random.uniform(-0.2, 0.2, (14, 3)), random.choice([0.0, 0.02]), **place)


GROUND = PlacedBody(normal=np.array([0.0, 0.6, 0.8]), height=-0.1)
Z = np.array([0.0, 0.0, 1.0])
PLACED = {
    "balls apart": (ball(0.1), ball(0.2, at=(0.1, 0.4, -0.3))),
    "balls in each other": (ball(0.1), ball(0.2, at=(0.05, 0.0, -0.1))),
    "balls touch": (ball(0.1), ball(0.2, at=(0.3, 0, 0))),
    "rods parallel": (rod(0.4, 0.05, at=(0, 0, 0.3)), rod(0.3, 0.04, at=(0.1, 0, 0))),
    "rods in line": (rod(0.4, 0.05), rod(0.3, 0.04, at=(0.5, 0, 0))),
    "rods cross": (rod(0.4, 0.05, at=(0, 0, 0.3)), rod(0.3, 0.04, turn=1.2 * Z)),
    "rods touch": (rod(0.4, 0.05, at=(0, 0, 0.09)), rod(0.3, 0.04, turn=1.2 * Z)),
    "rods in each other": (rod(0.4, 0.05, at=(0, 0, 0.03)), rod(0.3, 0.04, turn=1.2 * Z)),
    "ball and rod": (ball(0.1, at=(0.1, 0.1, 0.2)), rod(0.4, 0.05, turn=(0.3, 0.2, 0.1))),
    "blocks face to face": (block((0.2, 0.2, 0.2), at=(0, 0, 0.31)), block((0.5, 0.4, 0.3))),
    "blocks touch": (block((0.2, 0.2, 0.2), at=(0, 0, 0.25)), block((0.5, 0.4, 0.3))),
    "blocks in each other": (block((0.2, 0.2, 0.2), at=(0, 0, 0.22)), block((0.5, 0.4, 0.3))),
    "block on edge": (block((0.2, 0.2, 0.2), at=(0, 0, 0.4), turn=(0.6, 0, 0)), block((0.5, 0.4, 0.3))),
    "block over ground": (block((0.2, 0.3, 0.1), at=(0, 0, 0.3)), GROUND),
    "block flat on ground": (
        block((0.2, 0.3, 0.1), at=(0, -0.03, -0.04), turn=(-np.arcsin(0.6), 0, 0)),
        GROUND,
    ),
    "rod in ground": (rod(0.4, 0.05, at=(0, 0, -0.15), turn=(0, 0.5, 0)), GROUND),
}


def by_coal(first: PlacedBody, second: PlacedBody) -> tuple[float, np.ndarray]:
    """Signed distance, m, and the normal from the second to the first."""
    if second.normal is not None:
        return float((first.placed @ second.normal).min()) - first.radius - second.height, second.normal
    solids = []
    for each in (first, second):
        there = pin.SE3(each.rotation, each.position)
        if len(each.points) <= 2:
            solid, place = coal_capsule(each.points[0], each.points[-1], each.radius)
            there = there * place
        else:
            solid = coal_hull(each.points, each.radius)
        solids.append((solid, coal.Transform3s(there.rotation, there.translation)))
    request, result = coal.DistanceRequest(), coal.DistanceResult()
    request.gjk_tolerance = request.epa_tolerance = TIGHT
    distance = coal.distance(*solids[0], *solids[1], request, result)
    return float(distance), -np.array(result.normal)


def named(first: PlacedBody, second: PlacedBody) -> tuple[PlacedBody, PlacedBody]:
    """The bodies on frames of different names."""
    return replace(first, frame="first"), second if second.normal is not None else replace(
        second, frame="second"
    )


def approach(first: PlacedBody, second: PlacedBody) -> Approach:
    return nearest(*named(first, second), by_coal(first, second)[1])


def rows(plane: SeparatingPlane, first: PlacedBody, second: PlacedBody) -> np.ndarray:
    """The rows of a plane, m, at placements of the bodies."""
    at = {"first": (first.rotation, first.position), "second": (second.rotation, second.position)}
    at[None] = (np.eye(3), np.zeros(3))
    (turn, origin), (held, start) = at[plane.frame], at[plane.body]
    normal = held @ plane.normal
    return (plane.corners @ turn.T + origin) @ normal - plane.offset - normal @ start


def random_bodies(seed: int) -> tuple[PlacedBody, PlacedBody]:
    """Lumps, rods, blocks and balls, a third of them in each other."""
    random = np.random.default_rng(seed)
    makers: list[Callable[..., PlacedBody]] = [
        lambda **place: lump(random, **place),
        lambda **place: rod(random.uniform(0.1, 0.4), 0.04, **place),
        lambda **place: block(random.uniform(0.05, 0.4, 3), **place),
        lambda **place: ball(random.uniform(0.03, 0.1), **place),
    ]
    way = random.normal(size=3)
    way *= random.uniform(0.1, 0.6) / np.linalg.norm(way)
    first, second = (makers[k] for k in random.integers(0, len(makers), 2))
    return first(at=way, turn=random.normal(size=3)), second(turn=random.normal(size=3))


@pytest.mark.parametrize("case", PLACED)
def test_least_row_is_the_signed_distance_less_the_margin(case):
    first, second = PLACED[case]
    found = approach(first, second)
    assert found.distance == pytest.approx(by_coal(first, second)[0], abs=COAL)
    assert rows(separating_plane(found, MARGIN), first, second).min() == pytest.approx(
        found.distance - MARGIN, abs=COAL
    )


def test_least_row_is_the_signed_distance_of_random_bodies():
    within = 0
    for seed in range(CASES):
        first, second = random_bodies(seed)
        distance, _ = by_coal(first, second)
        within += distance < 0
        least = rows(separating_plane(approach(first, second), MARGIN), first, second).min()
        assert least == pytest.approx(distance - MARGIN, abs=COAL), seed
    assert 0 < within < CASES


def moved(given: PlacedBody, step: np.ndarray) -> PlacedBody:
    """A body moved by a twist (6,), m and rad, world."""
    return replace(given, position=given.position + step[:3], rotation=pin.exp3(step[3:]) @ given.rotation)


SMOOTH = ("balls apart", "balls in each other", "balls touch", "rods in line", "rods cross")
SMOOTH += ("rods touch", "rods in each other", "ball and rod", "block over ground", "rod in ground")


def slopes(
    value: Callable[[PlacedBody, PlacedBody], np.ndarray], pair: tuple[PlacedBody, PlacedBody]
) -> np.ndarray:
    """Central differences (12, n) of a function of two placements in the twists of both bodies."""
    found = []
    for number in range(2 if pair[1].normal is None else 1):
        for unit in np.eye(6):
            ends = [[*pair] for _ in range(2)]
            for end, sign in zip(ends, (1, -1), strict=True):
                end[number] = moved(pair[number], sign * STEP * unit)
            found.append((value(*ends[0]) - value(*ends[1])) / (2 * STEP))
    return np.array(found)


def gradient_error(pair: tuple[PlacedBody, PlacedBody]) -> float:
    """How far the distance's gradient is from the convex combinations of those of the least rows."""
    plane = separating_plane(approach(*pair), MARGIN)
    values = rows(plane, *pair)
    own = slopes(lambda *placed: rows(plane, *placed), pair)[:, values <= values.min() + EQUAL]
    true = slopes(lambda *placed: np.array(by_coal(*placed)[0]), pair)
    ones = HEAVY * np.ones(own.shape[1])
    return float(nnls(np.vstack([own, ones]), np.append(true, HEAVY))[1])


@pytest.mark.parametrize("case", SMOOTH)
def test_least_rows_have_the_gradient_of_the_distance(case):
    assert gradient_error(PLACED[case]) < SLOPE


def test_least_rows_of_random_bodies_have_the_gradient_of_the_distance():
    errors = [gradient_error(random_bodies(seed)) for seed in range(CASES)]
    assert max(errors) < SLOPE


def test_rows_are_a_lower_bound_of_the_distance_wherever_the_bodies_go():
    random = np.random.default_rng(7)
    for first, second in [*PLACED.values(), *(random_bodies(seed) for seed in range(CASES))]:
        plane = separating_plane(approach(first, second), MARGIN)
        every = plane.with_corners((first if plane.frame == "first" else second).points)
        for _ in range(3):
            steps = random.normal(0.0, 0.2, (2, 6))
            placed = moved(first, steps[0]), second if second.normal is not None else moved(second, steps[1])
            assert rows(every, *placed).min() <= by_coal(*placed)[0] - MARGIN + COAL


WRONG = {
    "zero": np.zeros(3),
    "not a number": np.full(3, np.nan),
    "the other way": np.array([0.0, 0.0, -1.0]),
    "sideways": np.array([1.0, 0.0, 0.0]),
    "long": np.array([0.0, 0.0, 3.0]),
}


@pytest.mark.parametrize("normal", WRONG)
@pytest.mark.parametrize("gap", [0.1, 0.0, -0.01])
def test_wrong_normal_of_a_failed_search_is_replaced(normal, gap):
    first, ground = ball(0.1, at=(2.0, 1.0, 0.1 + gap)), block((8.0, 6.0, 10.0), at=(0, 0, -5))
    faces = replace(ground, sides=np.concatenate([np.eye(3), -np.eye(3)]))
    found = nearest(*named(first, faces), WRONG[normal])
    assert found.distance == pytest.approx(gap, abs=1e-12)
    assert found.normal == pytest.approx(Z)
    above = ball(0.1, at=(0.0, 0.0, 0.1 + gap))
    assert nearest(*named(above, ground), WRONG[normal]).distance == pytest.approx(gap, abs=1e-12)


def test_bodies_about_the_same_centre_have_some_way_out():
    found = nearest(*named(ball(0.1), ball(0.2)), np.zeros(3))
    assert found.distance == pytest.approx(-0.3)
    assert np.linalg.norm(found.normal) == pytest.approx(1.0)


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("count", [1, 2])
def test_ways_of_a_mechanism_bound_the_normal(seed, count):
    random = np.random.default_rng(seed)
    turn = pin.exp3(random.uniform(-2, 2, 3))
    first, second = lump(random, at=random.uniform(-0.2, 0.2, 3)), lump(random)
    found = nearest_along(*named(first, second), turn[:, :count])
    assert np.abs(turn[:, count:].T @ found.normal).max() < 1e-12
    angles = np.linspace(0, 2 * np.pi, 20_001) if count == 2 else np.array([0, np.pi])
    normals = np.column_stack([np.cos(angles), np.sin(angles)][:count]) @ turn[:, :count].T
    depths = (first.placed @ normals.T).min(axis=0) - (second.placed @ normals.T).max(axis=0)
    assert found.distance == pytest.approx(depths.max() - first.radius - second.radius, abs=1e-4)


def test_links_that_move_in_a_plane_get_planes_that_their_joints_can_meet():
    """The acrobot's links overlap along its axes: the shortest way out is one that no joint takes."""
    scene = bodies_of(trajopt.load("acrobot", robot="acrobot")).scene
    pair, q = ("base_link", "link2"), np.array([1.0, 0.0, -0.99, 0.14])
    assert abs(scene.witness(q, pair).normal[0]) > 0.99
    ((found,),) = scene.approaches(q, [(0, pair)], 0.1)
    assert abs(found.normal[0]) < 1e-12
    assert found.distance < scene.witness(q, pair).distance


def test_half_space_has_its_own_normal():
    first, _ = PLACED["block over ground"]
    assert nearest(first, GROUND, np.zeros(3)).normal is GROUND.normal


def test_larger_face_carries_the_plane_and_corners_of_the_other_are_a_triangle():
    small, large = PLACED["blocks face to face"]
    for pair, carrier in (((small, large), "second"), ((large, small), "first")):
        plane = separating_plane(approach(*pair), MARGIN)
        assert plane.body == carrier
        assert len(plane.corners) == MOST_CORNERS
        sides = plane.corners[1:] - plane.corners[0]
        assert np.linalg.norm(np.cross(*sides)) == pytest.approx(0.2 * 0.2)
        assert plane.parameters.shape == (MOST_CORNERS, 7)


def test_only_corners_that_are_little_farther_have_a_row():
    tilted, large = block((0.2, 0.2, 0.2), at=(0, 0, 0.4), turn=(0.6, 0, 0)), block((0.5, 0.4, 0.3))
    plane = separating_plane(approach(tilted, large), MARGIN)
    assert len(plane.corners) == 2
    values = rows(plane, tilted, large)
    assert values.max() < values.min() + DEPTH


def test_corners_that_join_stay_and_are_not_repeated():
    plane = separating_plane(approach(*PLACED["blocks face to face"]), MARGIN)
    more = plane.with_corners(np.array([[1.0, 2.0, 3.0], *plane.corners]))
    assert len(more.corners) == len(plane.corners) + 1
    assert (more.offset, more.body) == (plane.offset, plane.body)


@pytest.mark.parametrize("name", ["solo12", "ur5"])  # the second has a shape that is fixed to the world
@pytest.mark.parametrize("terrain", [FlatGround(height=0.05), STAIRS, HILLS], ids=["flat", "stairs", "hills"])
def test_planes_of_a_scene_are_its_distances(terrain, name):
    robot = robots.load(name)
    scene = robot_shapes(robot).scene(robot.model, terrain)
    q = sampled_postures(robot, 3)
    distances = scene.distances(q)
    wanted = [(row, pair) for row in range(len(q)) for pair in scene.pairs]
    found = scene.approaches(q, wanted, np.inf)
    for (row, pair), approaches in zip(wanted, found, strict=True):
        least = min(
            rows(separating_plane(on_frames(own), MARGIN), own.first, own.second).min() for own in approaches
        )
        beyond = least + MARGIN - distances[row, scene.pairs.index(pair)]
        assert beyond < COAL
        assert beyond > -COAL or terrain is HILLS  # whose tangent plane may cut off more of a deep shape
    near = scene.approaches(q, wanted, 0.05)
    for every, some in zip(found, near, strict=True):
        assert len(some) == max(sum(own.distance <= 0.05 for own in every), 1)  # or the nearest alone


def on_frames(own: Approach) -> Approach:
    first, second = own.first, own.second
    world = second.frame is None
    return replace(
        own, first=replace(first, frame="first"), second=second if world else replace(second, frame="second")
    )


EDGE = block((0.5, 0.4, 0.3), at=(-0.25, 0.0, -0.15))  # below z = 0 and behind x = 0
SHANK = body([[0.06, 0.0, -0.1], [-0.16, 0.0, 0.04]], 0.01)  # from a foot in front of it to a knee over it


def leaning() -> tuple[Approach, PlacedBody]:
    found = nearest(SHANK, replace(EDGE, sides=np.array([Z, [1.0, 0.0, 0.0]])), Z)
    return found, PlacedBody(points=SHANK.points[:1], radius=0.02)


def test_a_plane_leaves_a_foot_in_front_of_an_edge_beyond_it():
    found, foot = leaning()
    assert found.distance < 0
    turned = beyond_foot(found, foot, 0.0)
    assert beyond_edge(turned.normal, foot) >= -FOOT_SLACK
    assert turned.distance <= found.distance  # of all directions the first has the shortest way out
    assert np.linalg.norm(turned.normal) == pytest.approx(1.0)
    nearer = turned.normal + 1e-2 * (found.normal - turned.normal)
    assert beyond_edge(nearer / np.linalg.norm(nearer), foot) < -FOOT_SLACK


def beyond_edge(normal: np.ndarray, foot: PlacedBody) -> float:
    return float((foot.placed @ normal).min() - foot.radius - (EDGE.placed @ normal).max())


def test_a_plane_stays_where_the_foot_is_beyond_it_or_too_near_in_any_direction():
    found, foot = leaning()
    above = replace(foot, points=np.array([[0.0, 0.0, 0.5]]))
    assert beyond_foot(found, above, 0.0) is found
    assert beyond_foot(found, foot, 0.1) is found
    ground = nearest(SHANK, GROUND, GROUND.normal)
    assert beyond_foot(ground, foot, 0.0) is ground


def test_signed_distance_is_continuous_through_touching():
    heights = np.linspace(0.32, 0.18, 15)
    below = block((0.5, 0.4, 0.3), turn=0.3 * Z)
    found = [approach(block((0.2, 0.2, 0.2), at=(0, 0, z)), below).distance for z in heights]
    assert all(later < sooner for sooner, later in pairwise(found))
    assert found == pytest.approx(heights - 0.25, abs=COAL)
