"""Motions that land on patches, their check, and a quadruped that steps up."""

from dataclasses import replace

import numpy as np
import pytest

from tests.support.synthetic_motions import sampled, standing, with_meta
from trajopt.certify.check import check
from trajopt.certify.report import AT_POINTS
from trajopt.errors import InputError, SolutionFileError
from trajopt.guesses import BaseWaypoint, legged_guess
from trajopt.problem import Problem
from trajopt.robot import Robot, contact_positions, quadruped_legs
from trajopt.schedule import Phase, Schedule
from trajopt.solution import Solution
from trajopt.solving.solving import solve
from trajopt.terms import (
    AccelerationCost,
    FramePose,
    FrictionPyramid,
    PositionLimits,
    PostureCost,
    SwingClearance,
    TerminalRest,
    TerminalState,
    TorqueCost,
    TorqueLimits,
    VelocityCost,
    VelocityLimits,
    WrenchCost,
    swing_clearance,
)
from trajopt.terrain import Patch, PiecewiseTerrain, smooth_step, swing_path
from trajopt_library import problems, robots

SOLVED = 1e-6  # rows of a solve that stops at 1e-8, over their units
SQUARE = Patch.rectangle((0.0, 0.0, 0.0), (0.2, 0.2), margin=0.05)


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
    kept = [t for t in problem.terms if not isinstance(t, SwingClearance | TerminalState | TerminalRest)]
    swing = swing_clearance(problem.robot, schedule, flat, height=0.03, guess=guess)
    terms = (*kept, *swing, TerminalState(q=end), TerminalRest(q=end))
    return replace(problem, schedule=schedule, terrain=flat, guess=guess, terms=terms)


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
        initial_q=robot.reference,
        initial_v=np.zeros(robot.nv),
        terms=(
            TorqueCost(weight=1.0),
            AccelerationCost(weight=2e-2),
            VelocityCost(weight=1e-2),
            PostureCost(weight=1e-1),
            WrenchCost(weight=1e-2),
            TorqueLimits(),
            PositionLimits(),
            VelocityLimits(),
            FrictionPyramid(),
            *swing_clearance(robot, schedule, terrain, height=height, guess=guess),
            FramePose(frame=robot.model.names[1], position=end),
            TerminalRest(q=guess(schedule.duration)),
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
