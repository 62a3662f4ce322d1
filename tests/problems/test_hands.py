"""Humanoids on hands and feet: starts and ends that need the hands, forces of hands, wrong settings."""

from functools import lru_cache

import numpy as np
import pinocchio as pin
import pytest

import trajopt
from trajopt.certify.check import check
from trajopt.dynamics.model_quantities import gravity_of, mass_of
from trajopt.errors import InputError
from trajopt.robot import Robot, biped_legs, contact_poses
from trajopt.solution.solution import Solution
from trajopt_library import problems
from trajopt_library.problems import bipeds

# Inverse kinematics of the library's postures; forces of a solver at 1e-6 over the weight.
PLACED, FORCE = 1e-4, 1e-5
FAMILIES = ("humanoid-climb", "humanoid-lean", "humanoid-push-off")
# The centre of mass is at least this far beyond the toes where hands are needed, m.
BEYOND = 0.05


def beyond_toes(robot: Robot, q: np.ndarray) -> float:
    """How far the centre of mass is ahead of the front edges of both soles, m."""
    poses = contact_poses(robot, q)
    toes = [poses[foot].act(np.array([robot.contact(foot).half_length, 0, 0])) for foot in biped_legs(robot)]
    return float(pin.centerOfMass(robot.model, robot.model.createData(), q)[0] - max(toe[0] for toe in toes))


@lru_cache
def solved(name: str) -> Solution:
    solution = trajopt.solve(problems.load(name))
    report = check(solution)
    assert solution.converged
    assert not report.failures(), report.failures()
    return solution


def forces(solution: Solution, phase: str, hand: str) -> np.ndarray:
    """Forces (n, 3) of a hand at a phase's collocation points, N."""
    rows = (solution.phase == solution.description.phase_names.index(phase)) & solution.collocation
    return solution.f[rows, list(solution.contact_frames).index(hand), :3]


@pytest.mark.parametrize("name", bipeds.HUMANOIDS)
def test_hands_are_mirror_images_and_feet_stand_as_without_arms(name):
    robot, legs = bipeds.humanoid(name), bipeds.biped(name.removesuffix("_arms"))
    poses, feet = contact_poses(robot, robot.reference), contact_poses(legs, legs.reference)
    left, right = (poses[hand].translation for hand in bipeds.hands(robot))
    assert left == pytest.approx(right * [1, -1, 1], abs=PLACED)
    assert all(poses[foot].isApprox(feet[foot], 1e-9) for foot in feet)
    assert robot.mass == pytest.approx(legs.mass)


@pytest.mark.parametrize("name", FAMILIES)
def test_guess_has_every_contact_in_its_place(name):
    problem, begin = problems.load(name), 0.0
    for index, phase in enumerate(problem.schedule.phases):
        for part in (1e-6, 0.3, 0.7, 1 - 1e-6):
            poses = contact_poses(problem.robot, problem.guess(begin + part * phase.duration))
            for contact in phase.contacts:
                place = problem.contact_place(contact, index)
                assert place is None or poses[contact].translation == pytest.approx(place, abs=PLACED)
        begin += phase.duration


@pytest.mark.parametrize("robot", bipeds.HUMANOIDS)
def test_who_pushes_off_starts_where_soles_alone_cannot_hold_it(robot):
    problem = problems.load("humanoid-push-off", robot=robot)
    assert beyond_toes(problem.robot, problem.initial_q) > BEYOND


@pytest.mark.parametrize(
    ("name", "parameters", "words"),
    [
        ("humanoid-push-off", {"lean": 0.8}, "cannot lean by 0.8 rad, soles flat; allowed: up to"),
        ("humanoid-push-off", {"distance": 1.5}, "miss a wall 1.5 m"),
        ("humanoid-push-off", {"robot": "bolt"}, "contacts that are not feet"),
        ("humanoid-lean", {"reach": 1.5}, "miss the goal beyond the table by"),
        ("humanoid-lean", {"distance": 1.5}, "miss the table by"),
        ("humanoid-climb", {"rail": 1.6}, "in phase 'left_hand_1'"),
        ("humanoid-climb", {"run": 0.15}, "steps are 0.15 m deep for soles of 0.17 m"),
        ("humanoid-climb", {"steps": 1.5}, "allowed: a whole number"),
    ],
)
def test_settings_that_cannot_be_are_refused_in_one_line(name, parameters, words):
    with pytest.raises(InputError, match=words):
        problems.load(name, **parameters)


@pytest.mark.slow
def test_hands_only_push_on_the_wall_and_let_go_of_a_standing_robot():
    solution = solved("humanoid-push-off")
    for hand in ("left_hand", "right_hand"):
        force = forces(solution, "push", hand)
        assert (force[:, 0] < 0).all()  # the wall is ahead: its normal is -x
        assert (np.linalg.norm(force[:, 1:], axis=1) <= -0.5 * force[:, 0] + FORCE * 1e3).all()
        assert not forces(solution, "recover", hand).any()
    assert solution.q[-1] == pytest.approx(bipeds.humanoid("g1_arms").reference, abs=1e-5)


@pytest.mark.slow
def test_who_leans_rests_on_the_table_beyond_its_toes():
    solution, robot = solved("humanoid-lean"), bipeds.humanoid("g1_arms")
    assert beyond_toes(robot, solution.q[-1]) > BEYOND
    assert np.abs(solution.v[-1]).max() < 1e-4
    weight = mass_of(solution.model) * gravity_of(solution.model)
    assert forces(solution, "stretch", "left_hand")[-1, 2] > 0.1 * weight


@pytest.mark.slow
def test_who_climbs_stands_a_step_higher():
    solution, robot = solved("humanoid-climb"), bipeds.humanoid("g1_arms")
    before, after = (contact_poses(robot, q) for q in (robot.reference, solution.q[-1]))
    for foot in biped_legs(robot):
        way = after[foot].translation - before[foot].translation
        assert way == pytest.approx([0.45 * robot.reference[2], 0.0, 0.35 * robot.reference[2]], abs=1e-5)
        assert after[foot].rotation[:, 2] == pytest.approx([0, 0, 1], abs=1e-5)
    # soles land at any yaw, with which the base's place goes: 3 mm at 0.2 rad
    assert solution.q[-1, :3] == pytest.approx(robot.reference[:3] + way, abs=0.01)
