"""What lies under a swing: edges, rows over them, guesses."""

from itertools import pairwise

import numpy as np
import pytest
from numpy.testing import assert_allclose

import trajopt
from tests.support.ground import HILLS, STAIRS
from tests.support.problems import FOOT, hopper
from trajopt.dynamics.manifold import Coordinates
from trajopt.robot.kinematics import contact_positions
from trajopt.robot.units import Units
from trajopt.schedule.schedule import Phase, Schedule
from trajopt.terms import Context, NodePlace, SwingOver, swing_clearance
from trajopt.terrain.crossing import crossing
from trajopt.terrain.piecewise import PiecewiseTerrain
from trajopt.terrain.swing_paths import swing_path, swing_profile
from trajopt.transcription.mesh import equal_fractions
from trajopt_library import problems

ROUNDING = 1e-12  # numbers of order one after a few products
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
