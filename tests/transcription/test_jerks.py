"""Jerks as the input: accelerations are continuous, and jerks are within limits at any time."""

import csv
import math
from dataclasses import replace
from functools import lru_cache

import numpy as np
import pinocchio as pin
import pytest

import trajopt
from tests.support.refusals import refused_calls
from trajopt import InputError, Phase, Problem, Robot, Schedule, Solution, terms
from trajopt.certify.report import BETWEEN
from trajopt.motion.solution import Solution as Motion
from trajopt.robot import JointLimits
from trajopt.solving.extraction import extract
from trajopt.solving.solving import prepare
from trajopt.solving.warm_start import warm_start
from trajopt.terms import AccelerationLimits, JerkCost, JerkLimits, TorqueRateCost, TorqueRateLimits
from trajopt.transcription import transcribe

# m, m/s^3, m/s^2, m/s of the closed forms.
WAY, JERK, ACCELERATION, SPEED = 1.0, 10.0, 2.0, 0.8
# s; that of most arms' interfaces.
TICK = 1e-3
ROUNDING = 1e-6
# Limits at ticks may be exceeded by what the solver leaves, those of speeds and torques by what the check
# allows between points. The check samples other times than ticks.
AT_TICKS, SHARE_BETWEEN = 1e-4, 2e-2
# N m/s; G1's squat without a limit takes 115.
SLOW = 80.0


def slider(**limits: float) -> Robot:
    """A mass of 1 kg on a rail."""
    model = pin.Model()
    joint = model.addJoint(0, pin.JointModelPX(), pin.SE3.Identity(), "rail")
    model.appendBodyToJoint(joint, pin.Inertia(1.0, np.zeros(3), 0.01 * np.eye(3)), pin.SE3.Identity())
    robot = Robot.from_model(model, name="slider", base="fixed")
    return robot.with_joint_limits([JointLimits(joint="rail", **limits)])


def least_time(robot: Robot, speed: float = np.inf, actuation: str = "jerk", **changes: object) -> Problem:
    """From rest to rest over `WAY` in least time."""
    known = {"acceleration": AccelerationLimits(), "jerk": JerkLimits()}
    limits = [term for kind, term in known.items() if np.isfinite(robot.joint_limit(kind)).any()]
    goal = np.array([WAY])
    given = {
        "name": "slide",
        "robot": replace(robot, velocity_limit=np.array([speed])),
        "schedule": Schedule((Phase(name="go", duration=2.0, duration_bounds=(0.1, 10.0)),)),
        "terms": (
            terms.TimeCost(weight=1.0),
            *limits,
            terms.VelocityLimits(),
            terms.TerminalState(q=goal),
            terms.TerminalRest(q=goal),
        ),
        "actuation": actuation,
        "default_intervals": 40,
        "default_transcription": "legendre:1",
    }
    return Problem(**(given | changes))


def fastest(jerk: float, acceleration: float, speed: float) -> float:
    """Least duration in s from rest to rest over `WAY`: a double or triple integrator in closed form."""
    ramp = acceleration / jerk
    if (
        not math.isfinite(acceleration)
        or jerk * (2 * WAY / jerk) ** (1 / 3) / 2 ** (2 / 3) < acceleration * 0.99
    ):
        return (32 * WAY / jerk) ** (1 / 3)
    duration = ramp + math.sqrt(ramp**2 + 4 * WAY / acceleration)
    if acceleration * (duration / 2 - ramp) <= speed:
        return duration
    return WAY / speed + speed / acceleration + ramp


@pytest.mark.parametrize(
    ("jerk", "acceleration", "speed", "share"),
    [
        (JERK, np.inf, np.inf, 1e-6),
        (JERK, ACCELERATION, np.inf, 1e-3),
        (JERK, ACCELERATION, SPEED, 2e-3),
    ],
)
def test_a_triple_integrator_takes_its_least_time(jerk, acceleration, speed, share):
    solution = trajopt.solve(least_time(slider(acceleration=acceleration, jerk=jerk), speed))
    assert solution.converged, solution.statistics.advice
    assert solution.t[-1] == pytest.approx(fastest(jerk, acceleration, speed), rel=share)
    assert solution.t[-1] > fastest(jerk, acceleration, speed) * (1 - 1e-6)
    assert trajopt.check(solution).within()


def test_a_double_integrator_takes_its_least_time():
    problem = least_time(slider(acceleration=ACCELERATION), actuation="acceleration")
    solution = trajopt.solve(problem)
    assert solution.converged, solution.statistics.advice
    assert solution.t[-1] == pytest.approx(2 * math.sqrt(WAY / ACCELERATION), rel=1e-5)


@lru_cache
def transfer(robot: str) -> Solution:
    return trajopt.solve(trajopt.load("arm-transfer", robot=robot, actuation="jerk"))


@pytest.mark.long
@pytest.mark.parametrize("name", ["panda", "xarm7", "ur5"])
def test_a_table_at_1_khz_keeps_the_limits_of_an_arm(name, tmp_path):
    """By its own columns, and by differences of those below them."""
    solution, robot = transfer(name), trajopt.robot(name)
    assert solution.converged, solution.statistics.advice
    assert trajopt.check(solution).within()
    with solution.sample(rate=1 / TICK).save(tmp_path / "motion.csv").open() as file:
        rows = list(csv.DictReader(file))
    limits = {
        "v": robot.velocity_limit,
        "tau": robot.torque_limit,
        "a": robot.joint_limit("acceleration"),
        "jerk": robot.joint_limit("jerk"),
        "torque_rate": robot.joint_limit("torque_rate"),
    }
    names, used = list(robot.model.names)[1:], {}

    def column(kind: str) -> np.ndarray:
        return np.array([[float(row[f"{kind}/{joint}"]) for joint in names] for row in rows])

    steps = np.diff([float(row["t"]) for row in rows])[:, None]
    most = dict.fromkeys(limits, 1 + AT_TICKS) | dict.fromkeys(("v", "tau"), 1 + BETWEEN)
    for kind, limit in limits.items():
        used[kind] = float((np.abs(column(kind)) / limit).max())
        assert used[kind] <= most[kind], kind
    for kind, below in {"v": "q", "a": "v", "jerk": "a", "torque_rate": "tau"}.items():
        differences = np.diff(column(below), axis=0) / steps
        assert (np.abs(differences[:-1]) <= limits[kind] * most[kind]).all(), kind
    assert np.abs(column("a")[[0, -1]]).max() < ROUNDING
    assert max(used["a"], used["jerk"], used["torque_rate"]) > 0.9  # a limit binds
    report = trajopt.check(solution)
    for kind, short in (("acceleration", "a"), ("jerk", "jerk"), ("torque_rate", "torque_rate")):
        assert (getattr(report, f"{kind}_use") or 0.0) == pytest.approx(used[short], rel=SHARE_BETWEEN)


def test_a_check_states_the_accelerations_of_a_plan_whose_input_is_the_torque():
    report = trajopt.check(trajopt.solve(trajopt.load("arm-reach", robot="panda")))
    assert report.within()
    assert report.acceleration_use > 0.0
    assert report.jerk_use is None
    assert report.torque_rate_use is None
    assert "largest acceleration" in report.table()


@pytest.mark.long
def test_accelerations_and_torques_are_continuous_where_phases_of_free_duration_meet():
    solution = trajopt.solve(
        trajopt.load("arm-pick-place", robot="ur5", actuation="jerk", goal="time", payload=0)
    )
    assert solution.converged, solution.statistics.advice
    assert jumps(solution, "a") < 1e-4
    assert jumps(solution, "tau") < 1e-3


def test_torques_are_those_of_inverse_dynamics_at_points_and_nodes():
    solution = transfer("panda")
    data = solution.model.createData()
    needed = [
        pin.rnea(solution.model, data, *state)
        for state in zip(solution.q, solution.v, solution.a, strict=True)
    ]
    np.testing.assert_allclose(solution.tau, needed, atol=1e-9)


def test_a_warm_start_on_the_same_mesh_is_the_solution():
    solution = transfer("panda")
    problem = trajopt.load("arm-transfer", robot="panda", actuation="jerk")
    transcription = transcribe(problem, mesh=solution.statistics.mesh)
    again = extract(transcription, warm_start(transcription, solution).x)
    for name in ("t", "q", "v", "a", "tau"):
        np.testing.assert_allclose(getattr(again, name), getattr(solution, name), atol=1e-7, err_msg=name)


def test_a_file_keeps_the_motion(tmp_path):
    solution = transfer("panda")
    read = Motion.load(solution.save(tmp_path / "panda.npz"))
    times = np.linspace(0.0, solution.t[-1], 300)
    np.testing.assert_array_equal(read.sample(times=times).a, solution.sample(times=times).a)
    assert trajopt.check(read).to_dict() == trajopt.check(solution).to_dict()


@lru_cache
def squat() -> Solution:
    return trajopt.solve(trajopt.load("biped-squat", robot="g1", actuation="jerk"))


def jumps(solution: Solution, name: str) -> float:
    """Largest jump of an array between the polynomials of intervals that meet."""
    before = np.arange(solution.n_intervals - 1)
    ends = solution.polynomials.at(before, np.ones(len(before)))
    starts = solution.polynomials.at(before + 1, np.zeros(len(before)))
    return float(np.abs(getattr(ends, name) - getattr(starts, name)).max())


@pytest.mark.long
def test_forces_of_contacts_are_continuous_within_phases():
    solution = squat()
    assert solution.converged, solution.statistics.advice
    assert trajopt.check(solution).within()
    weight = 9.81 * sum(inertia.mass for inertia in solution.model.inertias)
    for name, most in (("a", 1e-3), ("f", 1e-5 * weight), ("tau", 1e-3)):
        assert jumps(solution, name) < most
    assert np.abs(solution.a[[0, -1]]).max() < 1e-5


@pytest.mark.slow
def test_torque_rates_on_feet_are_limited_and_reduced_by_a_cost():
    problem = trajopt.load("biped-squat", robot="g1", actuation="jerk")
    limited, calm = (
        trajopt.solve(replace(problem, terms=(*problem.terms, term)))
        for term in (
            TorqueRateLimits(limit=np.full(problem.robot.nv, SLOW)),
            TorqueRateCost(weight=10.0),
        )
    )
    assert limited.converged
    assert calm.converged
    assert trajopt.check(limited).within()
    assert fastest_torque(squat()) > SLOW
    assert fastest_torque(limited) <= SLOW
    assert fastest_torque(calm) < 0.5 * fastest_torque(squat())


def fastest_torque(solution: Solution) -> float:
    """Largest rate of a torque, by differences at 1 kHz, N m/s."""
    return float(np.abs(np.diff(solution.sample(rate=1 / TICK).tau, axis=0)[:-1]).max() / TICK)


@pytest.mark.slow
def test_a_trot_repeats_its_accelerations():
    trot = trajopt.load("quadruped-trot", robot="go2")
    smooth = (*trot.terms, JerkCost(weight=1e-4))
    solution = trajopt.solve(replace(trot, actuation="jerk", terms=smooth, default_transcription="radau:3"))
    assert solution.converged, solution.statistics.advice
    report = trajopt.check(solution)
    assert report.within()
    assert jumps(solution, "a") < 1e-6
    image = solution.description.periodicity
    assert image is not None
    joints = slice(6, None)
    mapped = (image.sign * solution.a[0][image.index])[joints]
    np.testing.assert_allclose(solution.a[-1][joints], mapped, atol=1e-5)


@pytest.mark.slow
@pytest.mark.parametrize("robot", ["go2", "solo12"])
def test_a_leap_lifts_off_and_lands_without_a_jump_of_the_acceleration(robot):
    solution = trajopt.solve(trajopt.load("quadruped-jump-forward", robot=robot, actuation="jerk"))
    assert solution.converged, solution.statistics.advice
    assert trajopt.check(solution).within()
    assert jumps(solution, "a") < 1e-2


REACH = trajopt.load("arm-reach", robot="ur5")
JUMP = trajopt.load("quadruped-jump-up", robot="solo12")
test_what_jerks_do_not_model_is_refused_in_one_line = refused_calls(
    (lambda: prepare(replace(REACH, terms=(*REACH.terms, JerkCost(weight=1.0)))), "actuation 'torque'"),
    (lambda: transcribe(replace(REACH, actuation="jerk"), "hermite-simpson"), "allowed: legendre:1"),
    (lambda: transcribe(replace(JUMP, actuation="jerk"), "legendre:2"), "radau:2"),
    (lambda: transcribe(replace(JUMP, actuation="jerk"), "radau:1"), "radau:2"),
    (lambda: trajopt.robot("ur5").with_joint_limits([JointLimits(joint="elbow", jerk=1.0)]), "elbow"),
    (lambda: JointLimits(joint="elbow_joint", jerk=0.0), "jerk"),
    (lambda: JerkLimits(limit=[-1.0]), "limit"),
    (
        lambda: AccelerationLimits(limit=np.zeros(6)),
        "limit of acceleration_limits holds 0; allowed: numbers > 0",
    ),
    (lambda: replace(REACH, actuation="jerk", terms=(TorqueRateLimits(),)), "no limit of torque rate"),
    (
        lambda: prepare(replace(REACH, terms=(*REACH.terms, TorqueRateLimits(limit=np.ones(6))))),
        "torque_rate_limits in phase 'reach': .* with actuation 'jerk'",
    ),
    (lambda: replace(JUMP, actuation="jerk", initial_v=np.ones(18)), "begins on contacts in motion"),
    (lambda: replace(REACH, actuation="jerk", terms=(*REACH.terms, JerkLimits())), "no limit of jerk"),
    (
        lambda: prepare(replace(REACH, actuation="jerk", terms=(*REACH.terms, JerkLimits(limit=[1.0])))),
        "shape",
    ),
)


def test_an_impact_is_refused():
    problem = trajopt.load("hopper-hop", touchdown="impact")
    with pytest.raises(InputError, match="begins with an impact"):
        replace(problem, actuation="jerk")
