"""Goals and energies of motions, against numpy and closed forms."""

import math
from dataclasses import dataclass, replace

import casadi as ca
import numpy as np
import pinocchio as pin
import pytest
from numpy.testing import assert_allclose
from scipy import sparse

from tests.support.goals import integral, objective, sampled, wandering, with_terms
from tests.support.problems import FOOT, REACH, hop, hopper, one_joint_arm, one_phase, reach
from tests.support.refusals import refused_calls
from tests.support.scenes import biped, push, usual
from tests.support.synthetic_motions import with_meta
from trajopt import InputError, Moment, Phase, Problem, Robot, Schedule, end_of, middle_of
from trajopt.motion import cost_of_transport, energy
from trajopt.reduced.scenes import smallest
from trajopt.robot import Drive, Units, frame_pose
from trajopt.solving.solving import prepare, solve
from trajopt.terms import (
    REST,
    AccelerationCost,
    CentreOfMassCost,
    Context,
    Cost,
    DistanceCost,
    FrameHeightCost,
    FramePose,
    FrameVelocity,
    PostureCost,
    PowerCost,
    TerminalRest,
    TerminalState,
    TimeCost,
    TorqueCost,
    TorqueLimits,
    TrackingCost,
    effort_costs,
    goal_terms,
)
from trajopt.terms.drives import heat_coefficients
from trajopt.terms.objectives import GOALS, REST_OF_LINEAR
from trajopt.terms.tracking import key_frames
from trajopt_library import problems
from trajopt_library.robots.ur5 import TOOL

# Central differences along a direction, step 1e-5, on values of order up to 1e3 in scaled units.
STEP = 1e-5
DIFFERENCES = {"rtol": 2e-6, "atol": 2e-6}
# Sums of the same numbers in another order.
ROUNDING = 1e-11
# Of two problems with other unknowns, solved to 1e-8.
SAME_OPTIMUM = 1e-5
# The solver's tolerance of 1e-6 on scaled rows and multipliers, with two orders for conditioning.
SOLVED = 1e-4
PUSH, THRUST_TIME = 25.0, 0.4  # N, s


def lift(mass: float = 2.0) -> Robot:
    """A mass on a vertical slider, with a motor of ``PUSH`` N."""
    model = pin.Model()
    model.name = "lift"
    joint = model.addJoint(0, pin.JointModelPZ(), pin.SE3.Identity(), "slider")
    model.appendBodyToJoint(joint, pin.Inertia.FromSphere(mass, 0.1), pin.SE3.Identity())
    model.addFrame(pin.Frame("top", joint, 0, pin.SE3(np.eye(3), np.array([0.0, 0.0, 0.1])), pin.OP_FRAME))
    robot = Robot.from_model(model, name="lift", reference=np.zeros(1))
    return replace(robot, torque_limit=np.array([PUSH]))


def thrust(*terms: object) -> Problem:
    """The mass from rest, pushed up for ``THRUST_TIME``."""
    given = {"initial_q": np.zeros(1), "guess": lambda t: np.zeros(1), "default_intervals": 8}
    return one_phase(lift(), *terms, TorqueLimits(), duration=THRUST_TIME, name="thrust", **given)


# Costs at nodes


def test_height_is_counted_at_the_middle_of_its_phase_and_distance_at_the_end():
    robot = hopper()
    problem = replace(hop(), guess=wandering(robot))
    direction = np.array([1.0, 2.0, 0.5])
    height = FrameHeightCost(weight=2.0, frame=FOOT, at=middle_of("flight"))
    distance = DistanceCost(weight=3.0, frame=FOOT, direction=tuple(direction))
    prepared = prepare(problem, intervals=6)
    layout = prepared.transcription.layout
    flight = layout.intervals_of(1)
    middle = layout.node_times[flight[0] + round(len(flight) / 2)]
    top = frame_pose(robot, problem.guess(middle), FOOT).translation[2]
    end = frame_pose(robot, problem.guess(problem.schedule.duration), FOOT).translation
    found = objective(with_terms(problem, height, distance))
    way = end @ direction / np.linalg.norm(direction)
    assert_allclose(found, -(2.0 * top + 3.0 * way) / robot.length, rtol=ROUNDING)


@pytest.mark.parametrize("goal", ["height", "distance"])
def test_highest_point_is_that_of_full_thrust(goal):
    costs = {
        "height": FrameHeightCost(weight=1.0, frame="top", at=end_of("thrust")),
        "distance": DistanceCost(weight=1.0, frame="top", direction=(0.0, 0.0, 1.0)),
    }
    solution = solve(thrust(costs[goal]))
    assert solution.converged
    acceleration = PUSH / 2.0 - 9.81
    assert_allclose(solution.q[-1], acceleration * THRUST_TIME**2 / 2, rtol=SOLVED)
    assert_allclose(solution.tau, PUSH, rtol=SOLVED)


def test_height_in_an_early_moment_is_not_that_of_the_end():
    early = FrameHeightCost(weight=1.0, frame="top", at=middle_of("thrust"))
    solution = solve(thrust(early, TorqueCost(weight=1e-6)))
    half = solution.t < THRUST_TIME / 2
    assert_allclose(solution.tau[half & solution.collocation], PUSH, rtol=1e-2)
    assert solution.tau[~half & solution.collocation].max() < PUSH / 2


# Derivatives


@pytest.mark.parametrize("name", ["hop", "arm"])
def test_derivatives_of_goals_agree_with_differences(name):
    problem, x, engine = _goals_problem(name)
    generator = np.random.default_rng(3)
    x = x + generator.normal(0.0, 0.02, x.shape)
    along = generator.normal(size=x.shape)
    after, before = x + STEP * along, x - STEP * along
    assert_allclose(
        engine.gradient(x) @ along, (engine.f(after) - engine.f(before)) / (2 * STEP), **DIFFERENCES
    )
    nlp = problem.nlp
    n, none = len(x), np.zeros(nlp.transcription.n_rows)
    lower = sparse.csr_matrix(
        (engine.hessian(x, 1.0, none), (nlp.hessian_row, nlp.hessian_column)), shape=(n, n)
    )
    hessian = lower + sparse.tril(lower, -1).T
    change = (np.asarray(engine.gradient(after)) - np.asarray(engine.gradient(before))) / (2 * STEP)
    assert_allclose(hessian @ along, change, **DIFFERENCES)


def _goals_problem(name: str):
    if name == "hop":
        robot = hopper()
        problem = with_terms(
            replace(hop(), guess=wandering(robot)),
            FrameHeightCost(weight=1.0, frame=FOOT, at=middle_of("flight")),
            DistanceCost(weight=1.0, frame=FOOT),
            PowerCost(weight=1.0),
            TrackingCost(weight=1.0, reference=lambda t: wandering(robot)(t + 1.0)),
        )
    else:
        arm = one_joint_arm(gravity=True)
        free = Schedule((Phase(name="reach", duration=0.8, duration_bounds=(0.4, 1.6)),))
        problem = with_terms(
            replace(reach(gravity=True), schedule=free),
            PowerCost(weight=1.0, recovered=0.2),
            TrackingCost(weight=1.0, reference=lambda t: arm.reference + t),
            TimeCost(weight=1.0),
        )
    prepared = prepare(problem, intervals=6)
    return prepared, prepared.guess, prepared.nlp.engine


# Named goals


def jump_goals(**changes: object):
    """What every goal needs on the small hopper."""
    schedule = Schedule(tuple(replace(phase, duration_bounds=(0.1, 1.0)) for phase in hop().schedule.phases))
    given = {"frame": FOOT, "travel": 0.3, "reference": wandering(hopper()), **changes}
    return schedule, given


@pytest.mark.parametrize("goal", GOALS)
def test_every_goal_is_its_term_and_a_rest_of_effort(goal):
    schedule, given = jump_goals()
    terms = goal_terms(goal, hopper(), schedule, **given)
    own = {
        "time": TimeCost, "height": FrameHeightCost, "distance": DistanceCost, "transport": PowerCost,
        "smooth": AccelerationCost, "track": TrackingCost, "effort": TorqueCost,
    }  # fmt: skip
    assert isinstance(terms[0], own[goal])
    share = {"effort": 1.0, "time": REST_OF_LINEAR, "height": REST_OF_LINEAR, "distance": REST_OF_LINEAR}
    rest = terms if goal == "effort" else terms[1:]
    expected = [share.get(goal, REST) * term.weight for term in effort_costs()]
    assert_allclose([term.weight for term in rest], expected, rtol=ROUNDING)


def test_transport_counts_cost_of_transport():
    robot = hopper()
    problem = replace(hop(), guess=wandering(robot))
    solution, x = sampled(problem)
    (cost, *_) = goal_terms("transport", robot, problem.schedule, travel=0.3)
    sharp = replace(cost, smoothing=1e-9)
    expected = energy(solution) / (robot.weight * 0.3)
    assert_allclose(objective(with_terms(problem, sharp), x), expected, rtol=1e-6)


def test_least_time_of_a_double_integrator_is_bang_bang():
    arm = one_joint_arm()
    inertia, torque = pin.crba(arm.model, arm.model.createData(), np.zeros(1))[0, 0], 3.0
    schedule = Schedule((Phase(name="reach", duration=0.8, duration_bounds=(0.1, 3.0)),))
    goal = np.array([REACH])
    problem = replace(
        reach(),
        schedule=schedule,
        terms=(
            *goal_terms("time", arm, schedule, effort=(AccelerationCost(weight=1.0),), rest=0.0),
            TorqueLimits(limit=np.array([torque])), TerminalState(q=goal), TerminalRest(q=goal),
        ),
    )  # fmt: skip
    solution = solve(problem, intervals=10)
    assert solution.converged
    assert_allclose(solution.meta["durations"], 2 * math.sqrt(REACH * inertia / torque), rtol=SOLVED)


# In a reduced problem


def push_with_goals(raised: float = 0.0) -> Problem:
    """The symmetric biped pushes, with goals of every kind; at last its left arm is to be ``raised``, rad."""
    robot, turn = biped(), np.zeros(biped().nv)
    turn[robot.model.joints[robot.model.getJointId("left_arm")].idx_v] = raised
    end = pin.integrate(robot.model, robot.reference, turn)
    reference = key_frames(robot, [0.0, 0.4], np.array([robot.reference, end]))
    goals = (
        FrameHeightCost(weight=0.05, frame="waist", at=middle_of("stance")),
        DistanceCost(weight=0.02, frame="waist"),
        TrackingCost(weight=1.0, reference=reference),
        PowerCost(weight=0.1),
    )
    terms = [term for term in usual(robot) if not isinstance(term, TerminalState | TerminalRest)]
    return push(robot, terms=(*terms, *goals))


@pytest.mark.long
def test_goals_of_half_a_robot_are_those_of_the_whole():
    problem = push_with_goals()
    made = smallest(problem, keep=("left_abduction", "right_abduction", "left_arm", "right_arm"), plane=True)
    assert made.report.is_exact
    whole, half = (solve(own, tolerance=1e-8) for own in (problem, made.problem))
    assert whole.converged
    assert half.converged
    assert_allclose(half.statistics.objective, whole.statistics.objective, rtol=SAME_OPTIMUM)


# Bad input


def test_bad_goals_are_refused_in_one_line():
    schedule, given = jump_goals()
    robot = hopper()
    for goal, missing, words in (
        ("height", "frame", "frame"), ("distance", "frame", "frame"), ("transport", "travel", "travel"),
        ("track", "reference", "reference"),
    ):  # fmt: skip
        with pytest.raises(InputError, match=words):
            goal_terms(goal, robot, schedule, **{**given, missing: None})
    with pytest.raises(InputError, match="duration_bounds"):
        goal_terms("time", robot, hop().schedule)
    with pytest.raises(InputError, match="without contacts"):
        goal_terms(
            "height", robot, Schedule((Phase(name="stand", duration=1.0, contacts=(FOOT,)),)), frame=FOOT
        )
    with pytest.raises(InputError, match="effort, time"):
        goal_terms("glory", robot, schedule)
    for travel in (0.0, -1.0, math.nan, math.inf):
        with pytest.raises(InputError, match="travel"):
            goal_terms("transport", robot, schedule, travel=travel)


@pytest.mark.parametrize(
    "make",
    [
        lambda: FrameHeightCost(weight=-1.0, frame=FOOT, at=middle_of("flight")),
        lambda: FrameHeightCost(weight=1.0, frame=FOOT, at=Moment("flight", 1.5)),
        lambda: DistanceCost(weight=math.nan, frame=FOOT),
        lambda: DistanceCost(weight=1.0, frame=FOOT, direction=(0.0, 0.0, 0.0)),
        lambda: PowerCost(weight=1.0, recovered=1.5),
        lambda: PowerCost(weight=1.0, smoothing=0.0),
        lambda: TrackingCost(weight=1.0, reference=lambda t: np.zeros(9), part="head"),
        lambda: key_frames(one_joint_arm(), [0.0, 0.0], np.zeros((2, 1))),
        lambda: key_frames(one_joint_arm(), [0.0], np.zeros((1, 1))),
        lambda: key_frames(one_joint_arm(), [0.0, 1.0], np.zeros((2, 3))),
        lambda: key_frames(one_joint_arm(), [0.0, 1.0], np.array([[0.0], [np.nan]])),
        lambda: key_frames(hopper(), [0.0, 1.0], np.zeros((2, 9))),
    ],
)
def test_bad_terms_are_refused(make):
    with pytest.raises(InputError):
        make()


@pytest.mark.parametrize(
    ("term", "message"),
    [
        (
            lambda: CentreOfMassCost(weight=1.0, path=lambda t: np.zeros(2)),
            "has 2 values at t = .* s; allowed: 3",
        ),
        (lambda: PostureCost(weight=1.0, joints=()), "no joints; allowed: some of "),
    ],
)
def test_a_path_in_a_plane_and_a_posture_of_no_joint_are_refused(term, message):
    with pytest.raises(InputError, match=message):
        prepare(reach(terms=(term(),)), intervals=6)


@pytest.mark.parametrize(
    "reference", [lambda t: np.zeros(3), lambda t: np.full(1, np.nan if t > 0.5 else 0.0)]
)
def test_a_reference_of_another_robot_or_with_gaps_is_refused(reference):
    with pytest.raises(InputError):
        prepare(reach(terms=(TrackingCost(weight=1.0, reference=reference),)), intervals=6)


test_goals_without_a_mirror_or_phase_are_refused = refused_calls(
    (lambda: smallest(push_with_goals(raised=0.5), plane=True), "tracking_cost"),
    (lambda: with_terms(hop(), FrameHeightCost(weight=1.0, frame=FOOT, at=middle_of("flihgt"))), "flihgt"),
)


# Ten times the solver's default tolerance on rows of about a metre and a metre per second.
REACHED = 1e-5


def test_tool_passes_its_goal_with_the_velocity_asked():
    velocity = np.array([0.2, -0.1, 0.05, 0.0, 0.3, 0.0])
    reach = problems.load("ur5-reach")
    kept = tuple(term for term in reach.terms if not isinstance(term, TerminalRest))
    solution = solve(
        replace(reach, terms=(*kept, FrameVelocity(frame=TOOL, velocity=velocity))), intervals=15
    )
    assert solution.converged
    model, data = reach.robot.model, reach.robot.model.createData()
    pin.forwardKinematics(model, data, solution.q[-1], solution.v[-1])
    frame = model.getFrameId(TOOL)
    reached = pin.getFrameVelocity(model, data, frame, pin.LOCAL_WORLD_ALIGNED).vector
    assert_allclose(reached, velocity, atol=REACHED)
    (goal,) = [term for term in reach.terms if isinstance(term, FramePose)]
    pose = pin.updateFramePlacement(model, data, frame)
    assert_allclose(pose.translation, goal.position, atol=REACHED)
    assert_allclose(pin.log3(goal.rotation.T @ pose.rotation), np.zeros(3), atol=REACHED)


@pytest.mark.parametrize("recovered", [-1.0, 0.0, 0.4])
def test_power_cost_is_the_integral_of_what_joints_draw(recovered):
    robot, s = hopper(), 0.05
    problem = replace(hop(), guess=wandering(robot))
    solution, x = sampled(problem)
    unit = Units(robot)
    power = solution.tau * solution.v[:, 6:] * unit.time / unit.torque
    drawn = (1 + recovered) / 2 * power + (1 - recovered) / 2 * (np.sqrt(power**2 + s**2) - s)
    expected = 2.0 * integral(solution, drawn.sum(axis=1)) / unit.time
    cost = PowerCost(weight=2.0, recovered=recovered, smoothing=s)
    assert_allclose(objective(with_terms(problem, cost), x), expected, rtol=ROUNDING)


def test_energy_of_a_motion_between_rests_is_twice_its_largest_kinetic_energy():
    solution = solve(reach(), intervals=40)
    inertia = pin.crba(solution.model, solution.model.createData(), solution.q[0])[0, 0]
    largest = inertia * np.abs(solution.v).max() ** 2 / 2
    assert_allclose(energy(solution, recovered=0.0), largest, rtol=1e-3)
    assert_allclose(energy(solution), 2 * largest, rtol=1e-3)
    assert_allclose(energy(solution, recovered=1.0), 0.0, atol=1e-6 * largest)
    assert cost_of_transport(solution) == math.inf  # an arm goes nowhere


def test_heat_is_that_of_the_windings():
    resistance, constant, ratio = 0.5, 0.08, -9.0
    drive = Drive.from_motor(gear_ratio=ratio, voltage=24.0, resistance=resistance, torque_constant=constant)
    (found,) = heat_coefficients((drive,), 1)
    torque = 3.0
    current = torque / ratio / constant
    assert_allclose(found * torque**2, resistance * current**2, rtol=ROUNDING)
    assert_allclose(heat_coefficients((None, Drive(gear_ratio=9.0)), 2), 0.0)
    assert_allclose(heat_coefficients(None, 3), np.zeros(3))


def test_drives_heat_is_in_the_cost_and_in_the_energy():
    drive = Drive.from_motor(gear_ratio=9.0, voltage=48.0, resistance=0.5, torque_constant=0.08)
    robot = one_joint_arm(gravity=True).with_drives((drive,))
    problem = replace(reach(gravity=True), robot=robot)
    solution, x = sampled(problem)
    heat = integral(solution, (solution.tau[:, 0] / 9.0 / 0.08) ** 2 * 0.5)
    bare = with_meta(solution, drives=None)
    assert_allclose(energy(solution) - energy(bare), heat, rtol=ROUNDING)
    unit = Units(robot)
    only = with_terms(problem, PowerCost(weight=1.0, recovered=1.0))
    expected = energy(solution, recovered=1.0) / (unit.force * unit.length)
    assert_allclose(objective(only, x), expected, rtol=ROUNDING)


@dataclass(frozen=True, kw_only=True)
class Rates(Cost):
    """The mean square of the rates, by its residual."""

    def residual(self, context: Context, units: Units) -> ca.SX:
        return context.v * units.time


@dataclass(frozen=True, kw_only=True)
class OwnRates(Cost):
    """The same by its value alone."""

    def value(self, context: Context, units: Units) -> ca.SX:
        return context.parameter(self.weight) * ca.sumsqr(context.v * units.time) / context.robot.nv


def test_a_cost_may_have_a_value_alone() -> None:
    _, x = sampled(reach(gravity=True))
    values = [objective(with_terms(reach(gravity=True), kind(weight=2.0)), x) for kind in (Rates, OwnRates)]
    assert values[0] > 0
    assert_allclose(values[1], values[0], rtol=ROUNDING)


def test_cost_of_transport_is_energy_over_weight_and_way():
    robot = hopper()
    solution, _ = sampled(replace(hop(), guess=wandering(robot)))
    model, data = robot.model, robot.model.createData()
    ends = [pin.centerOfMass(model, data, q).copy() for q in solution.q[[0, -1]]]
    way = np.linalg.norm((ends[1] - ends[0])[:2])
    drawn = integral(solution, np.abs(solution.tau * solution.v[:, 6:]).sum(axis=1))
    assert_allclose(cost_of_transport(solution), drawn / robot.weight / way, rtol=ROUNDING)
    still = replace(solution, q=np.tile(solution.q[0], (solution.n_samples, 1)))
    assert cost_of_transport(still) == math.inf
