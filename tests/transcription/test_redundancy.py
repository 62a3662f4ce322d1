"""Contact rows that others say already are left out, and nothing else is."""

import numpy as np
import pytest

import trajopt
from tests.support.problems import hop
from tests.support.redundant_contacts import corners, solo, solo_hop
from trajopt import Phase, Problem, Schedule
from trajopt.certify.report import AT_POINTS
from trajopt.solving.solving import prepare
from trajopt.terms import PostureCost, TorqueCost, WrenchCost
from trajopt.transcription.redundancy import independent_rows
from trajopt_library import problems, robots

# The price of the wrenches themselves differs between one sole and four corners: a millionth of the torques'.
SAME_OPTIMUM = 1e-5
# Singular values of independent rows in natural units, far above those of dependent ones (1e-10).
INDEPENDENT = 1e-6


def smallest_singular_value(problem: Problem) -> float:
    """Of the equality rows near the guess."""
    nlp = prepare(problem, intervals=6).nlp
    t = nlp.transcription
    x = trajopt.transcription.guess.perturbed(t, trajopt.transcription.guess.initial_guess(t), 0, 1e-2)
    jacobian = nlp.jacobian(x).toarray()
    equal, free = t.lower_g == t.upper_g, t.lower_x < t.upper_x
    return float(np.linalg.svd(jacobian[equal][:, free], compute_uv=False)[-1])


def test_feet_on_legs_in_parallel_planes_keep_two_lateral_rows():
    kept = independent_rows(solo(), solo().reference, (), solo().contacts)
    assert [len(rows) for rows in kept.values()] == [3, 2, 3, 2]
    assert all({0, 2} <= set(rows) for rows in kept.values())


@pytest.mark.long
def test_hop_on_redundant_feet_has_independent_rows_and_solves():
    problem = solo_hop()
    assert smallest_singular_value(problem) > INDEPENDENT
    solution = trajopt.solve(problem, intervals=20)
    assert solution.converged
    assert solution.statistics.iterations <= 60
    assert solution.statistics.redundant_contact_rows == {
        "stance": ["FR_FOOT y", "HR_FOOT y"],
        "landing": ["FR_FOOT y", "HR_FOOT y"],
    }
    assert trajopt.check(solution).within(AT_POINTS)


@pytest.mark.parametrize("name", ["solo12-jump", "talos-wall", "hopper-hop", "solo12-slope", "ur5-pull"])
def test_contacts_that_are_independent_keep_all_rows(name):
    problem = problems.load(name)
    for index, phase in enumerate(problem.schedule.phases):
        contacts = [problem.robot.contact(contact) for contact in phase.contacts]
        q = problem.guess(sum(p.duration for p in problem.schedule.phases[:index]) + phase.duration / 2)
        kept = independent_rows(problem.robot, q, (), contacts)
        assert kept == {contact.name: contact.rows for contact in contacts}


def test_straight_legs_are_singular_by_posture_and_keep_their_rows():
    robot = robots.load("solo12")
    q = robot.reference.copy()
    q[7:] = 0.0
    assert independent_rows(robot, q, (), robot.contacts) == {c.name: c.rows for c in robot.contacts}


def test_four_corners_of_a_foot_keep_six_rows_and_three_heights():
    robot = corners()
    kept = independent_rows(robot, robot.reference, (), robot.contacts)
    assert sum(len(rows) for rows in kept.values()) == 6
    assert sum(2 in rows for rows in kept.values()) == 3


def test_rows_of_contacts_that_held_before_are_kept_first():
    robot = corners()
    last = robot.contacts[3]
    kept = independent_rows(robot, robot.reference, (last,), robot.contacts[:3])
    assert kept[last.name] == (0, 1, 2)
    assert sum(len(rows) for rows in kept.values()) == 6


@pytest.mark.long
@pytest.mark.parametrize("family", ["biped-gait", "biped-run"])
@pytest.mark.parametrize("robot", ["talos", "g1"])
def test_soles_that_roll_have_independent_rows_through_every_phase(family, robot):
    """From heel to flat, from flat to toe and over the end: edges that hold are not imposed again."""
    problem = problems.load(family, robot=robot, feet="heel-toe")
    assert smallest_singular_value(problem) > INDEPENDENT


@pytest.mark.long
def test_foot_of_corners_moves_its_robot_like_a_sole():
    """Standing, to another posture, cheapest in torque: how corners share the sole's wrench costs nothing."""
    optima = []
    for robot in (hop("surface").robot, corners()):
        names = tuple(contact.name for contact in robot.contacts)
        posture = robot.reference.copy()
        posture[-2:] += [0.1, -0.05]
        terms = (TorqueCost(weight=1.0), PostureCost(weight=10.0, q=posture), WrenchCost(weight=1e-7))
        stance = Schedule((Phase(name="stance", duration=0.5, contacts=names),))
        problem = hop("surface", robot=robot, schedule=stance, terms=terms)
        assert smallest_singular_value(problem) > INDEPENDENT
        solution = trajopt.solve(problem, intervals=8)
        assert solution.converged
        assert trajopt.check(solution).contact_acceleration < 1e-6  # of all twelve rows
        optima.append(solution.statistics.objective)
    assert optima[1] == pytest.approx(optima[0], rel=SAME_OPTIMUM)
