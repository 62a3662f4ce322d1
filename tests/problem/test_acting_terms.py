"""Terms that could not act, and places that no motion can have, are refused when the problem is built."""

import inspect
from dataclasses import dataclass, fields, replace

import casadi as ca
import numpy as np
import pinocchio as pin
import pytest
from typing_extensions import override

import trajopt.terms
from tests.support.problems import FOOT, hop, reach
from tests.support.refusals import refusals, refused_calls
from trajopt import FlatGround, InputError, Problem, Schedule, middle_of, start_of, terms
from trajopt.certify.report import FOOT_DRIFT
from trajopt.certify.report import SOLE_TILT as CHECKED_TILT
from trajopt.problem.places import CONTACT_GAP, SOLE_TILT
from trajopt.problem.validation import NAMES
from trajopt.robot import Units, contact_positions, frame_pose
from trajopt.schedule import Target
from trajopt.terms.tracking import key_frames
from trajopt.terrain import Surface
from trajopt_library import problems

HOP = hop()
PHASES = HOP.schedule.names
STILL = np.zeros(6)


def with_term(term: terms.Term):
    return replace(HOP, terms=(*HOP.terms, term))


UNKNOWN = {
    "phases": (terms.TorqueCost(weight=1.0, during="Stance"), "torque_cost names phase 'Stance'", "stance"),
    "waypoint": (
        terms.FramePose(frame=FOOT, position=[0, 0, 1], at=start_of("fligth")),
        "phase 'fligth'",
        "flight",
    ),
    "velocity": (terms.FrameVelocity(frame=FOOT, velocity=STILL, at=start_of("fly")), "phase 'fly'", None),
    "moment": (
        terms.FrameHeight(frame=FOOT, height=0.1, at=middle_of("Flight")),
        "frame_height names phase",
        "flight",
    ),
    "direction": (
        terms.FrameDirection(frame=FOOT, axis=(0, 0, 1), direction=(0, 0, 1), angle=0.1, at=middle_of("up")),
        "phase 'up'",
        None,
    ),
    "cost": (
        terms.FrameHeightCost(weight=1.0, frame=FOOT, at=middle_of("flights")),
        "phase 'flights'",
        "flight",
    ),
    "frame": (terms.FramePose(frame="fot", position=[0, 0, 1]), "frame_pose names frame 'fot'", FOOT),
    "frames": (terms.FramesAbove(frames=(FOOT, "knees"), height=0.0), "frame 'knees'", None),
    "contact": (terms.FrictionCone(contacts=("Foot",)), "friction_cone names contact 'Foot'", FOOT),
    "force": (terms.NormalForce(contact="heel", lower=1.0), "normal_force names contact 'heel'", None),
}


@pytest.mark.parametrize("case", UNKNOWN)
def test_an_unknown_name_is_refused_with_the_one_that_may_be_meant(case):
    term, what, meant = UNKNOWN[case]
    with pytest.raises(InputError) as caught:
        with_term(term)
    message = str(caught.value)
    assert what in message
    assert "which does not exist" in message
    assert "allowed: " in message
    assert meant is None or f"did you mean {meant}?" in message
    assert "\n" not in message


@pytest.mark.parametrize("at", ["flight", None, 0.5, ("flight", 0.5)])
def test_a_moment_is_made_by_a_function(at):
    with pytest.raises(
        InputError, match=r"^at of FrameHeight is .*; allowed: a Moment, for example start_of"
    ):
        terms.FrameHeight(frame=FOOT, height=0.1, at=at)


def test_a_moment_is_in_one_phase():
    term = terms.FrameHeight(frame=FOOT, height=0.1, at=middle_of("flight"))
    assert [name for name in PHASES if term.acts_in(name)] == ["flight"]


@pytest.mark.parametrize("phases", [(), "", 3])
def test_phases_are_names(phases):
    with pytest.raises(InputError, match=r"allowed: (a name, or a sequence|the name of a phase)"):
        with_term(terms.TorqueCost(weight=1.0, during=phases))


@pytest.mark.parametrize("phases", ["stance", ("stance",), ["stance"]])
def test_one_phase_is_a_name_or_a_sequence(phases):
    assert [name for name in PHASES if terms.TorqueCost(weight=1.0, during=phases).acts_in(name)] == [
        "stance"
    ]


@pytest.mark.parametrize(
    "term",
    [
        terms.NormalForce(contact=FOOT, lower=1.0, during="flight"),
        terms.FrictionCone(contacts=(FOOT,), during="flight"),
    ],
)
def test_a_contact_that_is_inactive_wherever_the_term_acts_is_refused(term):
    with pytest.raises(
        InputError, match="active in none of the phases flight; it is active in stance, landing"
    ):
        with_term(term)


NO_SWING = terms.SwingClearance(height=0.1, terrain=FlatGround())
test_a_term_without_anything_to_act_on_is_refused = refusals(
    lambda term: with_term(term),
    (terms.ImpulseCost(weight=1.0, during="landing"), "no impact begins phases landing"),
    (terms.WrenchCost(weight=1.0, during="flight"), "no contact is active in phases flight"),
    (terms.FrictionPyramid(during="flight"), "no contact is active in phases flight"),
    (terms.SoleCone(contacts=(FOOT,)), "'foot' is a point contact"),
    (terms.FrictionCone(contacts=()), "contacts is empty"),
    (
        terms.SwingClearance(height=0.1, terrain=FlatGround(), during=("stance", "landing")),
        "no contact is in the air in phases stance, landing",
    ),
    (
        terms.TrackingCost(weight=1.0, reference=key_frames(HOP.robot, [0.8, 1.0], [HOP.initial_q] * 2)),
        "its key frames are from 0.8 to 1 s, outside the schedule of 0.8 s",
    ),
)


@pytest.mark.parametrize("term", [terms.ImpulseCost(weight=1.0), NO_SWING, terms.SoleCone()])
def test_a_term_that_names_nothing_may_find_nothing(term):
    """Terms that are used for many schedules and robots need no change for one without impacts or swings."""
    stance = replace(HOP.schedule, phases=HOP.schedule.phases[:1])
    assert replace(HOP, schedule=stance, terms=(term,)).terms == (term,)


def test_key_frames_that_meet_the_schedule_are_accepted():
    frames = key_frames(HOP.robot, [-1.0, 0.1], [HOP.initial_q] * 2)
    assert with_term(terms.TrackingCost(weight=1.0, reference=frames))


def test_a_posture_is_over_a_contact_that_is_active_at_the_end():
    ends = replace(HOP.schedule, phases=HOP.schedule.phases[:2])
    with pytest.raises(InputError, match="'foot' is not active in phase 'flight'"):
        replace(HOP, schedule=ends, terms=(terms.TerminalPosture(q=HOP.initial_q, over=FOOT),))


def test_arcs_of_a_schedule_without_swings_over_phases_are_accepted():
    """The one swing of the hop lies within a phase: the term between phases has no node."""
    arcs = terms.swing_arcs(HOP.schedule, (FOOT,), height=0.05, terrain=FlatGround())
    assert replace(HOP, terms=arcs).terms == arcs


def test_arcs_of_another_schedule_are_refused():
    arc, _ = terms.swing_arcs(HOP.schedule, (FOOT,), height=0.05, terrain=FlatGround())
    with pytest.raises(InputError, match="its swings are in phase 'Flight', which does not exist"):
        with_term(replace(arc, parts={"Flight": arc.parts["flight"]}))


@dataclass(frozen=True, kw_only=True)
class OwnCost(terms.Cost):
    """A term of a user, with names of its own."""

    frame: str
    contacts: tuple[str, ...] = ()

    @override
    def residual(self, context: terms.Context, units: Units) -> ca.SX:
        return context.frame(self.frame).position


def test_the_terms_of_a_user_are_judged_by_the_same_check():
    assert with_term(OwnCost(weight=1.0, frame=FOOT, contacts=(FOOT,)))
    with pytest.raises(InputError, match="own_cost names frame 'feet'"):
        with_term(OwnCost(weight=1.0, frame="feet"))
    with pytest.raises(InputError, match="own_cost names contact 'feet'"):
        with_term(OwnCost(weight=1.0, frame=FOOT, contacts=("feet",)))


@dataclass(frozen=True, kw_only=True)
class OwnWaypoint(terms.DuringPhases, terms.NodeConstraint):
    """A term of a user that acts at one fraction of a phase, or ignores its phases."""

    where: str = ""

    @override
    def acts_at(self, place: terms.NodePlace) -> bool:
        return place.index == 0 and place.phase.name == (self.where or PHASES[1])

    @override
    def rows(self, context: terms.Context, units: Units, place: terms.NodePlace) -> terms.Rows:
        return terms.Rows.create(context.frame(FOOT).position[2], 0.0, 1.0, units.length)


def test_nodes_of_a_users_term_are_found_by_asking_it():
    assert with_term(OwnWaypoint())
    with pytest.raises(InputError, match="own_waypoint acts at no node of any phase"):
        with_term(OwnWaypoint(where="Flight"))
    with pytest.raises(InputError, match="which this term does not use"):
        with_term(OwnWaypoint(during=(PHASES[1],)))


@dataclass(frozen=True, kw_only=True)
class OwnLanding(OwnWaypoint):
    """A term of a user that acts where its phases begin, if they begin with a contact."""

    @override
    def acts_at(self, place: terms.NodePlace) -> bool:
        return place.index == 0 and self.acts_in(place.phase.name) and FOOT in place.phase.contacts


def test_a_phase_without_a_node_of_the_term_is_named():
    assert with_term(OwnLanding(during=("stance", "landing")))
    with pytest.raises(InputError, match="own_landing acts at no node of phase 'flight'"):
        with_term(OwnLanding(during=("stance", "flight")))


def test_every_term_holds_names_in_fields_that_the_check_knows():
    """A field such as ``at_phase`` or ``link`` would escape the check."""
    known = set(NAMES)
    for name in dir(trajopt.terms):
        term = getattr(trajopt.terms, name)
        if inspect.isclass(term) and issubclass(term, terms.Term) and not inspect.isabstract(term):
            odd = {
                f.name for f in fields(term) if any(word in f.name for word in ("phase", "contact", "frame"))
            }
            assert odd - known <= {"between_phases"}, name


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
    goal = terms.TerminalState(q=moved(HOP.initial_q, up))
    refused(f"q of terminal_state has contact 'foot' {what} its ground", terms=(goal,))
    assert replace(HOP, terms=(terms.TerminalState(q=HOP.initial_q),))


def test_a_final_posture_beyond_the_limits_is_refused():
    arm = reach().robot
    limited = replace(arm, position_lower=np.array([-1.0]), position_upper=np.array([1.0]))
    goal = terms.TerminalState(q=np.array([1.5]))
    refused(
        "in q of terminal_state joint 'joint' is at 1.5, beyond its position_limits; allowed: -1 to 1",
        reach(),
        robot=limited,
        terms=(goal, terms.PositionLimits()),
    )
    assert replace(reach(), robot=limited, terms=(goal,))  # limits that no term imposes


JUMP = problems.load("solo12-jump")
TRUNK, PAW = "base_link", "FL_FOOT"
HIGH = np.array([0.0, 0.0, 5.0])


def jump_with(term: terms.Term) -> Problem:
    return replace(JUMP, terms=(term,))


@pytest.mark.parametrize("phase", ["flight", "landing"])
def test_a_waypoint_is_judged_with_the_feet_that_stand_there(phase):
    """The node between stance and flight belongs to the flight, and the feet are still where they stood."""
    with pytest.raises(InputError, match=f"contact '{PAW}' .* apart"):
        jump_with(terms.FramePose(frame=TRUNK, position=HIGH, at=start_of(phase)))


@pytest.mark.parametrize(("height", "below"), [(5.0, False), (-5.0, True)])
def test_a_height_out_of_reach_of_standing_feet_is_refused(height, below):
    term = terms.FrameHeight(frame=TRUNK, height=height, at=middle_of("landing"), below=below)
    with pytest.raises(InputError, match=f"frame_height has '{TRUNK}' and contact '{PAW}' .* apart"):
        jump_with(term)
    assert jump_with(replace(term, below=not below))
    assert jump_with(replace(term, at=middle_of("flight")))  # nothing stands there


class OwnGoal(terms.FramePose):
    """A goal of a user's own term, known by its targets."""

    def targets(self) -> tuple[Target, ...]:
        return (Target(frame=TRUNK, position=HIGH),)


test_terms_with_wrong_arguments_or_goals_are_refused = refused_calls(
    (
        lambda: terms.FrameHeight(frame=FOOT, hight=1.0, at=middle_of("stance")),
        r"^FrameHeight has no argument 'hight'; did you mean height\? allowed: ",
    ),
    (
        lambda: terms.goal_terms("height", HOP.robot, HOP.schedule, phase="up"),
        r"^goal_terms has no argument 'phase'; .*allowed: goal, robot, ",
    ),
    (
        lambda: reach(terms=(terms.TrackingCost(weight=1.0, reference=lambda t: np.zeros(1), part="base"),)),
        "robot 'arm' is fixed to the world",
    ),
    (lambda: terms.FramePose(frame=FOOT), "frame_pose of 'foot' has no goal; allowed: position"),
    (
        lambda: jump_with(terms.FramePose(frame=TRUNK, position=HIGH)),
        f"frame_pose has '{TRUNK}' and contact '{PAW}' .* apart; allowed: up",
    ),
    (
        lambda: jump_with(OwnGoal(frame=TRUNK, position=np.zeros(3))),
        f"own_goal has '{TRUNK}' and contact '{PAW}'",
    ),
)
