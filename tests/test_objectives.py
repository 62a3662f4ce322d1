"""Goals of motions: node costs, power, tracking, and the named goals, against numpy and closed forms."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from numpy.testing import assert_allclose
from problems_for_tests import FOOT, REACH, REACH_TIME, hop, hopper, one_joint_arm, reach
from scenes_for_tests import biped, push, usual
from scipy import sparse

import robots
from trajopt.actuators.drive import Drive
from trajopt.errors import InputError
from trajopt.extraction import extract
from trajopt.kinematics import frame_pose
from trajopt.node_costs import DistanceCost, FrameHeightCost, NodeCost
from trajopt.node_terms import TerminalRest, TerminalState
from trajopt.objectives import GOALS, REST, REST_OF_LINEAR, effort_costs, goal_terms
from trajopt.power import PowerCost, cost_of_transport, energy, heat_coefficients
from trajopt.problem import Problem
from trajopt.reduced.foot_motion import smooth_step
from trajopt.robot import Robot
from trajopt.scenes import smallest
from trajopt.schedule import FlatGround, Phase, Schedule
from trajopt.schemes import scheme
from trajopt.solution import Solution
from trajopt.solving import prepare, solve
from trajopt.term_interfaces import Cost
from trajopt.terms import AccelerationCost, EffortLimits, TimeCost, TorqueCost
from trajopt.tracking import TrackingCost, key_frames, solution_motion
from trajopt.units import Units

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
# The base quaternion of a free-flyer with the other sign.
AHEAD = np.array([1.0] + [0.0] * 8)
SIGNS = np.array([1.0] * 3 + [-1.0] * 4 + [1.0] * 2)


def objective(problem: Problem, x: np.ndarray | None = None, **settings: object) -> float:
    """The NLP's objective at its guess, or at scaled unknowns."""
    prepared = prepare(problem, intervals=6, compile="none", **settings)
    return float(prepared.nlp.engine.f(prepared.guess if x is None else x))


def with_terms(problem: Problem, *terms: object) -> Problem:
    """The problem with these costs alone."""
    kept = [term for term in problem.terms if not isinstance(term, Cost | NodeCost)]
    return replace(problem, terms=(*kept, *terms))


def wandering(robot: Robot):
    """A motion that moves and turns everything a little, around the reference."""
    rates = np.random.default_rng(1).uniform(-0.5, 0.5, (2, robot.nv))

    def motion(t: float) -> np.ndarray:
        return pin.integrate(robot.model, robot.reference, rates[0] * t + rates[1] * np.sin(5 * t))

    return motion


def lift(mass: float = 2.0) -> Robot:
    """A mass on a vertical slider, with a motor of ``PUSH`` N."""
    model = pin.Model()
    model.name = "lift"
    joint = model.addJoint(0, pin.JointModelPZ(), pin.SE3.Identity(), "slider")
    model.appendBodyToJoint(joint, pin.Inertia.FromSphere(mass, 0.1), pin.SE3.Identity())
    model.addFrame(pin.Frame("top", joint, 0, pin.SE3(np.eye(3), np.array([0.0, 0.0, 0.1])), pin.OP_FRAME))
    robot = Robot.from_model(model, name="lift", reference=np.zeros(1))
    return replace(robot, effort_limit=np.array([PUSH]))


def thrust(*terms: object) -> Problem:
    """The mass from rest, pushed up for ``THRUST_TIME``."""
    robot = lift()
    return Problem(
        name="thrust",
        robot=robot,
        schedule=Schedule((Phase(name="thrust", duration=THRUST_TIME),)),
        terrain=FlatGround(),
        initial_q=np.zeros(1),
        initial_v=np.zeros(1),
        terms=(*terms, EffortLimits()),
        guess=lambda t: np.zeros(1),
        default_intervals=8,
    )


# Costs at nodes


def test_height_is_counted_at_the_middle_of_its_phase_and_distance_at_the_end():
    robot = hopper()
    problem = replace(hop(), guess=wandering(robot))
    direction = np.array([1.0, 2.0, 0.5])
    height = FrameHeightCost(weight=2.0, frame=FOOT, phase="flight", fraction=0.5)
    distance = DistanceCost(weight=3.0, frame=FOOT, direction=tuple(direction))
    prepared = prepare(problem, intervals=6, compile="none")
    layout = prepared.transcription.layout
    flight = layout.intervals_of(1)
    middle = layout.node_times[flight[0] + round(len(flight) / 2)]
    top = frame_pose(robot, problem.guess(middle), FOOT).translation[2]
    end = frame_pose(robot, problem.guess(problem.schedule.duration), FOOT).translation
    found = objective(with_terms(problem, height, distance))
    way = end @ direction / np.linalg.norm(direction)
    assert_allclose(found, -(2.0 * top + 3.0 * way) / robot.length, rtol=ROUNDING)


@pytest.mark.parametrize("goal", ["height", "distance"])
@pytest.mark.parametrize("solver", ["ipopt", "fatrop"])
def test_highest_point_is_that_of_full_thrust(goal, solver):
    costs = {
        "height": FrameHeightCost(weight=1.0, frame="top", phase="thrust", fraction=1.0),
        "distance": DistanceCost(weight=1.0, frame="top", direction=(0.0, 0.0, 1.0)),
    }
    solution = solve(thrust(costs[goal]), solver=solver)
    assert solution.success
    acceleration = PUSH / 2.0 - 9.81
    assert_allclose(solution.q[-1], acceleration * THRUST_TIME**2 / 2, rtol=SOLVED)
    assert_allclose(solution.tau, PUSH, rtol=SOLVED)


def test_height_in_an_early_moment_is_not_that_of_the_end():
    early = FrameHeightCost(weight=1.0, frame="top", phase="thrust", fraction=0.5)
    solution = solve(thrust(early, TorqueCost(weight=1e-6)))
    half = solution.t < THRUST_TIME / 2
    assert_allclose(solution.tau[half & solution.collocation], PUSH, rtol=1e-2)
    assert solution.tau[~half & solution.collocation].max() < PUSH / 2


# Power


def sampled(problem: Problem) -> tuple[Solution, np.ndarray]:
    """The guess as samples, and as unknowns."""
    prepared = prepare(problem, intervals=6, compile="none")
    return extract(prepared.transcription, prepared.guess, {"success": False}), prepared.guess


def integral(solution: Solution, values: np.ndarray) -> float:
    """Integral over time of values at samples (K,), by the weights of the scheme's points."""
    weights = scheme(solution.meta["transcription"]).b1
    spans = np.diff(solution.interval_t, axis=1).ravel()
    parts = [values[rows.start + 1 : rows.stop - 1] for rows in solution.intervals]
    return float(sum(h * weights @ part for h, part in zip(spans, parts, strict=True)))


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
    bare = replace(solution, meta={**solution.meta, "drives": None})
    assert_allclose(energy(solution) - energy(bare), heat, rtol=ROUNDING)
    unit = Units(robot)
    only = with_terms(problem, PowerCost(weight=1.0, recovered=1.0))
    expected = energy(solution, recovered=1.0) / (unit.force * unit.length)
    assert_allclose(objective(only, x), expected, rtol=ROUNDING)


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


# Tracking


@pytest.mark.parametrize("part", ["all", "joints", "base"])
def test_tracking_cost_is_the_mean_square_distance_at_every_point(part):
    robot = hopper()
    problem, reference = (
        replace(hop(), guess=wandering(robot)),
        key_frames(robot, [0.0, 0.3, 1.0], np.array([wandering(robot)(t + 2.0) for t in (0.0, 0.5, 0.7)])),
    )
    solution, x = sampled(problem)
    distance = np.array(
        [_distance(robot, q, reference(t)) for q, t in zip(solution.q, solution.t, strict=True)]
    )
    rows = {"all": slice(0, 8), "joints": slice(6, 8), "base": slice(0, 6)}[part]
    expected = integral(solution, (distance[:, rows] ** 2).mean(axis=1)) / Units(robot).time
    cost = TrackingCost(weight=1.0, reference=reference, part=part)
    assert_allclose(objective(with_terms(problem, cost), x), expected, rtol=1e-9)
    other_sign = TrackingCost(weight=1.0, reference=lambda t: reference(t) * SIGNS, part=part)
    assert_allclose(objective(with_terms(problem, other_sign), x), expected, rtol=1e-9)


def _distance(robot: Robot, q: np.ndarray, goal: np.ndarray) -> np.ndarray:
    """Base position over the length, 2 sin(angle / 2) along the turn's axis, joints over their unit (nv,)."""
    turn = pin.log3((pin.XYZQUATToSE3(goal[:7]).inverse() * pin.XYZQUATToSE3(q[:7])).rotation)
    angle = np.linalg.norm(turn)
    chord = turn * 2 * math.sin(angle / 2) / angle
    return np.concatenate(
        [(q[:3] - goal[:3]) / robot.length, chord, (q[7:] - goal[7:]) / [1.0, robot.length]]
    )


def test_whole_turns_do_not_count_in_tracking():
    pendulum = robots.load("double_pendulum")
    schedule = Schedule((Phase(name="swing", duration=1.0),))
    problem = Problem(
        name="turns", robot=pendulum, schedule=schedule, terrain=FlatGround(),
        initial_q=pendulum.reference, initial_v=np.array([9.0, 1.0]), terms=(TorqueCost(weight=1.0),),
        guess=lambda t: pin.integrate(pendulum.model, pendulum.reference, np.array([9.0 * t, t])),
    )  # fmt: skip
    cost = TrackingCost(weight=1.0, reference=problem.guess)
    assert_allclose(objective(with_terms(problem, cost)), 0.0, atol=1e-20)


def test_a_feasible_reference_is_followed_exactly():
    robot = one_joint_arm(gravity=True)
    motion = key_frames(robot, [0.0, REACH_TIME], np.array([[0.0], [REACH]]))

    def smooth(t):
        return motion(REACH_TIME * smooth_step(t / REACH_TIME))

    solution = solve(
        with_terms(reach(gravity=True), TrackingCost(weight=1.0, reference=smooth)), intervals=20
    )
    points = solution.collocation
    followed = np.array([smooth(t) for t in solution.t[points]])
    assert_allclose(solution.q[points], followed, atol=SOLVED)


def test_another_reference_is_the_same_function_with_other_parameters():
    groups = []
    for shift in (0.0, 0.1):
        reference = key_frames(hopper(), [0.0, 1.0], np.tile(hopper().reference + shift * AHEAD, (2, 1)))
        problem = with_terms(hop(), TrackingCost(weight=1.0, reference=reference))
        groups.append(prepare(problem, intervals=6, compile="none").transcription.groups)
    first, second = groups
    assert [group.point.text for group in first] == [group.point.text for group in second]
    assert any(not np.array_equal(a.parameters, b.parameters) for a, b in zip(first, second, strict=True))


def test_a_solution_is_a_reference_for_its_own_robot_only():
    solution = solve(reach(), intervals=6)
    motion = solution_motion(solution, one_joint_arm())
    assert_allclose(motion(0.0), solution.q[0])
    assert_allclose(motion(9.0), solution.q[-1])
    with pytest.raises(InputError, match="joints"):
        solution_motion(solution, hopper())


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
            FrameHeightCost(weight=1.0, frame=FOOT, phase="flight"),
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
    prepared = prepare(problem, intervals=6, compile="none")
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


@pytest.mark.parametrize("solver", ["ipopt", "fatrop"])
def test_least_time_of_a_double_integrator_is_bang_bang(solver):
    arm = one_joint_arm()
    inertia, torque = pin.crba(arm.model, arm.model.createData(), np.zeros(1))[0, 0], 3.0
    schedule = Schedule((Phase(name="reach", duration=0.8, duration_bounds=(0.1, 3.0)),))
    goal = np.array([REACH])
    problem = replace(
        reach(),
        schedule=schedule,
        terms=(
            *goal_terms("time", arm, schedule, effort=(AccelerationCost(weight=1.0),), rest=0.0),
            EffortLimits(limit=np.array([torque])), TerminalState(q=goal), TerminalRest(q=goal),
        ),
    )  # fmt: skip
    solution = solve(problem, solver=solver, intervals=10)
    assert solution.success
    assert_allclose(solution.meta["durations"], 2 * math.sqrt(REACH * inertia / torque), rtol=SOLVED)


# In a reduced problem


def push_with_goals(raised: float = 0.0) -> Problem:
    """The symmetric biped pushes, with goals of every kind; at last its left arm is to be ``raised``, rad."""
    robot, turn = biped(), np.zeros(biped().nv)
    turn[robot.model.joints[robot.model.getJointId("left_arm")].idx_v] = raised
    end = pin.integrate(robot.model, robot.reference, turn)
    reference = key_frames(robot, [0.0, 0.4], np.array([robot.reference, end]))
    goals = (
        FrameHeightCost(weight=0.05, frame="waist", phase="stance"),
        DistanceCost(weight=0.02, frame="waist"),
        TrackingCost(weight=1.0, reference=reference),
        PowerCost(weight=0.1),
    )
    terms = [term for term in usual(robot) if not isinstance(term, TerminalState | TerminalRest)]
    return push(robot, terms=(*terms, *goals))


def test_goals_of_half_a_robot_are_those_of_the_whole():
    problem = push_with_goals()
    made = smallest(problem, keep=("left_abduction", "right_abduction", "left_arm", "right_arm"), plane=True)
    assert made.report.is_exact
    whole, half = (solve(own, compile="none", tolerance=1e-8) for own in (problem, made.problem))
    assert whole.success
    assert half.success
    assert_allclose(half.meta["objective"], whole.meta["objective"], rtol=SAME_OPTIMUM)


def test_a_reference_that_is_asymmetric_at_its_end_alone_leaves_the_robot_whole():
    with pytest.raises(InputError, match="tracking_cost"):
        smallest(push_with_goals(raised=0.5), plane=True)


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
        lambda: FrameHeightCost(weight=-1.0, frame=FOOT, phase="flight"),
        lambda: FrameHeightCost(weight=1.0, frame=FOOT, phase="flight", fraction=1.5),
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
    "reference", [lambda t: np.zeros(3), lambda t: np.full(1, np.nan if t > 0.5 else 0.0)]
)
def test_a_reference_of_another_robot_or_with_gaps_is_refused(reference):
    with pytest.raises(InputError):
        prepare(reach(terms=(TrackingCost(weight=1.0, reference=reference),)), intervals=6, compile="none")


def test_a_cost_at_nodes_of_an_unknown_phase_is_refused():
    with pytest.raises(InputError, match="flihgt"):
        with_terms(hop(), FrameHeightCost(weight=1.0, frame=FOOT, phase="flihgt"))
