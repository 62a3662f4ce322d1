"""Distances of links' shapes from the ground, from obstacles and from each other; witnesses; hulls."""

import coal
import numpy as np
import pinocchio as pin
import pytest
from scipy.optimize import minimize

from tests.support.refusals import refused_calls
from trajopt.cache import CACHE_VARIABLE
from trajopt.collision.coal_shapes import coal_link
from trajopt.collision.hulls import LEAST_EXCESS, MOST_EXCESS, prism, simplified
from trajopt.collision.near import GROUND, CollisionScene
from trajopt.collision.shapes import BoxObstacle, CapsuleObstacle, LinkShape, SphereObstacle
from trajopt.terrain import Bump, FlatGround, Incline, PiecewiseTerrain, SmoothTerrain, Wave

EXACT = 1e-8  # m; what Coal's iterations leave
WITNESS = 1e-5  # m; bodies of one metre along a normal that is exact to 1e-5
DENSE = 5e-4  # m; distance of neighbours in a dense sample of a curved ground
ZERO = np.zeros(3)
RANDOM = np.random.default_rng(3)
BALL = LinkShape.sphere("ball", "a", ZERO, 0.1)
ROD = LinkShape.capsule("rod", "a", [0, 0, -0.2], [0, 0, 0.2], 0.05)
BRICK = LinkShape.box("brick", "a", [0.2, 0.1, 0.3], [0.05, 0.0, 0.0], pin.exp3(np.array([0.3, 0.1, 0.2])))
LUMP = LinkShape(name="lump", frame="a", points=RANDOM.uniform(-0.1, 0.1, (12, 3)), radius=0.01)
PLATE = LinkShape(name="plate", frame="a", points=[[0, 0, 0], [0.3, 0, 0], [0, 0.2, 0]], radius=0.02)
SHAPES = {shape.name: shape for shape in (BALL, ROD, BRICK, LUMP, PLATE)}
KINDS = {"ball": "sphere", "rod": "capsule", "brick": "box", "lump": "hull", "plate": "hull"}


def two_bodies() -> pin.Model:
    """Two bodies that move freely, with the frames a and b."""
    model = pin.Model()
    for name in ("a", "b"):
        model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), f"joint_{name}")
        model.addFrame(pin.Frame(name, model.njoints - 1, 0, pin.SE3.Random(), pin.FrameType.OP_FRAME))
    return model


MODEL = two_bodies()


def at(first: pin.SE3, second: pin.SE3) -> np.ndarray:
    """Configuration (14,) with the frames a and b at these placements."""
    places = (first, second)
    frames = [MODEL.frames[MODEL.getFrameId(name)].placement for name in ("a", "b")]
    return np.concatenate([pin.SE3ToXYZQUAT(p * f.inverse()) for p, f in zip(places, frames, strict=True)])


def placed(position: list[float], turn: list[float] | np.ndarray = ZERO) -> pin.SE3:
    return pin.SE3(pin.exp3(np.asarray(turn, dtype=float)), np.array(position, dtype=float))


def on_b(shape: LinkShape) -> LinkShape:
    return LinkShape(name=f"{shape.name}_b", frame="b", points=shape.points, radius=shape.radius)


def pair_scene(first: LinkShape, second: LinkShape) -> CollisionScene:
    other = on_b(second)
    return CollisionScene(model=MODEL, shapes=(first, other), self_pairs=((first.name, other.name),))


def least_overlap(first: np.ndarray, second: np.ndarray) -> float:
    """Signed distance of two hulls of points by brute force: the best of many directions, refined."""

    def gap(direction: np.ndarray) -> float:
        n = direction / np.linalg.norm(direction)
        return float((first @ n).min() - (second @ n).max())

    starts = np.random.default_rng(0).normal(size=(2000, 3))
    best = sorted(starts, key=gap)[-5:]
    options = {"xatol": 1e-10, "fatol": 1e-12, "maxiter": 2000}
    return max(
        -minimize(lambda n: -gap(n), start, method="Nelder-Mead", options=options).fun for start in best
    )


@pytest.mark.parametrize("name", SHAPES)
def test_shapes_know_their_kind_and_survive_their_description(name):
    shape = SHAPES[name]
    assert shape.kind == KINDS[name]
    again = LinkShape.from_description(shape.describe())
    assert again.describe() == shape.describe()
    assert again.kind == shape.kind
    assert not shape.points.flags.writeable
    assert (np.linalg.norm(shape.points - shape.ball[0], axis=1) + shape.radius).max() <= shape.ball[
        1
    ] + EXACT


def test_capsule_of_an_older_file_is_read():
    old = {"name": "c", "frame": "a", "start": [0, 0, 0], "end": [0, 0, 1], "radius": 0.1}
    assert LinkShape.from_description(old).kind == "capsule"
    assert LinkShape.from_description({**old, "end": [0, 0, 0]}).kind == "sphere"


@pytest.mark.parametrize(
    "obstacle",
    [
        SphereObstacle(name="o", centre=[0.1, 0.2, 0.3], radius=0.2),
        CapsuleObstacle(name="o", start=ZERO, end=[0, 0, 1], radius=0.1),
        BoxObstacle(name="o", sides=[1, 2, 3], position=[1, 0, 0], rotation=pin.exp3(np.ones(3))),
    ],
)
def test_obstacle_is_the_hull_of_its_points(obstacle):
    shape = LinkShape(name="same", frame="a", points=obstacle.points, radius=obstacle.radius)
    scene = CollisionScene(model=MODEL, shapes=(shape, on_b(BALL)), obstacles=(obstacle,))
    for position in np.random.default_rng(0).uniform(-1, 2, (10, 3)):
        there = placed(position)
        found = dict(zip(scene.pairs, scene.distances(at(placed([0, 0, 0]), there))[0], strict=True))
        own = pair_scene(shape, BALL).distances(at(placed([0, 0, 0]), there))[0, 0]
        assert found["ball_b", "o"] == pytest.approx(own, abs=EXACT)


@pytest.mark.parametrize("first", SHAPES)
@pytest.mark.parametrize("second", ["rod", "brick", "lump"])
def test_distances_and_depths_are_those_of_brute_force(first, second):
    one, other, random = SHAPES[first], SHAPES[second], np.random.default_rng(1)
    scene = pair_scene(one, other)
    for reach in (0.05, 0.2, 0.5):
        here = placed(random.uniform(-1, 1, 3), random.normal(size=3))
        there = pin.SE3(pin.exp3(random.normal(size=3)), here.translation + reach * random.uniform(-1, 1, 3))
        worlds = [s.points @ p.rotation.T + p.translation for s, p in ((one, here), (other, there))]
        expected = least_overlap(*worlds) - one.radius - other.radius
        witness = scene.witness(at(here, there), scene.pairs[0])
        assert scene.distances(at(here, there))[0, 0] == pytest.approx(witness.distance, abs=WITNESS)
        assert witness.distance == pytest.approx(expected, abs=WITNESS)
        check_witness(witness, worlds, (one.radius, other.radius))


def check_witness(witness, worlds, radii) -> None:
    """Its normal is a unit vector, and gives the distance by the supports of both bodies."""
    n = witness.normal
    assert np.linalg.norm(n) == pytest.approx(1.0)
    low, high = (worlds[0] @ n).min() - radii[0], (worlds[1] @ n).max() + radii[1]
    assert low - high == pytest.approx(witness.distance, abs=EXACT)
    assert witness.first_point - witness.second_point == pytest.approx(witness.distance * n, abs=WITNESS)


TOUCHING = {
    "parallel rods": (ROD, ROD, [0.1, 0, 0], 0.0),
    "parallel rods inside": (ROD, ROD, [0.04, 0, 0], -0.06),
    "the same rod": (ROD, ROD, [0, 0, 0], -0.1),
    "faces apart": (LinkShape.box("c", "a", [1, 1, 1], ZERO), None, [0, 0, 1.3], 0.3),
    "faces touch": (LinkShape.box("c", "a", [1, 1, 1], ZERO), None, [0.2, 0.1, 1.0], 0.0),
    "faces deep": (LinkShape.box("c", "a", [1, 1, 1], ZERO), None, [0, 0.2, 0.9], -0.1),
    "balls of one centre": (BALL, BALL, [0, 0, 0], -0.2),
}


@pytest.mark.parametrize("case", TOUCHING)
def test_witness_is_right_where_shapes_are_parallel_touch_or_penetrate(case):
    one, other, position, expected = TOUCHING[case]
    other = one if other is None else other
    scene = pair_scene(one, other)
    witness = scene.witness(at(placed([0, 0, 0]), placed(position)), scene.pairs[0])
    assert witness.distance == pytest.approx(expected, abs=WITNESS)
    check_witness(witness, [one.points, other.points + position], (one.radius, other.radius))


def test_bounds_of_far_pairs_are_bounds_and_near_pairs_are_exact():
    random, shapes = np.random.default_rng(2), (*SHAPES.values(), *map(on_b, SHAPES.values()))
    pairs = tuple((a, f"{b}_b") for a in SHAPES for b in SHAPES)
    scene = CollisionScene(model=MODEL, shapes=shapes, self_pairs=pairs, terrain=FlatGround())
    way = np.linspace(0, 1, 60)[:, None]
    ends = [
        at(placed([0, 0, 0.5]), placed(random.uniform(-1, 1, 3), random.normal(size=3))) for _ in range(2)
    ]
    q = np.array([pin.interpolate(MODEL, *ends, float(s)) for s in way[:, 0]])
    for configurations in (q, q[random.permutation(len(q))]):
        exact, found = scene.distances(configurations), scene.distances(configurations, within=0.2)
        near = exact <= 0.2
        assert found[near] == pytest.approx(exact[near], abs=EXACT)
        assert (found[~near] > 0.2 - EXACT).all()
        assert (found <= exact + EXACT).all()


GROUNDS = {
    "level": FlatGround(height=0.1),
    "slope": FlatGround(normal=(0.3, 0.1, 1.0)),
    "stairs": PiecewiseTerrain.stairs(0.1, 0.3, 3),
    "box": PiecewiseTerrain.box(0.3, 0.6, 0.6, yaw=0.3),
    "gap": PiecewiseTerrain.gap(0.3),
}


def column(terrain: PiecewiseTerrain, random: np.random.Generator) -> np.ndarray:
    """Points (n, 3) of the surface of the ground near the origin: faces and risers, from above."""
    plane = random.uniform(-1.0, 1.5, (60_000, 2))
    return np.column_stack([plane, terrain.height(plane[:, 0], plane[:, 1])])


@pytest.mark.parametrize("shape", ["ball", "rod", "brick", "lump"])
@pytest.mark.parametrize("ground", ["level", "slope"])
def test_distance_from_a_plane_is_that_of_the_lowest_point(ground, shape):
    terrain, random = GROUNDS[ground], np.random.default_rng(5)
    scene = CollisionScene(model=MODEL, shapes=(SHAPES[shape],), terrain=terrain)
    for _ in range(5):
        here = placed(random.uniform(-0.5, 0.5, 3), random.normal(size=3))
        points = SHAPES[shape].points @ here.rotation.T + here.translation
        expected = terrain.surface.distance(points).min() - SHAPES[shape].radius
        q = at(here, placed([0, 0, 0]))
        assert scene.distances(q)[0, 0] == pytest.approx(expected, abs=EXACT)
        witness = scene.witness(q, (shape, GROUND))
        assert witness.distance == pytest.approx(expected, abs=EXACT)
        assert witness.normal == pytest.approx(terrain.surface.normal)
        assert terrain.surface.distance(witness.second_point) == pytest.approx(0, abs=EXACT)


@pytest.mark.parametrize("ground", ["stairs", "box", "gap"])
def test_distance_from_faces_is_zero_where_shapes_touch_them(ground):
    """A shape moved along the witness's normal by its distance touches: it neither overlaps nor is apart."""
    terrain, random = GROUNDS[ground], np.random.default_rng(6)
    scene = CollisionScene(model=MODEL, shapes=(BRICK, LUMP), terrain=terrain)
    for _ in range(8):
        here = placed([*random.uniform(-0.4, 0.6, 2), random.uniform(-0.1, 0.6)], random.normal(size=3))
        q = at(here, placed([0, 0, 0]))
        for column, pair in enumerate(scene.pairs):
            distance, witness = scene.distances(q)[0, column], scene.witness(q, pair)
            assert witness.distance == pytest.approx(distance, abs=WITNESS)
            away = pin.SE3(here.rotation, here.translation - distance * witness.normal)
            moved = scene.distances(at(away, placed([0, 0, 0])))[0, column]
            # Moved out of one body it may still be in another: never farther out than it was moved.
            assert moved == pytest.approx(0, abs=WITNESS) or (distance < 0 and moved < 0)


def test_block_beside_a_riser_is_as_far_from_it_as_it_is():
    scene = CollisionScene(
        model=MODEL, shapes=(LinkShape.box("c", "a", [0.1, 0.1, 0.1], ZERO),), terrain=GROUNDS["stairs"]
    )
    q = at(placed([-0.08, 0, 0.051]), placed([0, 0, 0]))
    # 1 mm above the ground before the stairs, 30 mm before the first riser.
    assert scene.distances(q)[0, 0] == pytest.approx(0.001, abs=EXACT)
    above = at(placed([-0.08, 0, 0.09]), placed([0, 0, 0]))
    assert scene.distances(above)[0, 0] == pytest.approx(0.03, abs=EXACT)


def test_hole_has_no_ground():
    scene = CollisionScene(model=MODEL, shapes=(BALL,), terrain=GROUNDS["gap"])
    q = at(placed([0.15, 0, -1.0]), placed([0, 0, 0]))
    assert scene.distances(q)[0, 0] == pytest.approx(0.05, abs=EXACT)  # its sides


CURVED = SmoothTerrain(
    shapes=(
        Wave(amplitude=0.03, wavelength=0.6),
        Bump(rise=0.05, radius=0.3, centre=(0.1, 0.1)),
        Incline(slope_x=0.1),
    )
)


@pytest.mark.parametrize("shape", ["ball", "rod", "brick", "lump"])
def test_distance_from_smooth_ground_is_that_of_a_dense_sample(shape):
    """The least over a dense sample of the shape, by the distance from the tangent plane under each point."""
    scene = CollisionScene(model=MODEL, shapes=(SHAPES[shape],), terrain=CURVED)
    random, hull = np.random.default_rng(7), SHAPES[shape]
    for _ in range(4):
        turn = pin.exp3(random.normal(size=3))
        weights = random.dirichlet(0.2 * np.ones(len(hull.points)), 20_000)
        dense = np.concatenate([hull.points, weights @ hull.points]) @ turn.T
        lowest = CURVED.surface.distance(dense + np.array([0, 0, 1.0])).min() - hull.radius
        here = pin.SE3(turn, np.array([0, 0, 1.02 - lowest]))
        expected = CURVED.surface.distance(dense + here.translation).min() - hull.radius
        q = at(here, placed([0, 0, 0]))
        found = scene.distances(q)[0, 0]
        assert found == pytest.approx(expected, abs=DENSE)
        witness = scene.witness(q, (shape, GROUND))
        assert witness.distance == pytest.approx(found, abs=EXACT)
        assert scene.distances(q, within=0.01)[0, 0] <= found + EXACT


def test_shapes_fixed_to_the_world_are_not_measured_against_it():
    fixed = LinkShape.sphere("base", "universe", ZERO, 0.1)
    ball = SphereObstacle(name="o", centre=ZERO, radius=0.1)
    scene = CollisionScene(
        model=MODEL,
        shapes=(fixed, BALL),
        obstacles=(ball,),
        terrain=FlatGround(),
        self_pairs=(("base", "ball"),),
    )
    assert scene.pairs == (("ball", GROUND), ("ball", "o"), ("base", "ball"))
    q = at(placed([0, 0, 0.5]), placed([0, 0, 0]))
    assert scene.distances(q)[0] == pytest.approx([0.4, 0.3, 0.3], abs=EXACT)


def sphere_points(count: int) -> np.ndarray:
    points = np.random.default_rng(0).normal(size=(count, 3))
    return points / np.linalg.norm(points, axis=1)[:, None]


CLOUDS = {
    "ball": 0.05 * sphere_points(2000),
    "long": sphere_points(2000) * [0.3, 0.05, 0.02],
    "flat": np.random.default_rng(1).uniform(-0.1, 0.1, (200, 3)) * [1, 1, 0],
    "few": np.random.default_rng(2).uniform(-0.1, 0.1, (6, 3)),
    "box": np.array(np.meshgrid([-0.1, 0.1], [-0.2, 0.2], [-0.05, 0.05])).reshape(3, -1).T,
}


@pytest.mark.parametrize("fine", [False, True])
@pytest.mark.parametrize("cloud", CLOUDS)
def test_simplified_hull_encloses_every_point_within_its_excess(cloud, fine, tmp_path, monkeypatch):
    monkeypatch.setenv(CACHE_VARIABLE, str(tmp_path))
    points = CLOUDS[cloud]
    corners, radius = simplified(points, fine)
    assert radius <= (LEAST_EXCESS if fine else MOST_EXCESS) or len(corners) == 1
    assert len(corners) < 500
    assert (len(corners) == 1) == (cloud == "ball" and not fine)  # its points leave gaps of 0.7 mm
    hull, place = coal_link(LinkShape(name="hull", frame="a", points=corners, radius=radius))
    still = coal.Transform3s(place.rotation, place.translation)
    request = coal.DistanceRequest()
    apart = [
        coal.distance(
            hull, still, coal.Sphere(1e-9), coal.Transform3s(np.eye(3), p), request, coal.DistanceResult()
        )
        for p in points
    ]
    assert max(apart) < 1e-7
    if len(corners) > 1:
        near = np.linalg.norm(corners[:, None] - points[None], axis=2).min(axis=1)
        assert near.max() < 3e-6  # corners are points of the cloud: the hull is larger by its radius at most
    again = simplified(points, fine)
    assert np.array_equal(again[0], corners)
    assert again[1] == radius


def test_simplified_hulls_come_from_the_cache_unless_they_are_damaged(tmp_path, monkeypatch):
    monkeypatch.setenv(CACHE_VARIABLE, str(tmp_path))
    points = CLOUDS["long"]
    corners, radius = simplified(points)
    (entry,) = tmp_path.iterdir()
    changed = entry.stat().st_mtime_ns
    found = simplified(points)
    assert entry.stat().st_mtime_ns == changed
    entry.write_bytes(entry.read_bytes()[:-8])
    repaired = simplified(points)
    for again in (found, repaired):
        assert np.array_equal(again[0], corners)
        assert again[1] == radius
    simplified(points, fine=True)
    assert len(list(tmp_path.iterdir())) == 2


def test_hulls_are_simplified_where_the_cache_cannot_be_written(tmp_path, monkeypatch):
    expected = simplified(CLOUDS["long"])
    monkeypatch.setenv(CACHE_VARIABLE, str(tmp_path / "file"))
    (tmp_path / "file").write_text("not a folder")
    with pytest.warns(UserWarning, match="cannot be written"):
        corners, radius = simplified(CLOUDS["long"])
    assert np.array_equal(corners, expected[0])
    assert radius == expected[1]


@pytest.mark.parametrize("radius", [0.005, 0.05, 0.5])
def test_prism_encloses_a_cylinder_with_little_excess(radius):
    corners = prism(radius, 0.2)
    reach = np.linalg.norm(corners[:, :2], axis=1)
    assert reach.max() <= radius + max(0.0101 * radius, 3.01e-4)
    middles = (corners[: len(corners) // 2, :2] + np.roll(corners[: len(corners) // 2, :2], 1, axis=0)) / 2
    assert np.linalg.norm(middles, axis=1).min() >= radius - EXACT
    assert len(corners) <= 50


def test_flat_hull_has_distances_and_depths():
    scene = pair_scene(PLATE, BALL)
    for height, expected in ((0.5, 0.38), (0.12, 0.0), (0.05, -0.07)):
        q = at(placed([0, 0, 0]), placed([0.05, 0.05, height]))
        assert scene.distances(q)[0, 0] == pytest.approx(expected, abs=3e-6)


test_bad_input_is_refused_in_one_line = refused_calls(
    (lambda: LinkShape(name="s", frame="a", points=np.zeros((0, 3)), radius=0.1), "points of"),
    (lambda: LinkShape(name="s", frame="a", points=np.zeros((3, 2))), r"\(n, 3\)"),
    (lambda: LinkShape(name="s", frame="a", points=[[0, 0, np.nan]], radius=1.0), "finite"),
    (lambda: LinkShape(name="s", frame="a", points=[[0, 0, 0]]), "radius of shape 's'"),
    (lambda: LinkShape(name="s", frame="a", points=np.eye(3), radius=-1.0), "radius"),
    (lambda: LinkShape.from_description({"name": "s"}), "keys: name, frame, points, radius"),
    (lambda: CollisionScene(model=MODEL, shapes=(LinkShape.sphere(GROUND, "a", ZERO, 1.0),)), "named ground"),
    (lambda: pair_scene(BALL, ROD).witness(np.zeros(14), ("a", "b")), "no pair"),
    (lambda: BRICK.axis, "is a box"),
)
