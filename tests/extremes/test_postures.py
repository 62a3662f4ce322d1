"""Singular postures at start, goal and guess: straight and folded legs, stretched arms, wrists in line."""

from dataclasses import replace

import numpy as np
import pytest

from tests.extremes.moves import lowered, pose_goal, reach, stance, with_joints
from tests.extremes.outcomes import Failed, Solved, assert_outcome, in_process
from trajopt.dynamics.model_quantities import contact_jacobian
from trajopt.robot.kinematics import contact_positions
from trajopt.robot.robot import Robot
from trajopt.solvers.status import Status
from trajopt.solving.diagnosis.diagnose import diagnose
from trajopt.solving.solving import solve
from trajopt_library import robots

pytestmark = pytest.mark.long

FINE = "legendre:3"
# Open-loop error (rad) of an arm's second of motion on ten intervals of degree three, measured up to 1e-4.
ARM = 5e-4
# The same of a stance, over the robot's length: measured up to 7e-4.
STANCE = 3e-3
# Of legs that start exactly straight and stay: with nothing to tell a bend this way from one that way, the
# error of an open loop grows e-fold every sqrt(l / g); measured 4e-4 after 0.2 s.
STRAIGHT = 3e-3
# A singular value this small is zero.
ZERO = 1e-12

CAUSE = "depend on each other there"


def ur5() -> dict[str, np.ndarray]:
    """Postures of the UR5 by name: all but the usual one singular."""
    arm, down = robots.load("ur5"), -np.pi / 2
    return {
        "usual": arm.reference,
        "stretched": with_joints(
            arm, {"shoulder_lift_joint": -0.6, "elbow_joint": 0.0, "wrist_1_joint": -0.5}
        ),
        "wrist in line": with_joints(arm, {"wrist_2_joint": 0.0}),
        "upright": with_joints(
            arm,
            {"shoulder_lift_joint": down, "elbow_joint": 0.0, "wrist_1_joint": down, "wrist_2_joint": 0.0},
        ),
    }


@pytest.mark.parametrize("singular", ["stretched", "wrist in line", "upright"])
@pytest.mark.parametrize("end", ["start", "goal", "guess"])
def test_arm_reaches_from_to_and_through_singular_postures(singular, end):
    postures, arm = ur5(), robots.load("ur5")
    start, goal = postures["usual"], postures["usual"] + 0.2
    start, goal = (postures[singular] if end == name else q for name, q in (("start", start), ("goal", goal)))
    guess = (lambda t: postures[singular]) if end == "guess" else None
    assert_outcome(Solved(ARM), lambda: reach(arm, start, goal, guess=guess), transcription="legendre:3")


def test_pose_at_which_a_wrist_is_in_line_is_reached():
    postures, arm = ur5(), robots.load("ur5")
    end = pose_goal(arm, postures["wrist in line"], "tool0")
    make = lambda: reach(arm, postures["usual"], postures["wrist in line"], end=end)  # noqa: E731
    assert_outcome(Solved(ARM), make, transcription="legendre:3")


def test_pose_at_full_stretch_stops_at_it_and_names_its_rows():
    """The pose is on the edge of what the arm reaches: there its rows lose rank and have no multipliers.

    Rounding decides whether a solver notices.
    """
    postures, arm = ur5(), robots.load("ur5")
    end = pose_goal(arm, postures["stretched"], "tool0")

    def make():
        return reach(arm, postures["usual"], postures["stretched"], end=end)

    solution = in_process(lambda: solve(make(), transcription="legendre:3", max_iterations=100))
    np.testing.assert_allclose(solution.q[-1][2], 0.0, atol=1e-5)  # the elbow is straight
    if not solution.success:
        assert solution.statistics.status in ("step_failed", "iteration_limit")
        assert CAUSE in solution.statistics.advice
    found = in_process(lambda: str(diagnose(solution, make())))
    assert "frame_pose" in found


def test_panda_reaches_from_a_wrist_in_line():
    arm = robots.load("panda")
    start = with_joints(arm, {"panda_joint6": 0.0})
    assert_outcome(Solved(ARM), lambda: reach(arm, start, arm.reference), transcription="legendre:3")


def straight(robot: Robot) -> np.ndarray:
    return with_joints(robot, dict.fromkeys(list(robot.model.names)[2:], 0.0))


def folded(robot: Robot, open_by: float = 0.0) -> np.ndarray:
    """Solo12's shanks along its thighs, which lie level: the feet are at the hips."""
    values = {}
    for name in list(robot.model.names)[2:]:
        side = 1.0 if name.startswith("F") else -1.0
        values[name] = {"HAA": 0.0, "HFE": side * np.pi / 2, "KFE": side * (open_by - np.pi)}[name[-3:]]
    return with_joints(robot, values)


def test_straight_legs_lose_rank_at_their_knees():
    """What is singular about them: feet cannot move along the legs."""
    robot = robots.load("solo12")
    leg = contact_jacobian(robot.model, straight(robot), [("FL_FOOT", (0, 1, 2))])[:, 6:9]
    assert np.linalg.svd(leg)[1][-1] < ZERO


def test_quadruped_stands_on_straight_legs():
    robot = robots.load("solo12")
    make = lambda: stance(robot, straight(robot), duration=0.2, intervals=6)  # noqa: E731
    assert_outcome(Solved(STRAIGHT), make, transcription="legendre:3")


@pytest.mark.parametrize(
    ("name", "end"),
    [("solo12", "start"), ("solo12", "goal"), ("solo12", "guess"), ("g1", "start"), ("g1", "goal")],
)
def test_legs_bend_from_and_stretch_to_straight(name, end):
    assert_outcome(Solved(STANCE), lambda: from_or_to_straight(robots.load(name), end), transcription=FINE)


@pytest.mark.parametrize("intervals", [4, 5, 6])
def test_humanoid_bends_from_a_guess_of_straight_legs_on_coarse_grids(intervals):
    """On finer ones the singular guess takes hundreds of iterations or more: docs/extremes.md."""
    make = lambda: from_or_to_straight(robots.load("g1"), "guess")  # noqa: E731
    assert_outcome(Solved(STANCE), make, transcription=FINE, intervals=intervals)


def from_or_to_straight(robot, end):
    stretched = straight(robot)
    low = lowered(robot, stretched, 0.2 * robot.length)
    start, goal = (stretched if end == which else low for which in ("start", "goal"))
    guess = (lambda t: stretched) if end == "guess" else None
    return stance(robot, start, goal, duration=2 * np.sqrt(robot.length / 9.81), guess=guess)


def test_quadruped_rises_from_nearly_folded_legs():
    robot = robots.load("solo12")
    start = folded(robot, 0.25)
    assert_outcome(
        Solved(STANCE), lambda: stance(robot, start, lowered(robot, start, -0.1)), transcription="legendre:3"
    )


def test_feet_at_the_hips_fail_with_their_rows_named():
    """Five of the twelve rows that hold the feet say nothing new at the start, and all others nearby."""
    robot = robots.load("solo12")
    start = folded(robot)
    places = [(contact.frame, contact.rows) for contact in robot.contacts]
    singular = np.linalg.svd(contact_jacobian(robot.model, start, places))[1]
    assert int(np.sum(singular < ZERO)) == 5
    make = lambda: stance(robot, start, intervals=3)  # noqa: E731
    stuck = Failed(Status.ITERATION_LIMIT, Status.STEP_FAILED, block="contact_acceleration")
    solution = assert_outcome(stuck, make, max_iterations=30)
    found = in_process(lambda: str(diagnose(solution, make())))
    assert "postures there are singular" in found


def test_knee_at_its_limit_is_a_start():
    """The hopper's knee ends 0.05 rad before it is straight: a start on the limit, nearly singular."""
    robot = robots.load("hopper")
    knee = list(robot.model.names)[-1]
    start = with_joints(robot, {knee: float(robot.position_lower[-1])})
    start[: robot.nq - robot.nu] = robot.reference[: robot.nq - robot.nu]
    start[1] -= contact_positions(robot, start)["foot"][2]
    assert start[-1] == robot.position_lower[-1]
    problem = stance(robot, start, duration=0.1)
    free = tuple(term for term in problem.terms if not term.name.startswith("terminal"))
    assert_outcome(Solved(STANCE), lambda: replace(problem, terms=free), transcription="legendre:3")
