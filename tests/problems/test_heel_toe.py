"""Walks and runs on soles that roll: certified, cheaper than on flat feet, refused where they cannot be."""

import numpy as np
import pinocchio as pin
import pytest

import trajopt
from tests.support.refusals import refused
from tests.support.solved_problems import motion
from trajopt import Solution
from trajopt.motion.energy_use import cost_of_transport
from trajopt.robot import EDGES, edge_contacts
from trajopt_library import problems
from trajopt_library.problems import bipeds

ON_SOLES = ("talos", "g1")
ROLLING = {"feet": "heel-toe"}
# Iterations of the first solve within which every example is to solve from its own guess.
MOST_ITERATIONS = 60
# Corners have friction pyramids along the world's axes, soles along their own; small costs differ, too.
SAME_MODEL = 2e-2
# Pitch of a foot that clearly stands on an edge, rad.
TILTED = 0.05
# What a check allows of a sole, rad.
FLAT = 1e-2
# Moments of forces in file's digits, over the weight times a metre.
ROUNDING = 1e-12


def pitches(solution: Solution, frame: str) -> np.ndarray:
    """Pitch (K,) of a sole at all samples, toe down, rad."""
    model, data = solution.model, solution.model.createData()
    angles = []
    for q in solution.q:
        pin.framesForwardKinematics(model, data, q)
        angles.append(-np.arcsin(data.oMf[model.getFrameId(frame)].rotation[2, 0]))
    return np.array(angles)


def stands(solution: Solution, sole: str, edge: str) -> np.ndarray:
    """Samples (K,) at which an edge of a sole is active."""
    frames = list(solution.contact_frames)
    return np.array(solution.active[:, [frames.index(name) for name in edge_contacts(sole, edge)]].all(1))


def certified(name: str, **values: object) -> Solution:
    solution = motion(name, **values)
    assert solution.converged, solution.statistics.advice
    assert solution.statistics.rounds[0].iterations <= MOST_ITERATIONS
    assert not trajopt.check(solution).failures()
    return solution


@pytest.mark.slow
@pytest.mark.parametrize("robot", ON_SOLES)
def test_a_walk_strikes_with_the_heel_pushes_off_with_the_toe_and_costs_less(robot, tmp_path):
    rolling = certified("biped-gait", robot=robot, **ROLLING)
    # In this half of the cycle the left foot lands, and the right one leaves the ground.
    pitch = {foot: pitches(rolling, bipeds.biped(robot).contact(foot).frame) for foot in ("left", "right")}
    heel, toe = (stands(rolling, "left", edge) for edge in EDGES)
    assert pitch["left"][np.flatnonzero(heel & ~toe)[0]] < -TILTED
    assert np.abs(pitch["left"][heel & toe]).max() < FLAT
    assert pitch["right"][np.flatnonzero(stands(rolling, "right", "toe"))[-1]] > TILTED
    flat = certified("biped-gait", robot=robot)
    assert cost_of_transport(rolling) < 0.9 * cost_of_transport(flat)
    rolling.save(tmp_path / "rolling.npz")
    again = Solution.load(tmp_path / "rolling.npz")
    assert not trajopt.check(again).failures()


@pytest.mark.slow
@pytest.mark.parametrize("robot", ON_SOLES)
def test_a_walk_that_turns_rolls_over_feet_with_any_heading(robot):
    solution = certified("biped-walk", robot=robot, steps=3, turn=0.2, **ROLLING)
    model, data = solution.model, solution.model.createData()
    frames, moments = list(solution.contact_frames), []
    for k, q in enumerate(solution.q):
        pin.framesForwardKinematics(model, data, q)
        for foot in ("left", "right"):
            for edge in EDGES:
                ends = edge_contacts(foot, edge)
                places = np.array([data.oMf[model.getFrameId(name)].translation for name in ends])
                forces = solution.f[k, [frames.index(name) for name in ends], :3]
                along = places[0] - places[1]
                moment = np.cross(places - places.mean(axis=0), forces).sum(axis=0)
                moments.append(moment @ along / np.linalg.norm(along))
    weight = pin.computeTotalMass(model) * 9.81
    assert np.abs(moments).max() < ROUNDING * weight


@pytest.mark.slow
@pytest.mark.parametrize("robot", ON_SOLES)
def test_a_run_rolls_over_heel_and_toe(robot):
    certified("biped-run", robot=robot, **ROLLING)


@pytest.mark.slow
def test_corners_without_time_on_heel_or_toe_walk_like_soles():
    corners = certified("biped-gait", heel=0.0, toe=0.0, **ROLLING)
    soles = certified("biped-gait")
    assert cost_of_transport(corners) == pytest.approx(cost_of_transport(soles), rel=SAME_MODEL)


@pytest.mark.parametrize("family", ["biped-gait", "biped-run", "biped-walk"])
def test_flat_feet_are_the_default_and_have_no_corners(family):
    problem = problems.load(family)
    assert problem.robot is bipeds.biped("talos")
    assert {contact.kind for contact in problem.robot.contacts} == {"surface"}
    assert not any("heel" in frame.name for frame in problem.robot.model.frames)
    assert problems.load(family, **ROLLING).robot.model.nframes == problem.robot.model.nframes + 8


@pytest.mark.parametrize(
    ("family", "values", "message"),
    [
        ("biped-gait", {"robot": "bolt", **ROLLING}, "robot 'bolt' stands on points"),
        ("biped-gait", {"heel": 0.2}, "parameter heel is given, but feet is flat"),
        ("biped-walk", {"toe": 0.2}, "parameter toe is given, but feet is flat"),
        ("biped-run", {"heel": 0.5, "toe": 0.5, **ROLLING}, "flat in between"),
        ("biped-walk", {"heel": 0.5, "toe": 0.6, **ROLLING}, "flat in between"),
        ("biped-gait", {"toe": 0.999, **ROLLING}, "allowed: 0 to 0.9"),
        ("biped-gait", {"feet": "toes"}, "allowed: flat, heel-toe"),
        ("biped-gait", {"toe": 0.1667, **ROLLING}, "off phase 'double_1'|off phase 'single_1'"),
    ],
)
def test_wrong_use_gives_one_clear_line(family, values, message):
    with refused(message):
        problems.load(family, **values)
