"""Surfaces of contacts: frames, friction, soles and landings on planes that are not level."""

from dataclasses import replace

import casadi as ca
import numpy as np
import pinocchio as pin
import pytest
from numpy.testing import assert_allclose
from scipy.optimize import linprog

from tests.support.problems import FOOT, hop, hopper, lean
from tests.support.refusals import assert_refused_in_one_line
from trajopt import FlatGround, InputError, Phase, Problem, Schedule, start_of
from trajopt.dynamics import Coordinates
from trajopt.robot import Units
from trajopt.robot.contact import centre_of_pressure
from trajopt.robot.friction import friction_rows, pressure_rows, yaw_rows
from trajopt.solving.solving import solve
from trajopt.terms import (
    ContactLanding,
    Context,
    FrictionCone,
    FrictionPyramid,
    NodePlace,
    NormalForce,
    SoleCone,
    SoleLimits,
    SwingClearance,
)
from trajopt.terrain import Surface
from trajopt.terrain.surface import frame_of_normal
from trajopt.transcription.mesh import equal_fractions
from trajopt.transcription.stage_functions import point_function

ROUNDING = 1e-12  # numbers of order one after a few products
SAME_OPTIMUM = 1e-6  # relative: both solves stop at 1e-8
GENERATOR_SEED = 3
WALL = Surface(point=np.array([0.6, 0.0, 1.0]), normal=np.array([-2.0, 0.0, 0.5]), friction=0.4)
SIZE = (0.1, 0.06)


def random_normals(count: int) -> np.ndarray:
    normals = np.random.default_rng(GENERATOR_SEED).normal(size=(count, 3))
    special = [[0, 0, 1], [0, 0, -1], [-1, 0, 0], [0, 1, 0], [1e-9, 0, -1], [1e-9, -1e-9, 1]]
    normals = np.vstack([normals, special])
    return normals / np.linalg.norm(normals, axis=1, keepdims=True)


def test_frame_of_a_normal_is_a_rotation_onto_it():
    for normal in random_normals(200):
        frame = frame_of_normal(normal)
        assert_allclose(frame.T @ frame, np.eye(3), atol=ROUNDING)
        assert np.linalg.det(frame) == pytest.approx(1.0)
        assert_allclose(frame[:, 2], normal, atol=ROUNDING)


def test_frame_of_a_normal_is_the_least_rotation_from_up():
    for normal in random_normals(50):
        if normal[2] > -0.999:
            least = pin.Quaternion.FromTwoVectors(np.array([0.0, 0.0, 1.0]), normal).toRotationMatrix()
            assert_allclose(frame_of_normal(normal), least, atol=1e-7)  # Eigen's own accuracy near pi


def test_frame_of_level_ground_is_the_identity():
    assert np.array_equal(frame_of_normal((0.0, 0.0, 1.0)), np.eye(3))
    assert FlatGround().surface.is_level


def test_normal_becomes_a_unit_vector_and_distance_counts_along_it():
    assert np.linalg.norm(WALL.normal) == pytest.approx(1.0)
    behind = WALL.point - 0.3 * WALL.normal + 2.0 * WALL.tangents[0] - WALL.tangents[1]
    assert WALL.distance(behind) == pytest.approx(-0.3)
    assert WALL.height == pytest.approx(WALL.normal @ WALL.point)


def test_description_of_a_surface_makes_it_again():
    again = Surface.from_description(WALL.describe())
    assert again.describe() == WALL.describe()
    assert again.same_plane(WALL)
    assert not again.same_plane(Surface(point=WALL.point * 1.01, normal=WALL.normal))


def test_slope_lies_under_its_height_and_describes_its_normal():
    ground = FlatGround(height=0.2, normal=(-3.0, 0.0, 4.0))
    assert_allclose(ground.surface.distance(np.array([1.0, 5.0, 0.2 + 0.75])), 0.0, atol=ROUNDING)
    assert_allclose(ground.describe()["normal"], [-0.6, 0.0, 0.8])


def stance(**changes: object) -> Phase:
    return Phase(**{"name": "stance", "duration": 0.3, "contacts": (FOOT,), **changes})


BAD = {
    "normal without length": (lambda: Surface(point=np.zeros(3), normal=np.zeros(3)), "any direction"),
    "normal of two numbers": (lambda: Surface(point=np.zeros(3), normal=np.ones(2)), "3 finite numbers"),
    "infinite point": (lambda: Surface(point=[np.inf, 0, 0], normal=[0, 0, 1]), "3 finite numbers"),
    "text as a point": (lambda: Surface(point="here", normal=[0, 0, 1]), "3 finite numbers"),
    "negative friction": (lambda: Surface(point=np.zeros(3), normal=[0, 0, 1], friction=-1.0), ">= 0"),
    "number as bilateral": (lambda: Surface(point=np.zeros(3), normal=[0, 0, 1], bilateral=1), "True or"),
    "ground that is a wall": (lambda: FlatGround(normal=(1.0, 0.0, 0.0)), "upwards"),
    "surface of no contact": (lambda: stance(surfaces={"hand": WALL}), "active in the phase"),
    "surface that is none": (lambda: stance(surfaces={FOOT: 0.7}), "a Surface"),
    "foothold off its surface": (
        lambda: stance(surfaces={FOOT: WALL}, footholds={FOOT: np.zeros(3)}),
        "within 1e-06 m",
    ),
    "friction of a term": (lambda: FrictionCone(friction=float("nan")), "a finite number >= 0"),
    "normal force without bounds": (lambda: NormalForce(contact=FOOT), "at least one bound"),
    "normal force between nothing": (lambda: NormalForce(contact=FOOT, lower=2.0, upper=1.0), "<= upper"),
    "incomplete description": (lambda: Surface.from_description({"point": [0, 0, 0]}), "normal"),
}


@pytest.mark.parametrize("case", BAD)
def test_bad_input_is_one_clear_line(case):
    assert_refused_in_one_line(*BAD[case])


def test_contact_that_stays_must_stay_on_its_plane():
    step = Surface(point=[0, 0, 0.1], normal=[0, 0, 1])
    phases = Schedule((stance(), stance(name="next", surfaces={FOOT: step})))
    with pytest.raises(InputError, match="'foot' is in contact in phases 'stance' and 'next' on two planes"):
        hop(schedule=phases, terms=())
    ground = Surface(point=[3, 0, 0], normal=[0, 0, 1], friction=0.1)
    hop(schedule=Schedule((stance(), stance(name="next", surfaces={FOOT: ground}))), terms=())


# Rows of terms


def rows_of(term, surface: Surface, wrench: np.ndarray, kind: str = "point", turn: np.ndarray | None = None):
    """Values of a term's rows for one contact on ``surface``, its frame turned by ``turn`` (3, 3)."""
    robot = hopper(kind)
    contact = robot.contact(FOOT)
    context = Context(robot, Coordinates(robot.model), (contact,), surfaces={FOOT: surface})
    rows = term.rows(context, Units(robot))
    if rows is None:
        return None
    frame = context.frame(FOOT)
    inputs = [context.wrenches[FOOT], frame.rotation, context.parameters]
    values = ca.Function("rows", inputs, [rows.expression])(
        wrench[: contact.dimension], np.eye(3) if turn is None else turn, context.parameter_values
    )
    return np.array(values).ravel()


def test_friction_cone_is_coulombs_law_on_any_normal():
    generator, units = np.random.default_rng(GENERATOR_SEED), Units(hopper())
    for normal in random_normals(20):
        surface = Surface(point=np.zeros(3), normal=normal, friction=0.4)
        force = generator.normal(size=3) * units.force
        along = force @ normal
        across = np.linalg.norm(force - along * normal)
        pressure, inside = rows_of(FrictionCone(), surface, force)
        assert_allclose(pressure, along / units.force, atol=ROUNDING)
        assert (inside >= 0) == (across <= 0.4 * abs(along))
        if across < 0.4 * abs(along):  # about twice the distance from the side, as forces over the weight
            assert inside * units.force <= 2 * (0.4 * abs(along) - across) + ROUNDING


@pytest.mark.parametrize("term", [FrictionCone(), FrictionPyramid()], ids=["cone", "pyramid"])
def test_contact_without_friction_transmits_nothing_along_its_surface(term):
    robot, surface = hopper(), replace(WALL, friction=0.0)
    context = Context(robot, Coordinates(robot.model), (robot.contact(FOOT),), surfaces={FOOT: surface})
    rows = term.rows(context, Units(robot))
    assert rows.lower.tolist() == [0.0, 0.0, 0.0]
    assert rows.upper.tolist() == [np.inf, 0.0, 0.0]
    force = 2.0 * surface.normal + 0.3 * surface.tangents[0] - 0.4 * surface.tangents[1]
    values = rows_of(term, surface, force) / rows_of(term, surface, surface.normal)[0]
    assert_allclose(values, [2.0, 0.3, -0.4], atol=ROUNDING)


@pytest.mark.parametrize("term", [SoleCone(), SoleLimits()], ids=["cone", "limits"])
def test_sole_without_friction_transmits_no_yaw_moment(term):
    robot = hopper("surface")
    surfaces = {FOOT: Surface(point=np.zeros(3), normal=[0, 0, 1], friction=0.0)}
    context = Context(robot, Coordinates(robot.model), (robot.contact(FOOT),), surfaces=surfaces)
    rows = term.rows(context, Units(robot))
    equations = np.flatnonzero(rows.upper == 0.0)
    assert len(equations) == (3 if isinstance(term, SoleCone) else 1)
    wrench = np.array([0.0, 0.0, 2.0, 0.0, 0.0, 0.5])
    values = rows_of(term, surfaces[FOOT], wrench, "surface")
    assert_allclose(values[equations], [*[0.0] * (len(equations) - 1), 0.5], atol=ROUNDING)


def test_friction_pyramid_is_inscribed_in_the_cone():
    generator, inside = np.random.default_rng(GENERATOR_SEED), 0
    for _ in range(300):
        force = generator.normal(size=3)
        if np.all(rows_of(FrictionPyramid(), WALL, force) >= 0):
            inside += 1
            assert np.all(rows_of(FrictionCone(), WALL, force) >= 0)
    assert inside > 5
    corner = WALL.normal + 0.4 / np.sqrt(2) * (WALL.tangents[0] - WALL.tangents[1])
    assert np.min(rows_of(FrictionPyramid(), WALL, corner)) == pytest.approx(0.0, abs=ROUNDING)
    assert np.min(rows_of(FrictionCone(), WALL, corner)) == pytest.approx(0.0, abs=ROUNDING)


def test_number_overrides_the_friction_of_the_surface():
    force = WALL.normal + 0.5 * WALL.tangents[0]
    assert rows_of(FrictionCone(), WALL, force)[1] < 0
    assert rows_of(FrictionCone(friction=0.6), WALL, force)[1] > 0


@pytest.mark.parametrize("term", [FrictionCone(), FrictionPyramid(), SoleLimits(), SoleCone()])
def test_bilateral_surface_has_no_rows(term):
    held = replace(WALL, bilateral=True)
    assert rows_of(term, held, np.ones(6), "surface") is None
    assert rows_of(term, WALL, np.ones(6), "surface") is not None


def test_term_may_be_about_chosen_contacts_only():
    assert rows_of(FrictionCone(contacts=(FOOT,)), WALL, np.ones(3)) is not None
    assert rows_of(FrictionCone(contacts=()), WALL, np.ones(3)) is None
    with pytest.raises(InputError):
        rows_of(FrictionCone(contacts=("tail",)), WALL, np.ones(3))


def test_normal_force_is_the_component_along_the_normal():
    force = 3.0 * WALL.normal + WALL.tangents[1]
    assert_allclose(rows_of(NormalForce(contact=FOOT, lower=1.0), WALL, force), [3.0])


def test_another_normal_or_coefficient_builds_the_same_function():
    def text(surface: Surface) -> str:
        robot = hopper("surface")
        context = Context(robot, Coordinates(robot.model), (robot.contact(FOOT),), surfaces={FOOT: surface})
        rows = [term.rows(context, Units(robot)).expression for term in (FrictionCone(), SoleCone())]
        return point_function("point", context, ca.SX(0), rows).text

    assert text(WALL) == text(Surface(point=np.ones(3), normal=[0.3, 0.4, -1.0], friction=0.9))


# Soles


def corner_wrenches(friction: float) -> np.ndarray:
    """Wrenches (16, 6) of the edges of four friction pyramids at the corners of a sole."""
    found = []
    for x in (-SIZE[0], SIZE[0]):
        for y in (-SIZE[1], SIZE[1]):
            for side in ([1, 1], [1, -1], [-1, 1], [-1, -1]):
                force = np.array([friction * side[0], friction * side[1], 1.0])
                found.append(np.concatenate([force, np.cross([x, y, 0.0], force)]))
    return np.array(found)


def cone_rows(wrench: np.ndarray, friction: float) -> np.ndarray:
    force, moment = wrench[:3], wrench[3:]
    rows = [*friction_rows(force, friction), *pressure_rows(force, moment, SIZE)]
    return np.array([*rows, *yaw_rows(force, moment, SIZE, friction)])


def test_sums_of_forces_at_the_corners_are_inside_the_cone_of_the_sole():
    generator, edges = np.random.default_rng(GENERATOR_SEED), corner_wrenches(0.5)
    for _ in range(200):
        shares = generator.exponential(size=len(edges)) * (generator.uniform(size=len(edges)) < 0.2)
        assert np.min(cone_rows(shares @ edges, 0.5)) > -ROUNDING


def test_cone_of_the_sole_is_exactly_what_forces_at_its_corners_add_up_to():
    generator, edges = np.random.default_rng(GENERATOR_SEED), corner_wrenches(0.5)
    inside = 0
    for _ in range(300):
        wrench = generator.uniform(-1, 1, 6) * [0.5, 0.5, 0, SIZE[1], SIZE[0], 0.08] + [0, 0, 1, 0, 0, 0]
        found = linprog(np.zeros(len(edges)), A_eq=edges.T, b_eq=wrench)
        assert (found.status == 0) == (np.min(cone_rows(wrench, 0.5)) >= 0)
        inside += found.status == 0
    assert 50 < inside < 250


def test_cone_term_is_the_cone_in_the_axes_of_a_turned_sole():
    generator, units = np.random.default_rng(GENERATOR_SEED), Units(hopper("surface"))
    sole = hopper("surface").contact(FOOT)
    turn = WALL.frame @ pin.rpy.rpyToMatrix(0.0, 0.0, 0.7)
    wrench = generator.normal(size=6)
    force, moment = turn.T @ wrench[:3], turn.T @ wrench[3:]
    size, mu = (sole.half_length, sole.half_width), WALL.friction / np.sqrt(2)
    expected = [*friction_rows(force, mu), *pressure_rows(force, moment, size)]
    expected += yaw_rows(force, moment, size, mu)
    values = rows_of(SoleCone(), WALL, wrench, "surface", turn)
    assert_allclose(values, expected, atol=ROUNDING)
    assert units.torque != units.force


def test_box_limits_hold_pressure_on_a_wall():
    inside = WALL.frame @ np.array([0.0, 0.0, 1.0])
    turn = WALL.frame
    point = turn @ np.array([0.07, -0.04, 0.0])
    values = rows_of(SoleLimits(), WALL, np.concatenate([inside, np.cross(point, inside)]), "surface", turn)
    assert np.min(values) == pytest.approx(0.01)  # half sizes 0.08 and 0.05
    beyond = np.concatenate([inside, np.cross(1.5 * point, inside)])
    assert np.min(rows_of(SoleLimits(), WALL, beyond, "surface", turn)) < 0


def test_centre_of_pressure_is_the_mean_of_where_forces_press():
    generator = np.random.default_rng(GENERATOR_SEED)
    places = generator.uniform(-1, 1, (5, 2)) @ WALL.tangents
    pressures = generator.uniform(0.1, 1.0, 5)
    forces = np.outer(pressures, WALL.normal) + generator.normal(size=(5, 2)) @ WALL.tangents
    total, moment = forces.sum(axis=0), np.cross(places, forces).sum(axis=0)
    mean = pressures @ places / pressures.sum()
    assert_allclose(centre_of_pressure(total, moment, WALL.normal), mean, atol=ROUNDING)


# Landings and swing


def node_values(term, robot, placement: pin.SE3, place: NodePlace) -> np.ndarray:
    """Rows minus their lower bounds with the foot at a placement, at rest."""
    context = Context(robot, Coordinates(robot.model), node=True)
    rows = term.rows(context, Units(robot), place)
    frame = context.frame(FOOT)
    function = ca.Function("rows", [frame.stacked(), context.parameters], [rows.expression])
    numbers = np.concatenate([placement.rotation.flatten(order="F"), placement.translation, np.zeros(12)])
    return np.array(function(numbers, context.parameter_values)).ravel() - rows.lower


def test_sole_lands_flat_on_its_surface():
    phase = stance(surfaces={FOOT: WALL})
    term = ContactLanding(at=start_of("stance"), contacts=(FOOT,), terrain=FlatGround())
    place = NodePlace(phase=phase, index=0, fractions=equal_fractions(4), last=False)
    on_wall = WALL.point + 0.4 * WALL.tangents[0] - 0.2 * WALL.tangents[1]
    flat = pin.SE3(WALL.frame @ pin.rpy.rpyToMatrix(0, 0, 1.1), on_wall)
    values = node_values(term, hopper("surface"), flat, place)
    assert values.shape == (9,)  # height, two of parallelism, six of velocity
    assert_allclose(values, 0.0, atol=ROUNDING)
    off = pin.SE3(WALL.frame @ pin.rpy.rpyToMatrix(0.1, 0, 0), on_wall + 0.03 * WALL.normal)
    values = node_values(term, hopper("surface"), off, place)
    assert values[0] == pytest.approx(0.03)
    assert np.linalg.norm(values[1:3]) == pytest.approx(np.sin(0.1))


def test_swing_clearance_is_the_distance_from_a_slope():
    ground = FlatGround(height=0.1, normal=(-0.6, 0.0, 0.8))
    place = NodePlace(
        phase=Phase(name="flight", duration=0.2), index=2, fractions=equal_fractions(4), last=False
    )
    foot = ground.surface.point + 0.5 * ground.surface.tangents[0] + 0.07 * ground.surface.normal
    values = node_values(
        SwingClearance(height=0.05, terrain=ground), hopper(), pin.SE3(np.eye(3), foot), place
    )
    assert_allclose(values, [0.02], atol=ROUNDING)


# The same motion seen from two frames


def turned(problem: Problem, ground: FlatGround) -> Problem:
    """The problem laid onto a slope: start and guess turned with it, gravity as it is."""
    turn = ground.surface.frame

    def laid(q: np.ndarray) -> np.ndarray:
        q = q.copy()
        q[:3] = turn @ q[:3]
        q[3:7] = pin.Quaternion(turn @ pin.Quaternion(q[3:7]).toRotationMatrix()).coeffs()
        return q

    guess = problem.guess
    return replace(problem, terrain=ground, initial_q=laid(problem.initial_q), guess=lambda t: laid(guess(t)))


@pytest.mark.parametrize("friction", [FrictionCone(), FrictionPyramid()], ids=["cone", "pyramid"])
def test_slope_is_level_ground_under_tilted_gravity(friction):
    ground = FlatGround(friction=0.5, normal=(-np.sin(0.2), 0.0, np.cos(0.2)))
    terms = (*(term for term in lean().terms if not isinstance(term, FrictionCone)), friction)
    level = replace(lean(), terms=terms, terrain=FlatGround(friction=0.5))
    slope = turned(level, ground)
    model = level.robot.model.copy()
    model.gravity = pin.Motion(ground.surface.frame.T @ model.gravity.linear, np.zeros(3))
    level = replace(level, robot=replace(level.robot, model=model))
    options = {"transcription": "legendre:2", "intervals": 6, "tolerance": 1e-8}
    first, second = (solve(problem, **options) for problem in (level, slope))
    assert [first.converged, second.converged] == [True, True]
    assert second.statistics.objective == pytest.approx(first.statistics.objective, rel=SAME_OPTIMUM)
    assert_allclose(second.f[..., :3] @ ground.surface.frame, first.f[..., :3], atol=1e-4 * hopper().weight)
