"""Terrain in schedules, problems, the check and the replay, and what lies under a swing; bad input."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from numpy.testing import assert_allclose

import trajopt
from tests.support.ground import HILLS, STAIRS
from tests.support.problems import FOOT, hop, hopper
from tests.support.refusals import assert_refused_in_one_line
from tests.support.replay_pages import shown
from tests.support.synthetic_motions import Motion, sampled, standing, with_meta
from trajopt import InputError, Phase, Schedule, Solution, check
from trajopt.dynamics import Coordinates
from trajopt.errors import SolutionFileError
from trajopt.robot import Units, contact_positions
from trajopt.schedule import placed_on
from trajopt.solving.solving import solve
from trajopt.terms import (
    Context,
    FrictionCone,
    FrictionPyramid,
    NodePlace,
    SwingClearance,
    SwingOver,
    swing_clearance,
)
from trajopt.terrain import (
    Bump,
    Incline,
    Patch,
    PiecewiseTerrain,
    SmoothTerrain,
    Surface,
    Wave,
    swing_path,
    terrain_from_description,
)
from trajopt.terrain.crossing import crossing
from trajopt.terrain.swing_paths import swing_profile
from trajopt.transcription.mesh import equal_fractions
from trajopt_library import problems, robots
from trajopt_library.robots import solo12

ROUNDING = 1e-12  # numbers of order one after a few products
SOLVED = 1e-6  # rows of a solve that stops at 1e-8, over their units


# Schedules and problems on terrain


def test_footholds_are_laid_onto_the_ground():
    landing = Phase(name="on", duration=0.1, contacts=(FOOT,), footholds={FOOT: np.array([0.28, 0.1, 0.0])})
    schedule = Schedule((landing,))
    stairs = PiecewiseTerrain.stairs(0.1, 0.3, 3, margin=0.05)
    fixed = placed_on(schedule, stairs).phases[0]
    assert_allclose(fixed.footholds[FOOT], [0.25, 0.1, 0.1])
    free = placed_on(schedule, stairs, free=True).phases[0]
    assert not free.footholds
    assert free.patches[FOOT] is stairs.face("step1")
    smooth = placed_on(schedule, HILLS).phases[0]
    assert_allclose(smooth.footholds[FOOT], [0.28, 0.1, HILLS.height(0.28, 0.1)], atol=ROUNDING)
    with pytest.raises(InputError, match="over a hole"):
        placed_on(schedule, PiecewiseTerrain.gap(0.5))


def landing_at(foothold: tuple[float, float, float]) -> Schedule:
    stance, flight, landing = hop().schedule.phases
    return Schedule((stance, flight, replace(landing, footholds={FOOT: np.array(foothold)})))


BAD = {
    "no face": (lambda: PiecewiseTerrain(faces=()), "at least one"),
    "two faces of one name": (lambda: PiecewiseTerrain(faces=STAIRS.faces[:1] * 2), "the same name"),
    "unknown face": (lambda: STAIRS.face("roof"), "step1"),
    "wall as ground": (
        lambda: PiecewiseTerrain(
            faces=(
                Patch(
                    surface=Surface(point=np.zeros(3), normal=np.array([1.0, 0, 0])),
                    vertices=np.array([[0, 0, 0], [0, 1, 0], [0, 1, 1.0]]),
                ),
            )
        ),
        "z > 0",
    ),
    "no steps": (lambda: PiecewiseTerrain.stairs(0.1, 0.3, 0), ">= 1"),
    "run of nothing": (lambda: PiecewiseTerrain.stairs(0.1, 0.0, 2), "> 0"),
    "infinite box": (lambda: PiecewiseTerrain.box(np.inf, 1.0, 1.0), "finite"),
    "obstacle nowhere": (lambda: PiecewiseTerrain.gap(0.1, at=(np.nan, 0.0)), "finite"),
    "heights for other stones": (lambda: PiecewiseTerrain.stepping_stones([(0, 0)], 0.1, [0, 1]), "one"),
    "no shapes": (lambda: SmoothTerrain(shapes=()), "at least one"),
    "bump without radius": (lambda: Bump(rise=0.1, radius=0.0), "> 0"),
    "text as a slope": (lambda: Incline(slope_x="steep"), "finite"),
    "friction": (lambda: SmoothTerrain(shapes=HILLS.shapes, friction=-1.0), ">= 0"),
    "unknown shape": (
        lambda: terrain_from_description({"kind": "smooth", "friction": 0.5, "shapes": [{}]}),
        "bump",
    ),
    "unknown terrain": (lambda: terrain_from_description({"kind": "swamp"}), "piecewise"),
    "clearance over edges": (lambda: SwingClearance(height=0.1, terrain=STAIRS), "swing_clearance"),
    "negative clearance": (lambda: swing_path(STAIRS, -0.1), ">= 0"),
    "sole on curved ground": (lambda: hop("surface", terrain=HILLS), "point contacts"),
    "landing on no face": (lambda: hop(terrain=STAIRS), "a patch"),
    "start over a hole": (
        lambda: hop(terrain=PiecewiseTerrain.gap(1.0, at=(-0.5, 0.0)), schedule=landing_at((2.0, 0, 0.0))),
        "no face",
    ),
    "foothold in the air": (
        lambda: hop(terrain=STAIRS, schedule=landing_at((0.1, 0, 0.0))),
        "within 1e-06 m",
    ),
    "foothold in the hill": (
        lambda: hop(terrain=HILLS, schedule=landing_at((0.1, 0, 0.0))),
        "within 0.001 m",
    ),
}


@pytest.mark.parametrize("case", BAD)
def test_bad_input_is_one_clear_line(case):
    assert_refused_in_one_line(*BAD[case])


# The check


def stands() -> Solution:
    """Solo12 at rest on level ground at height 0, one foot said to be in the air."""
    robot = robots.load("solo12")
    still = standing(robot)
    lifted = Motion(
        duration=still.duration,
        contacts=still.contacts[1:],
        q=still.q,
        v=still.v,
        a=still.a,
        tau=still.tau,
        f=still.f,
    )
    return sampled(robot, [lifted], 2)


def on_terrain(solution: Solution, terrain: PiecewiseTerrain | SmoothTerrain) -> Solution:
    return with_meta(solution, terrain=terrain.describe())


@pytest.mark.long
def test_foot_in_a_step_penetrates_by_the_whole_height_of_it():
    solution = stands()
    feet = contact_positions(robots.load("solo12"), solution.q[0])
    x = feet["FL_FOOT"][0]
    assert (
        check(on_terrain(solution, PiecewiseTerrain.stairs(0.1, 0.3, 1, at=(x + 0.02, 0)))).penetration
        < ROUNDING
    )
    assert check(
        on_terrain(solution, PiecewiseTerrain.stairs(0.1, 0.3, 1, at=(x - 0.02, 0)))
    ).penetration == (pytest.approx(0.1))


def test_foot_over_a_hole_penetrates_nothing():
    solution = stands()
    report = check(on_terrain(solution, PiecewiseTerrain.gap(0.3, at=(0.1, 0.0))))
    assert report.penetration < ROUNDING


def test_depth_landing_and_friction_are_those_of_the_normal_under_the_foot():
    solution, ground = stands(), SmoothTerrain(shapes=(Incline(level=0.02, slope_x=0.1),), friction=0.5)
    feet = contact_positions(robots.load("solo12"), solution.q[0])
    report = check(on_terrain(with_meta(solution, friction=[0.5] * 4), ground))
    normal = np.array([-0.1, 0.0, 1.0]) / np.hypot(1.0, 0.1)
    depths = [0.02 + 0.1 * p[0] - p[2] + solo12.RADIUS / normal[2] for p in feet.values()]
    assert report.penetration == pytest.approx(max(depths) * normal[2])
    assert report.landing_height == pytest.approx(max(abs(d) for d in depths[1:]) * normal[2])
    forces = solution.f[:, 1:, :3] / robots.load("solo12").weight
    along = forces @ normal
    margin = 0.5 * along - np.linalg.norm(forces - along[..., None] * normal, axis=-1)
    assert report.friction_margin == pytest.approx(margin.min())


@pytest.mark.parametrize(
    "terrain",
    [
        {"kind": "piecewise"},
        {"kind": "piecewise", "faces": [{}]},
        {"kind": "smooth", "friction": 0.5, "shapes": [3]},
    ],
)
def test_damaged_terrain_of_a_file_is_refused(terrain):
    solution = stands()
    with pytest.raises(SolutionFileError, match="terrain of meta"):
        check(with_meta(solution, terrain=terrain))


# The replay


@pytest.mark.parametrize(
    ("terrain", "drawn"),
    [
        (PiecewiseTerrain.gap(0.3, at=(0.3, 0.0)), {"ground/face0", "ground/face1"}),
        (HILLS, {"ground/smooth", "ground/grid"}),
    ],
    ids=["piecewise", "smooth"],
)
def test_replay_draws_the_ground_as_it_is_described(terrain, drawn, tmp_path):
    scene = shown(on_terrain(stands(), terrain), tmp_path)
    paths = {str(command.get("path", "")).removeprefix("/meshcat/") for command in scene["commands"]}
    assert drawn <= paths
    assert "ground/plane" not in paths


# A motion on smooth ground


@pytest.mark.long
@pytest.mark.parametrize("friction", [FrictionCone(), FrictionPyramid()], ids=["cone", "pyramid"])
def test_a_hop_lands_on_smooth_ground_with_forces_in_the_cone_of_its_normal(friction):
    robot = hopper()
    ground = SmoothTerrain(
        shapes=(Wave(amplitude=0.03, wavelength=0.5, at=(0.02, 0.0)), Incline(slope_y=0.1))
    )
    start, terms = robot.reference.copy(), [t for t in hop().terms if not isinstance(t, FrictionCone)]
    foot = contact_positions(robot, start)[FOOT]
    start[2] += float(ground.height(*foot[:2])) - foot[2]
    problem = hop(
        terrain=ground,
        terms=(*terms, friction, SwingClearance(height=0.02, terrain=ground)),
        initial_q=start,
        guess=lambda t: start,
    )
    solution = solve(problem)
    assert solution.converged, solution.statistics.advice
    report = check(solution)
    assert report.landing_height < SOLVED
    assert report.friction_margin > -SOLVED
    landed = contact_positions(robot, solution.q[np.flatnonzero(solution.phase == 2)[0]])[FOOT]
    assert landed[2] == pytest.approx(ground.height(*landed[:2]), abs=SOLVED)


SEED = 5


def between(terrain: PiecewiseTerrain, start: tuple[float, float], end: tuple[float, float]):
    places = [np.array([*xy, float(terrain.height(*xy))]) for xy in (start, end)]
    return crossing(terrain, *places, *(terrain.surface_at(place) for place in places))


def test_swing_up_a_step_rises_before_its_riser():
    found = between(STAIRS, (-0.2, 0.0), (0.1, 0.1))
    assert found.top == pytest.approx(0.1)
    assert_allclose(found.rise.normal, [-1, 0, 0], atol=ROUNDING)
    assert found.rise.distance(np.array([-0.05, 0.3, 0.0])) == pytest.approx(0.05)
    assert found.fall is None


def test_swing_down_a_step_sinks_behind_its_riser():
    found = between(STAIRS, (0.4, 0.0), (0.2, 0.0))
    assert found.rise is None
    assert_allclose(found.fall.normal, [-1, 0, 0], atol=ROUNDING)
    assert found.fall.offset == pytest.approx(-0.3)


def test_swing_over_two_steps_rises_before_the_first():
    found = between(STAIRS, (-0.1, 0.0), (0.4, 0.0))
    assert found.top == pytest.approx(0.2)
    assert found.rise.offset == pytest.approx(0.0, abs=ROUNDING)


def test_swing_over_a_box_has_an_edge_on_both_sides():
    found = between(PiecewiseTerrain.box(0.2, 0.4, 1.0), (-0.5, 0.0), (0.5, 0.2))
    assert found.top == pytest.approx(0.2)
    assert (found.rise.offset, found.fall.offset) == (pytest.approx(0.2), pytest.approx(0.2))
    assert_allclose([found.rise.normal, found.fall.normal], [[-1, 0, 0], [1, 0, 0]], atol=ROUNDING)


@pytest.mark.parametrize(
    ("terrain", "end"),
    [
        (PiecewiseTerrain.gap(0.3), (0.4, 0.0)),  # over a hole
        (PiecewiseTerrain.slope(0.2, 1.0), (0.6, 0.1)),  # into a valley
        (PiecewiseTerrain.box(-0.3, 0.2, 1.0), (0.4, 0.0)),  # over a pit
    ],
)
def test_nothing_stands_between_where_the_planes_of_the_ends_are_above_all(terrain, end):
    assert between(terrain, (-0.3, 0.0), end).top is None


def test_ridge_is_passed_at_its_height():
    found = between(PiecewiseTerrain.slope(0.2, 1.0), (0.7, 0.0), (1.4, 0.0))
    assert found.top == pytest.approx(0.2)
    assert found.rise.offset == pytest.approx(-1.0)
    assert found.fall is None


ROUGH = [
    STAIRS,
    PiecewiseTerrain.box(0.15, 0.3, 0.8, at=(0.2, 0.0), yaw=0.4),
    PiecewiseTerrain.steps([0.1, -0.05, 0.2, 0.0], 0.2, yaw=-0.3),
    PiecewiseTerrain.slope(0.2, 0.6),
    PiecewiseTerrain.slope(-0.2, 0.6),
    PiecewiseTerrain.gap(0.3, height=0.1),
    HILLS,
]


@pytest.mark.long
@pytest.mark.parametrize("terrain", ROUGH)
def test_guess_of_a_swing_joins_its_ends_and_is_never_below_the_ground(terrain):
    generator, path = np.random.default_rng(SEED), swing_path(terrain, 0.03)
    tried = 0
    while tried < 40:
        start = generator.uniform([-0.6, -0.3], [0.9, 0.3])
        end = start + generator.uniform([-0.5, -0.1], [0.5, 0.1])
        ends = [np.array([*xy, float(terrain.height(*xy))]) for xy in (start, end)]
        if not np.isfinite(ends).all():
            continue
        tried += 1
        track = np.array([path(FOOT, *ends, s) for s in np.linspace(0, 1, 101)])
        assert_allclose(track[[0, -1]], ends, atol=ROUNDING)
        over = track[:, 2] - terrain.height(track[:, 0], track[:, 1])
        assert over.min() > -ROUNDING


def swings(terrain: PiecewiseTerrain, start: np.ndarray, end: np.ndarray, height: float = 0.02) -> SwingOver:
    """The term of one swing of the hopper's foot from ``start`` to ``end`` (3,), guessed by `swing_path`."""
    robot, path = hopper(), swing_path(terrain, height)
    rest = contact_positions(robot, robot.reference)[FOOT]

    def guess(t: float) -> np.ndarray:
        q = robot.reference.copy()
        q[:3] += path(FOOT, start, end, (t - 0.1) / 0.4) - rest
        return q

    phases = (
        Phase(name="before", duration=0.1, contacts=(FOOT,)),
        Phase(name="swing", duration=0.4),
        Phase(name="after", duration=0.1, contacts=(FOOT,), footholds={FOOT: end}),
    )
    (term,) = swing_clearance(robot, Schedule(phases), terrain, height=height, guess=guess)
    return term


@pytest.mark.long
@pytest.mark.parametrize("count", [2, 3, 4, 7, 12])
@pytest.mark.parametrize("terrain", ROUGH[:3])
def test_straight_ways_between_nodes_within_the_rows_cut_no_edge(terrain, count):
    """The lowest allowed heights at nodes, on random ways on the allowed side of edges."""
    generator = np.random.default_rng(SEED)
    for _ in range(10):
        start = np.append(generator.uniform([-0.3, -0.1], [-0.05, 0.1]), 0.0)
        end = np.append(start[:2] + generator.uniform([0.25, -0.05], [0.4, 0.05]), 0.0)
        start[2], end[2] = (float(terrain.height(*point[:2])) for point in (start, end))
        term = swings(terrain, start, end)
        context = Context(hopper(), Coordinates(hopper().model), node=True)
        nodes = [start]
        for index in range(1, count):
            place = NodePlace(
                phase=Phase(name="swing", duration=0.4),
                index=index,
                fractions=equal_fractions(count),
                last=False,
            )
            assert term.acts_at(place)
            rows = term.swings[0].half_spaces(place, term.height)
            assert term.rows(context, Units(hopper()), place).expression.numel() == len(rows)
            part = np.sort(generator.uniform(nodes[-1][0], end[0], 3))[1]
            point = np.array([part, start[1] + (end[1] - start[1]) * index / count, 0.0])
            for normal, least in rows:
                if abs(normal[2]) < 0.5:
                    point = point + max(0.0, least - normal @ point) * normal
            point[2] = max(
                (least - normal[:2] @ point[:2]) / normal[2] for normal, least in rows if normal[2] > 0.5
            )
            nodes.append(point)
        nodes.append(end)
        way = np.concatenate([np.linspace(a, b, 60) for a, b in pairwise(nodes)])
        if count > 2 or term.swings[0].ground.fall is None or term.swings[0].ground.rise is None:
            assert (way[:, 2] - terrain.height(way[:, 0], way[:, 1])).min() > -ROUNDING


def test_swing_through_two_phases_is_one_swing():
    robot = hopper()
    phases = [
        Phase(name="before", duration=0.1, contacts=(FOOT,)),
        Phase(name="up", duration=0.1),
        Phase(name="down", duration=0.3),
        Phase(name="after", duration=0.1, contacts=(FOOT,), footholds={FOOT: np.array([0.02, 0, 0.0])}),
    ]
    inside, joints = swing_clearance(
        robot, Schedule(tuple(phases)), STAIRS, height=0.02, guess=lambda t: robot.reference
    )
    at = NodePlace(phase=phases[2], index=0, fractions=equal_fractions(3), last=False)
    assert joints.acts_at(at)
    assert not inside.acts_at(at)
    assert inside.swings[0].fraction(at) == (pytest.approx(0.25), pytest.approx(0.25))


# Relative change of the objective between 50 and 100 intervals; with a profile that rises at once it is 6e-2.
CONVERGED = 1e-3


def test_profile_is_one_in_the_middle_and_flat_at_the_ends():
    s, step = np.linspace(0, 1, 101), 1e-6
    values = np.array([swing_profile(each) for each in s])
    assert values[0] == values[-1] == 0.0
    assert values.max() == values[50] == 1.0
    assert swing_profile(step) / step < 1e-4
    assert (values <= 4 * s * (1 - s) + 1e-12).all()  # what kept the steeper profile keeps this one


@pytest.mark.long
def test_objective_of_a_hop_has_a_limit_on_finer_meshes():
    hop = problems.load("hopper-hop")
    coarse = trajopt.solve(hop, intervals=50)
    fine = trajopt.solve(hop, intervals=100, start=coarse)
    assert fine.converged
    assert fine.statistics.objective == pytest.approx(coarse.statistics.objective, rel=CONVERGED)
