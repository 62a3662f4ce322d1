"""Starts, footholds and goals that no motion can have are refused when the problem is built, in one line."""

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest

from tests.support.problems import FOOT, hop, reach
from trajopt import InputError, Problem
from trajopt.certify.report import FOOT_DRIFT
from trajopt.certify.report import SOLE_TILT as CHECKED_TILT
from trajopt.problem.places import CONTACT_GAP, SOLE_TILT
from trajopt.robot.kinematics import contact_positions, frame_pose
from trajopt.schedule import middle_of, start_of
from trajopt.schedule.moment import Target
from trajopt.schedule.schedule import Schedule
from trajopt.terms import FrameHeight, FramePose, PositionLimits, Term, TerminalState
from trajopt.terrain.flat import FlatGround
from trajopt.terrain.surface import Surface
from trajopt_library import problems

HOP = hop()
STANDS = contact_positions(HOP.robot, HOP.initial_q)[FOOT]
NEAR = 0.99 * CONTACT_GAP


def raised(up: float) -> np.ndarray:
    return STANDS + np.array([0.0, 0.0, up])


def moved(q: np.ndarray, up: float) -> np.ndarray:
    return q + up * np.eye(len(q))[2]


def landing(at: np.ndarray, **changes: object) -> Problem:
    """The hop with a foothold at the landing."""
    last = replace(HOP.schedule.phases[2], footholds={FOOT: at}, **changes)
    return replace(HOP, schedule=Schedule((*HOP.schedule.phases[:2], last)))


def refused(message: str, problem: Problem = HOP, **changes: object) -> None:
    with pytest.raises(InputError, match=message) as caught:
        replace(problem, **changes)
    assert "\n" not in str(caught.value)


def test_tolerances_are_those_of_a_check():
    assert (CONTACT_GAP, SOLE_TILT) == (FOOT_DRIFT, CHECKED_TILT)


@pytest.mark.parametrize(
    ("up", "what"), [(-0.2, "0.2 m below"), (2.0, "2 m above"), (0.0011, "0.0011 m above")]
)
def test_a_start_off_the_ground_is_refused(up, what):
    refused(
        f"initial_q has contact 'foot' {what} its ground; allowed: within 0.001 m, or a first phase without",
        initial_q=moved(HOP.initial_q, up),
    )


@pytest.mark.parametrize("up", [NEAR, -NEAR])
def test_a_start_within_what_a_check_allows_is_accepted(up):
    assert replace(HOP, initial_q=moved(HOP.initial_q, up))


def test_a_start_in_the_air_has_no_ground():
    falling = Schedule(HOP.schedule.phases[1:])
    assert replace(HOP, schedule=falling, initial_q=moved(HOP.initial_q, 2.0))


def test_a_start_is_judged_on_the_surface_of_its_phase():
    step = Surface(point=np.array([0.0, 0.0, 0.3]), normal=np.array([0.0, 0.0, 1.0]))
    first = replace(HOP.schedule.phases[0], surfaces={FOOT: step})
    higher = Schedule((first, *HOP.schedule.phases[1:]))
    refused("contact 'foot' 0.3 m below its ground", schedule=higher)
    assert replace(HOP, schedule=higher, initial_q=moved(HOP.initial_q, 0.3))


def test_a_tilted_sole_is_refused():
    """The body turns about the sole's centre, which stays on the ground."""
    problem = hop("surface")
    foot, turn = frame_pose(problem.robot, problem.initial_q, FOOT).translation, pin.utils.rotate("x", 0.02)
    q = problem.initial_q.copy()
    q[:3] = foot + turn @ (q[:3] - foot)
    q[3:7] = pin.Quaternion(turn).coeffs()
    refused(
        "initial_q has sole 'foot' tilted by 0.02 rad on its ground; allowed: up to 0.01",
        problem,
        initial_q=q,
    )


@pytest.mark.parametrize(("up", "side"), [(0.1, "above"), (-0.1, "below"), (1e-5, "above")])
def test_a_foothold_off_flat_ground_is_refused(up, side):
    with pytest.raises(
        InputError, match=f"foothold of 'foot' in phase 'landing' is {abs(up):g} m {side} its ground"
    ):
        landing(raised(up))
    assert landing(STANDS)


def test_a_foothold_is_judged_on_the_ground_there_is():
    high = replace(HOP, terrain=FlatGround(height=0.2), initial_q=moved(HOP.initial_q, 0.2))
    assert high.terrain.height == 0.2
    with pytest.raises(InputError, match=r"0\.2 m above its ground"):
        landing(raised(0.2))


def test_a_foothold_where_the_contact_does_not_stand_is_refused():
    first = replace(HOP.schedule.phases[0], footholds={FOOT: STANDS + np.array([0.3, 0.0, 0.0])})
    refused(
        "foothold of 'foot' in phase 'stance' is 0.3 m from where the contact stands already",
        schedule=Schedule((first, *HOP.schedule.phases[1:])),
    )


@pytest.mark.parametrize(("up", "what"), [(-0.2, "0.2 m below"), (0.1, "0.1 m above")])
def test_a_final_posture_off_the_ground_is_refused(up, what):
    goal = TerminalState(q=moved(HOP.initial_q, up))
    refused(f"q of terminal_state has contact 'foot' {what} its ground", terms=(goal,))
    assert replace(HOP, terms=(TerminalState(q=HOP.initial_q),))


def test_a_final_posture_beyond_the_limits_is_refused():
    arm = reach().robot
    limited = replace(arm, position_lower=np.array([-1.0]), position_upper=np.array([1.0]))
    goal = TerminalState(q=np.array([1.5]))
    refused(
        "in q of terminal_state joint 'joint' is at 1.5, beyond its position_limits; allowed: -1 to 1",
        reach(),
        robot=limited,
        terms=(goal, PositionLimits()),
    )
    assert replace(reach(), robot=limited, terms=(goal,))  # limits that no term imposes


JUMP = problems.load("solo12-jump")
TRUNK, PAW = "base_link", "FL_FOOT"
HIGH = np.array([0.0, 0.0, 5.0])


def with_term(term: Term) -> Problem:
    return replace(JUMP, terms=(term,))


def test_a_place_out_of_reach_of_standing_feet_is_refused():
    with pytest.raises(
        InputError, match=f"frame_pose has '{TRUNK}' and contact '{PAW}' .* apart; allowed: up"
    ):
        with_term(FramePose(frame=TRUNK, position=HIGH))


@pytest.mark.parametrize("phase", ["flight", "landing"])
def test_a_waypoint_is_judged_with_the_feet_that_stand_there(phase):
    """The node between stance and flight belongs to the flight, and the feet are still where they stood."""
    with pytest.raises(InputError, match=f"contact '{PAW}' .* apart"):
        with_term(FramePose(frame=TRUNK, position=HIGH, at=start_of(phase)))


@pytest.mark.parametrize(("height", "below"), [(5.0, False), (-5.0, True)])
def test_a_height_out_of_reach_of_standing_feet_is_refused(height, below):
    term = FrameHeight(frame=TRUNK, height=height, at=middle_of("landing"), below=below)
    with pytest.raises(InputError, match=f"frame_height has '{TRUNK}' and contact '{PAW}' .* apart"):
        with_term(term)
    assert with_term(replace(term, below=not below))
    assert with_term(replace(term, at=middle_of("flight")))  # nothing stands there


class OwnGoal(FramePose):
    """A goal of a user's own term, known by its targets."""

    def targets(self) -> tuple[Target, ...]:
        return (Target(frame=TRUNK, position=HIGH),)


def test_goals_of_a_users_terms_are_judged_by_their_targets():
    with pytest.raises(InputError, match=f"own_goal has '{TRUNK}' and contact '{PAW}'"):
        with_term(OwnGoal(frame=TRUNK, position=np.zeros(3)))
