"""Contacts that switch at once, single intervals, repeated contacts; singular postures."""

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from numpy.testing import assert_allclose

from tests.extremes.moves import legged, lowered, pose_goal, reach, stance, steps, with_joints
from tests.extremes.outcomes import Failed, Refused, Solved, assert_outcome, in_process
from tests.support.problems import hopper
from trajopt import Contact, FlatGround, Phase, Problem, Robot, Schedule, diagnose, terms
from trajopt.dynamics import contact_jacobian
from trajopt.robot import contact_positions
from trajopt.schedule import footholds_at
from trajopt.solvers.drivers import SOLVERS
from trajopt.solvers.status import Status
from trajopt.solving.solving import solve
from trajopt_library import robots

pytestmark = pytest.mark.long

# Open-loop error of phases of 0.05 to 0.2 s on three intervals each, over the robot's length or rad; measured
# up to 2.3e-3.
STEP = 1e-2
# Of standing still for 0.4 s, measured up to 1.2e-4.
STILL = 1e-3
# Forces of two ways to write the same contact, over the weight: what solvers leave.
SAME = 1e-4
CAUSE = "depend on each other there"

FL, FR, HL, HR = SOLO = ("FL_FOOT", "FR_FOOT", "HL_FOOT", "HR_FOOT")
DIAGONALS = ((FL, HR), (FR, HL))

# Contacts of each phase, and a phase's duration, s.
SWITCHES = {
    "a foot lifts and lands where it was": ((SOLO, (FR, HL, HR), SOLO), 0.2),
    "one lands as another lifts": ((SOLO, (FL, FR, HL), (FL, FR, HR), SOLO), 0.15),
    "one diagonal lands as the other lifts": ((SOLO, *DIAGONALS, SOLO), 0.2),
    "all four swap each time": ((*DIAGONALS, *DIAGONALS), 0.2),
    "the front lands as the back lifts": ((SOLO, (HL, HR), (FL, FR), SOLO), 0.1),
    "three land as the last one lifts": ((SOLO, (FL,), (FR, HL, HR), SOLO), 0.06),
}


@pytest.mark.parametrize("what", SWITCHES)
def test_contacts_switch_at_once(what):
    sets, duration = SWITCHES[what]
    height = min(0.02, 0.2 * duration)
    make = lambda: steps(robots.load("solo12"), sets, duration=duration, clearance=height)  # noqa: E731
    solution = assert_outcome(Solved(STEP), make, intervals=3 * len(sets))
    steps_of_feet = np.abs(np.diff(solution.q[:, :3], axis=0)).max()
    assert steps_of_feet < 0.05  # m: nothing jumps


@pytest.mark.parametrize("solver", SOLVERS)
def test_every_solver_swaps_diagonals_at_once(solver):
    sets = SWITCHES["one diagonal lands as the other lifts"][0]
    assert_outcome(Solved(STEP), lambda: steps(robots.load("solo12"), sets), intervals=12, solver=solver)


def test_a_larger_quadruped_swaps_diagonals_at_once():
    feet = [contact.name for contact in robots.load("go2").contacts]
    sets = (feet, (feet[0], feet[3]), (feet[1], feet[2]), feet)
    assert_outcome(Solved(STEP), lambda: steps(robots.load("go2"), sets), intervals=12)


def test_contacts_land_by_an_impact_as_others_lift():
    sets = SWITCHES["one diagonal lands as the other lifts"][0]
    assert_outcome(Solved(STEP), lambda: steps(robots.load("solo12"), sets, impact=True), intervals=12)


def test_a_swing_without_foothold_lands_anywhere():
    sets = SWITCHES["a foot lifts and lands where it was"][0]
    make = lambda: steps(robots.load("solo12"), sets, footholds=False)  # noqa: E731
    assert_outcome(Solved(STEP), make, intervals=9)


# One interval a phase


@pytest.mark.parametrize("scheme", ["legendre:2", "hermite-simpson"])
def test_a_phase_of_one_interval_is_enough(scheme):
    sets = (SOLO, *DIAGONALS, SOLO)
    make = lambda: steps(robots.load("solo12"), sets, duration=0.1, clearance=0.0)  # noqa: E731
    assert_outcome(Solved(STEP), make, transcription=scheme, intervals=4)


def test_one_interval_of_degree_one_says_too_much_of_a_swing():
    """A constant acceleration cannot lift a foot and put it down at rest: nine rows for it, all zero, three
    unknowns."""
    sets = (SOLO, *DIAGONALS, SOLO)
    make = lambda: steps(robots.load("solo12"), sets, duration=0.1, clearance=0.0)  # noqa: E731
    failed = Failed(Status.ITERATION_LIMIT, Status.STEP_FAILED, advice=CAUSE)
    solution = assert_outcome(failed, make, transcription="legendre:1", intervals=4, max_iterations=60)
    found = in_process(lambda: str(diagnose(solution, make())))
    assert "contact_landing" in found


def test_fewer_intervals_than_phases_are_refused():
    make = lambda: steps(robots.load("solo12"), (SOLO, *DIAGONALS, SOLO))  # noqa: E731
    assert_outcome(Refused("3 intervals for 4 phases"), make, intervals=3)


@pytest.mark.parametrize("brief", [1e-3, 1e-4])
def test_a_very_short_phase_is_solved(brief):
    """Between two stances a diagonal is off the ground for no time at all."""
    robot = robots.load("solo12")
    places = footholds_at(robot, robot.reference)
    phases = (
        Phase(name="before", duration=0.2, contacts=SOLO),
        Phase(name="blink", duration=brief, contacts=DIAGONALS[0]),
        Phase(
            name="after", duration=0.2, contacts=SOLO, footholds={name: places[name] for name in DIAGONALS[1]}
        ),
    )
    q = robot.reference
    assert_outcome(Solved(STEP), lambda: legged(robot, Schedule(phases), q, q, lambda t: q), intervals=7)


# Contacts that repeat each other


def corners(count: int) -> Robot:
    """The hopper with a foot of that many corners (of four), or of the whole sole for none, at its ankle."""
    sole = hopper("surface")
    model, foot = sole.model.copy(), sole.model.frames[sole.model.getFrameId("foot")]
    names = []
    for x, y in ((-0.08, -0.05), (-0.08, 0.05), (0.08, -0.05), (0.08, 0.05))[:count]:
        names.append(f"corner{len(names)}")
        place = foot.placement * pin.SE3(np.eye(3), np.array([x, y, 0.0]))
        model.addFrame(pin.Frame(names[-1], foot.parentJoint, 0, place, pin.FrameType.OP_FRAME))
    return replace(sole, model=model, contacts=tuple(Contact(frame=name) for name in names))


def standing_hopper(robot: Robot, names: tuple[str, ...] | None = None, wrench: float = 1e-2) -> Problem:
    """At rest on its contacts, or those named, and at rest at the end."""
    q, every = robot.reference, tuple(contact.name for contact in robot.contacts)
    return Problem(
        name="standing",
        robot=robot,
        schedule=Schedule((Phase(name="stance", duration=0.4, contacts=names or every),)),
        terrain=FlatGround(friction=0.7),
        initial_q=q,
        terms=(
            terms.TorqueCost(weight=1.0),
            terms.PostureCost(weight=1.0),
            *((terms.WrenchCost(weight=wrench),) if wrench else ()),
            terms.TorqueLimits(),
            terms.FrictionPyramid(),
            terms.TerminalState(q=q),
            terms.TerminalRest(q=q),
        ),
        guess=lambda t: q,
    )


def total_force(solution) -> np.ndarray:  # type: ignore[no-untyped-def]
    return solution.f[:, :, :3].sum(axis=1)


@pytest.mark.parametrize("wrench", [1e-2, 0.0], ids=["forces have a price", "forces have none"])
def test_a_foot_of_four_corners_stands_still(wrench):
    """Twelve rows of rank six, and forces that no row tells apart."""
    robot = corners(4)
    places = [(contact.frame, contact.rows) for contact in robot.contacts]
    assert np.linalg.matrix_rank(contact_jacobian(robot.model, robot.reference, places)) == 6
    solution = assert_outcome(Solved(STILL), lambda: standing_hopper(robot, wrench=wrench), intervals=6)
    assert len(solution.statistics.redundant_contact_rows["stance"]) == 6
    assert_allclose(total_force(solution)[solution.collocation].mean(axis=0)[2], robot.weight, rtol=1e-2)


def test_two_point_contacts_leave_the_rotation_about_their_line():
    """Six rows of rank five; the foot tips about its edge, as nothing holds it."""
    robot = corners(4)
    names = ("corner0", "corner1")
    problem = standing_hopper(robot, names)
    costs = (terms.TorqueCost(weight=1.0), terms.AccelerationCost(weight=1e-2), terms.WrenchCost(weight=1e-2))
    schedule = Schedule((Phase(name="stance", duration=0.1, contacts=names),))
    solution = assert_outcome(
        Solved(STILL), lambda: replace(problem, schedule=schedule, terms=costs), intervals=6
    )
    assert solution.statistics.redundant_contact_rows == {"stance": ["corner1 y"]}


def test_four_coplanar_feet_at_rest_keep_all_their_rows():
    robot = robots.load("solo12")
    solution = assert_outcome(
        Solved(STILL), lambda: stance(robot, robot.reference), transcription="legendre:3"
    )
    assert solution.statistics.redundant_contact_rows == {}
    assert_allclose(solution.q, np.tile(robot.reference, (len(solution.t), 1)), atol=5e-2)


def repeated(robot: Robot) -> Robot:
    """The robot with its first contact a second time, under another name."""
    return replace(robot, contacts=(*robot.contacts, replace(robot.contacts[0], name="again")))


def test_a_contact_given_twice_shares_its_force():
    robot = robots.load("solo12")
    twice = assert_outcome(Solved(STILL), lambda: stance(repeated(robot), robot.reference, intervals=6))
    once = assert_outcome(Solved(STILL), lambda: stance(robot, robot.reference, intervals=6))
    assert twice.statistics.redundant_contact_rows == {"stance": ["again x", "again y", "again z"]}
    assert_allclose(total_force(twice), total_force(once), atol=1e-2 * robot.weight)
    shared = twice.f[:, [0, 4], :3]
    assert_allclose(shared[:, 0], shared[:, 1], atol=SAME * robot.weight)


def test_a_contact_given_twice_lands_once():
    robot = repeated(robots.load("solo12"))
    names = tuple(contact.name for contact in robot.contacts)
    sets = (names, (FR, HL, HR), names)
    make = lambda: steps(robot, sets, duration=0.15)  # noqa: E731
    solution = assert_outcome(Solved(STEP), make, intervals=9)
    assert solution.statistics.redundant_contact_rows["phase 2"] == ["again x", "again y", "again z"]


def test_a_point_within_a_sole_adds_nothing():
    robot = hopper("surface")
    both = replace(robot, contacts=(*robot.contacts, Contact(frame="foot", name="point")))
    problem = standing_hopper(both)
    all_terms = tuple(term for term in problem.terms if not isinstance(term, terms.FrictionPyramid))
    solution = assert_outcome(Solved(STILL), lambda: replace(problem, terms=all_terms), intervals=6)
    assert solution.statistics.redundant_contact_rows == {"stance": ["point x", "point y", "point z"]}


def test_two_contacts_of_one_name_and_one_named_twice_are_refused():
    robot = robots.load("solo12")
    assert_outcome(
        Refused("two contacts named"), lambda: replace(robot, contacts=(*robot.contacts, robot.contacts[0]))
    )
    assert_outcome(Refused("names a contact twice"), lambda: steps(robot, ((FL, FL),)))


def test_a_foothold_further_than_the_links_is_refused():
    """Two feet that stand at once are never further apart than all links between them."""
    robot = robots.load("solo12")
    place = footholds_at(robot, robot.reference)[FL] + [2.0, 0.0, 0.0]
    phases = (
        Phase(name="before", duration=0.2, contacts=(FR, HL, HR)),
        Phase(name="after", duration=0.2, contacts=SOLO, footholds={FL: place}),
    )
    problem = stance(robot, robot.reference)
    endless = tuple(term for term in problem.terms if not term.name.startswith("terminal"))
    refused = Refused(r"'FL_FOOT' and '\w+' stand in phase 'after' .* apart; allowed: up to")
    assert_outcome(refused, lambda: replace(problem, schedule=Schedule(phases), terms=endless))


def test_the_longest_stretch_of_two_feet_is_allowed():
    """The bound is no lower than what postures reach: legs spread along one line."""
    robot = robots.load("solo12")
    spread = with_joints(
        robot, {f"{leg}_HFE": -np.pi / 2 if leg[0] == "F" else np.pi / 2 for leg in ("FL", "HL")}
        | {f"{leg}_KFE": 0.0 for leg in ("FL", "HL")},
    )  # fmt: skip
    height = contact_positions(robot, spread)[FL][2] - robot.contact(FL).radius
    spread[2] -= height  # on the two legs that are spread
    places = footholds_at(robot, spread)
    assert np.linalg.norm(places[FL] - places[HL]) > 0.9
    problem = stance(robot, robot.reference)
    endless = tuple(term for term in problem.terms if not term.name.startswith("terminal"))
    phase = Phase(name="spread", duration=0.2, contacts=(FL, HL))
    assert replace(problem, schedule=Schedule((phase,)), terms=endless, initial_q=spread).robot is robot


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
