"""Patches: bounded faces on which contacts land anywhere, and motions that land on them."""

from dataclasses import replace

import casadi as ca
import numpy as np
import pinocchio as pin
import pytest
from numpy.testing import assert_allclose
from scipy.optimize import minimize

from tests.support.problems import FOOT, hop, hopper
from tests.support.refusals import assert_refused_in_one_line
from tests.support.synthetic_motions import sampled, standing, with_meta
from trajopt import FlatGround, InputError, Phase, Problem, Robot, Schedule, Solution, check, start_of, terms
from trajopt.certify.report import AT_POINTS
from trajopt.dynamics import Coordinates
from trajopt.errors import SolutionFileError
from trajopt.reduced import BaseWaypoint, legged_guess
from trajopt.robot import Units, contact_positions, quadruped_legs
from trajopt.solving.solving import solve
from trajopt.terrain import Patch, PiecewiseTerrain, Surface, smooth_step, swing_path
from trajopt.transcription.mesh import equal_fractions
from trajopt_library import problems, robots

ROUNDING = 1e-12  # numbers of order one after a few products
OPTIMISED = 1e-6  # a reference optimiser stops there
SEED = 7
TILTED = Surface(point=np.array([0.3, -0.2, 0.5]), normal=np.array([-0.3, 0.2, 1.0]), friction=0.4)
CORNERS = ((0.0, 0.0), (0.5, -0.1), (0.7, 0.3), (0.2, 0.6), (-0.1, 0.3))


def pentagon(margin: float = 0.0, order: int = 1) -> Patch:
    vertices = TILTED.point + np.array(CORNERS)[::order] @ TILTED.tangents
    return Patch(surface=TILTED, vertices=vertices, margin=margin, name="pentagon")


def random_points(count: int) -> np.ndarray:
    generator = np.random.default_rng(SEED)
    local = generator.uniform(-0.6, 1.2, (count, 2))
    return TILTED.point + local @ TILTED.tangents + generator.normal(size=(count, 1)) * TILTED.normal


# The patch itself


def test_inside_is_the_distance_from_the_nearest_edge():
    patch = pentagon()
    for point in random_points(100):
        onto = point - TILTED.distance(point) * TILTED.normal
        distances = []
        for a, b in zip(patch.vertices, np.roll(patch.vertices, -1, axis=0), strict=True):
            along = (b - a) / np.linalg.norm(b - a)
            distances.append(np.cross(along, onto - a) @ TILTED.normal)
        assert patch.inside(point) == pytest.approx(min(distances), abs=ROUNDING)


def test_order_of_the_corners_does_not_matter():
    both = [pentagon(order=order).inside(random_points(50)) for order in (1, -1)]
    assert_allclose(*both, atol=ROUNDING)


def test_nearest_point_is_the_projection_on_the_part_within_the_margin():
    patch = pentagon(0.05)
    for point in random_points(15):
        constraint = {
            "type": "ineq",
            "fun": lambda x: (
                patch.inward @ (TILTED.point + x @ TILTED.tangents) - patch.offsets - patch.margin
            ),
        }
        found = minimize(
            lambda x, point=point: np.sum((TILTED.point + x @ TILTED.tangents - point) ** 2),
            [0.3, 0.25],
            constraints=[constraint],
            options={"ftol": 1e-14},
        )
        expected = TILTED.point + found.x @ TILTED.tangents
        assert_allclose(patch.nearest(point), expected, atol=OPTIMISED)


def test_rectangle_is_level_turned_and_as_large_as_said():
    patch = Patch.rectangle((1.0, 2.0, 0.3), (0.4, 0.2), yaw=0.6, margin=0.03)
    along = np.array([np.cos(0.6), np.sin(0.6), 0.0])
    assert patch.surface.is_level
    assert patch.inside(patch.centre) == pytest.approx(0.1)
    assert patch.inside(patch.centre + 0.19 * along) == pytest.approx(0.01)
    assert_allclose(np.linalg.norm(patch.allowed - np.roll(patch.allowed, 1, axis=0), axis=1)[:2].sum(), 0.48)


def test_description_makes_the_patch_again():
    patch = pentagon(0.02)
    assert Patch.from_description(patch.describe()).describe() == patch.describe()


def stance(**changes: object) -> Phase:
    return Phase(**{"name": "stance", "duration": 0.3, "contacts": (FOOT,), **changes})


SQUARE = Patch.rectangle((0.0, 0.0, 0.0), (0.2, 0.2), margin=0.05)
PLANE = Surface(point=np.zeros(3), normal=np.array([0.0, 0.0, 1.0]))


def polygon(*corners: tuple[float, float, float]) -> Patch:
    return Patch(surface=PLANE, vertices=np.array(corners, dtype=float))


BAD = {
    "two corners": (lambda: polygon((0, 0, 0), (1, 0, 0)), "n >= 3"),
    "corner off the plane": (lambda: polygon((0, 0, 0), (1, 0, 0), (0, 1, 0.1)), "within 1e-06 m"),
    "corners on a line": (lambda: polygon((0, 0, 0), (1, 0, 0), (2, 0, 0), (0, 1, 0)), "no three on a line"),
    "hollow corner": (lambda: polygon((0, 0, 0), (2, 0, 0), (0.5, 0.5, 0), (0, 2, 0)), "same way"),
    "star": (lambda: polygon(*[(np.cos(a), np.sin(a), 0) for a in 4 * np.pi / 5 * np.arange(5)]), "same way"),
    "corner twice": (lambda: polygon((0, 0, 0), (0, 0, 0), (1, 0, 0), (0, 1, 0)), "differ"),
    "margin of all": (lambda: replace(SQUARE, margin=0.11), "half of its width"),
    "negative margin": (lambda: replace(SQUARE, margin=-0.01), ">= 0"),
    "plane that is none": (lambda: Patch(surface=0.5, vertices=np.zeros((3, 3))), "a Surface"),
    "size of one number": (lambda: Patch.rectangle((0, 0, 0), (0.1,)), "size of Patch.rectangle is (0.1,)"),
    "incomplete description": (lambda: Patch.from_description({"name": "face"}), "vertices"),
    "patch of no contact": (lambda: stance(patches={"hand": SQUARE}), "active in the phase"),
    "patch that is none": (lambda: stance(patches={FOOT: PLANE}), "a Patch"),
    "patch and surface": (lambda: stance(patches={FOOT: SQUARE}, surfaces={FOOT: PLANE}), "one of them"),
    "foothold near the edge": (
        lambda: stance(patches={FOOT: SQUARE}, footholds={FOOT: np.array([0.08, 0.0, 0.0])}),
        "the margin 0.05 m inside",
    ),
    "foothold off the patch's plane": (
        lambda: stance(patches={FOOT: SQUARE}, footholds={FOOT: np.array([0.0, 0.0, 0.1])}),
        "on the plane",
    ),
    "another patch in mid stance": (
        lambda: hop(
            schedule=Schedule(
                (
                    stance(patches={FOOT: SQUARE}),
                    stance(name="next", patches={FOOT: replace(SQUARE, margin=0.0)}),
                )
            )
        ),
        "the patch on which it landed",
    ),
}


@pytest.mark.parametrize("case", BAD)
def test_bad_input_is_one_clear_line(case):
    assert_refused_in_one_line(*BAD[case])


# What contacts touch


def test_contact_stays_on_the_patch_it_landed_on():
    stairs = PiecewiseTerrain.stairs(0.1, 0.3, 3, at=(0.1, 0.0))
    landing = stance(name="landing", patches={FOOT: stairs.face("step1")})
    problem = hop(
        terrain=stairs,
        schedule=Schedule((stance(), Phase(name="flight", duration=0.2), landing, stance(name="rest"))),
    )
    surfaces = [problem.surfaces_of(index).get(FOOT) for index in range(4)]
    assert surfaces[0] is stairs.face("before").surface  # where the foot is at the start
    assert surfaces[1] is None
    assert surfaces[2] is surfaces[3] is stairs.face("step1").surface
    assert problem.schedule.patch(3, FOOT) is stairs.face("step1")


def test_foothold_on_piecewise_ground_is_on_the_face_under_it():
    stairs = PiecewiseTerrain.stairs(0.1, 0.3, 3, at=(0.1, 0.0))
    landing = stance(name="landing", footholds={FOOT: np.array([0.5, 0.0, 0.2])})
    schedule = Schedule((stance(), Phase(name="flight", duration=0.2), landing, stance(name="rest")))
    problem = hop(terrain=stairs, schedule=schedule)
    assert problem.surfaces_of(2)[FOOT] is problem.surfaces_of(3)[FOOT] is stairs.face("step2").surface


# Rows of a landing


def landing_rows(robot: Robot, patch: Patch) -> tuple[terms.Context, ca.Function, np.ndarray, np.ndarray]:
    """Rows of a landing on a patch as a function of the foot's frame, with their bounds."""
    context = terms.Context(robot, Coordinates(robot.model), node=True)
    place = terms.NodePlace(
        phase=stance(patches={FOOT: patch}), index=0, fractions=equal_fractions(4), last=False
    )
    term = terms.ContactLanding(at=start_of("stance"), contacts=(FOOT,), terrain=FlatGround())
    rows = term.rows(context, Units(robot), place)
    function = ca.Function("rows", [context.frame(FOOT).stacked(), context.parameters], [rows.expression])
    return context, function, rows.lower, rows.upper


def at(placement: pin.SE3) -> np.ndarray:
    return np.concatenate([placement.rotation.flatten(order="F"), placement.translation, np.zeros(12)])


def test_point_lands_on_the_plane_and_inside_every_edge():
    patch = pentagon(0.03)
    context, function, lower, upper = landing_rows(hopper(), patch)
    for point in random_points(20):
        values = np.array(function(at(pin.SE3(np.eye(3), point)), context.parameter_values)).ravel() - lower
        assert values[0] == pytest.approx(TILTED.distance(point))
        assert values[1:6].min() == pytest.approx(patch.inside(point) - patch.margin)
        assert len(values) == 1 + 5 + 3
    assert_allclose(lower[[0, 6, 7, 8]], upper[[0, 6, 7, 8]])
    assert np.isinf(upper[1:6]).all()


def test_all_four_corners_of_a_sole_land_inside_the_margin():
    patch, robot = pentagon(0.01), hopper("surface")
    contact = robot.contact(FOOT)
    half = np.array([contact.half_length, contact.half_width])
    context, function, lower, _ = landing_rows(robot, patch)
    turn = TILTED.frame @ pin.rpy.rpyToMatrix(0, 0, 0.5)
    for point in random_points(10):
        values = np.array(function(at(pin.SE3(turn, point)), context.parameter_values)).ravel() - lower
        corners = [point + turn[:, :2] @ (half * [i, j]) for i in (-1, 1) for j in (-1, 1)]
        assert values[3:23].min() == pytest.approx(patch.inside(np.array(corners)).min() - patch.margin)
        assert_allclose(values[1:3], 0.0, atol=ROUNDING)


def test_robot_in_a_plane_has_no_rows_for_edges_along_it():
    _, _, lower, _ = landing_rows(robots.load("hopper"), Patch.rectangle((0, 0, 0), (0.4, 0.4)))
    assert np.sum(np.isclose(lower, -0.2)) == 2  # the edges across x; those across y would be constant


def test_rows_at_a_corner_of_the_patch_are_independent():
    """Plane and two edges: three directions, also where both edges hold the foot."""
    patch = pentagon(0.05)
    context, function, lower, _ = landing_rows(hopper(), patch)
    frame, p = ca.SX.sym("o", 24), context.parameter_values
    jacobian = ca.Function("jacobian", [frame], [ca.jacobian(function(frame, p), frame)])
    for corner in patch.allowed:
        place = at(pin.SE3(np.eye(3), corner))
        values = np.array(function(place, p)).ravel() - lower
        active = np.flatnonzero(np.abs(values) < 1e-9)
        lines = np.array(jacobian(place))[active]
        assert len(active) == 3 + 3
        assert np.linalg.svd(lines, compute_uv=False).min() > 0.1


SOLVED = 1e-6  # rows of a solve that stops at 1e-8, over their units


# Motions


def displaced(point: np.ndarray, *by: float) -> np.ndarray:
    return point + np.array(by)


def landed_at(solution: Solution, robot: Robot, phase: int) -> dict[str, np.ndarray]:
    """Places (3,) of contacts at the first sample of a phase."""
    return contact_positions(robot, solution.q[np.flatnonzero(solution.phase == phase)[0]])


def hop_onto(step: float, distance: float, flat: PiecewiseTerrain, face: Patch) -> Problem:
    """The planar hopper hops up by ``step`` and forward by ``distance`` onto a face; it may choose where."""
    problem = problems.load("hopper-hop", distance=distance)
    stand, flight, landing = problem.schedule.phases
    schedule = Schedule((stand, flight, replace(landing, footholds={}, patches={"foot": face})))

    def guess(t: float) -> np.ndarray:
        return (
            problem.guess(t)
            + step * smooth_step((t - stand.duration) / flight.duration) * np.eye(len(problem.initial_q))[1]
        )

    end = guess(schedule.duration)
    kept = [
        t
        for t in problem.terms
        if not isinstance(t, terms.SwingClearance | terms.TerminalState | terms.TerminalRest)
    ]
    swing = terms.swing_clearance(problem.robot, schedule, flat, height=0.03, guess=guess)
    all_terms = (*kept, *swing, terms.TerminalState(q=end), terms.TerminalRest(q=end))
    return replace(problem, schedule=schedule, terrain=flat, guess=guess, terms=all_terms)


def test_a_hop_onto_a_step_lands_inside_its_face_and_cuts_no_edge():
    step = PiecewiseTerrain.steps([0.08], 1.0, at=(0.08, 0.0), margin=0.03)
    face = step.face("beyond")
    problem = hop_onto(0.08, 0.2, step, face)
    solution = solve(problem)
    assert solution.converged, solution.statistics.advice
    report = check(solution)
    assert report.within(AT_POINTS), report.failures(AT_POINTS)
    landed = landed_at(solution, problem.robot, 2)["foot"]
    assert landed[2] == pytest.approx(0.08, abs=SOLVED)
    assert face.inside(landed) >= face.margin - SOLVED


def test_foot_that_wants_off_the_patch_stays_at_its_margin():
    """The base ends short of the patch: the foot lands where it begins, at its margin from the edge."""
    flat = PiecewiseTerrain(faces=(Patch.rectangle((0, 0, 0), (4.0, 4.0), name="ground"),))
    patch = Patch.rectangle((0.4, 0.0, 0.0), (0.3, 0.4), margin=0.03)
    problem = hop_onto(0.0, 0.2, flat, patch)
    solution = solve(problem)
    assert solution.converged, solution.statistics.advice
    assert patch.inside(landed_at(solution, problem.robot, 2)["foot"]) == pytest.approx(0.03, abs=SOLVED)


# The check


def stands_on(patch: Patch) -> Solution:
    """Solo12 at rest, its front left foot on a patch."""
    solution = sampled(robots.load("solo12"), [standing(robots.load("solo12"))], 2)
    return with_meta(solution, patches=[{"FL_FOOT": patch.describe()}])


def test_patch_margin_is_the_foots_distance_from_the_edge():
    foot = contact_positions(robots.load("solo12"), robots.load("solo12").reference)["FL_FOOT"]
    inside = check(stands_on(Patch.rectangle(displaced(foot, 0.04, 0.0, 0.0), (0.2, 0.3))))
    assert inside.patch_margin == pytest.approx(0.06)
    assert "patch_margin" not in inside.failures()
    outside = check(stands_on(Patch.rectangle(displaced(foot, 0.12, 0.0, 0.0), (0.2, 0.3))))
    assert outside.patch_margin == pytest.approx(-0.02)
    assert "patch_margin" in outside.failures()
    without = sampled(robots.load("solo12"), [standing(robots.load("solo12"))], 2)
    assert check(without).patch_margin is None


@pytest.mark.parametrize(
    "patches",
    [3, [{}, {}], [{"NO_FOOT": SQUARE.describe()}], [{"FL_FOOT": {"name": "face"}}]],
    ids=["number", "phases", "frame", "description"],
)
def test_patches_that_do_not_fit_the_file_are_refused(patches):
    solution = stands_on(SQUARE)
    with pytest.raises((InputError, SolutionFileError), match="patches of meta"):
        check(with_meta(solution, patches=patches))


# A real robot


def step_up(name: str) -> Problem:
    """A quadruped puts its front feet onto a step, one after the other, each anywhere on the step's face."""
    robot = robots.load(name)
    length, unit = robot.length, np.sqrt(robot.length / 9.81)
    feet, legs = contact_positions(robot, robot.reference), quadruped_legs(robot)
    riser = (float(feet[legs.front_left][0]) + 0.25 * length, 0.0)
    terrain = PiecewiseTerrain.steps([0.25 * length], 1.0, at=riser, margin=0.1 * length)
    names, phases = tuple(feet), [Phase(name="start", duration=2 * unit, contacts=tuple(feet))]
    for foot in (legs.front_left, legs.front_right):
        others = tuple(other for other in names if other != foot)
        phases += [
            Phase(name=f"{foot} swings", duration=2.5 * unit, contacts=others),
            Phase(
                name=f"{foot} stands",
                duration=2 * unit,
                contacts=names,
                patches={foot: terrain.face("beyond")},
            ),
        ]
    schedule, end = Schedule(tuple(phases)), robot.reference[:3] + length * np.array([0.3, 0.0, 0.125])
    path = [BaseWaypoint(time=0, position=robot.reference[:3])]
    path.append(BaseWaypoint(time=schedule.duration, position=end))
    height = 0.12 * length
    guess = legged_guess(robot, schedule, path, terrain=terrain, swing=swing_path(terrain, height))
    return Problem(
        name="step-up",
        robot=robot,
        schedule=schedule,
        terrain=terrain,
        terms=(
            terms.TorqueCost(weight=1.0),
            terms.AccelerationCost(weight=2e-2),
            terms.VelocityCost(weight=1e-2),
            terms.PostureCost(weight=1e-1),
            terms.WrenchCost(weight=1e-2),
            terms.TorqueLimits(),
            terms.PositionLimits(),
            terms.VelocityLimits(),
            terms.FrictionPyramid(),
            *terms.swing_clearance(robot, schedule, terrain, height=height, guess=guess),
            terms.FramePose(frame=robot.model.names[1], position=end),
            terms.TerminalRest(q=guess(schedule.duration)),
        ),
        guess=guess,
        default_intervals=40,
    )


@pytest.mark.slow
@pytest.mark.parametrize("name", ["solo12"])
def test_a_quadruped_steps_up_without_cutting_the_edge(name):
    problem = step_up(name)
    solution = solve(problem)
    assert solution.converged, solution.statistics.advice
    report = check(solution)
    assert report.within(AT_POINTS), report.failures(AT_POINTS)
    assert report.patch_margin > 0
    face = problem.terrain.face("beyond")
    for index in (2, 4):
        (foot,) = problem.schedule.phases[index].patches
        assert face.inside(landed_at(solution, problem.robot, index)[foot]) >= face.margin - SOLVED
