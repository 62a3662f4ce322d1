"""Feedback gains: closed forms, plans solved again from other states, limits, cycles and bad input."""

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from numpy.testing import assert_allclose

import trajopt
from trajopt import InputError, Phase, Problem, Robot, Schedule, Solution, terms
from trajopt.motion.cycles import gains_in_passes
from trajopt.motion.grid import mesh_of
from trajopt.solving import with_gains

# kg and s of the closed forms.
MASS, DURATION = 2.0, 1.5
# Relative error of gains with hard rows in place of springs.
HARD = 1e-6
# Change of the start, natural units; relative error of the derivative that it gives.
CHANGE, DERIVATIVE = 1e-5, 2e-3


def slider() -> Robot:
    """A mass on a rail."""
    model = pin.Model()
    joint = model.addJoint(0, pin.JointModelPX(), pin.SE3.Identity(), "rail")
    model.appendBodyToJoint(joint, pin.Inertia(MASS, np.zeros(3), 0.01 * np.eye(3)), pin.SE3.Identity())
    model.effortLimit[:] = 100.0
    return Robot.from_model(model, name="slider", base="fixed")


def slide(robot: Robot, **changes: object) -> Problem:
    """From rest to rest over a metre with the least square of the force."""
    goal = np.array([1.0])
    given = {
        "name": "slide",
        "robot": robot,
        "schedule": Schedule((Phase(name="go", duration=DURATION),)),
        "terms": (terms.TorqueCost(weight=1.0), terms.TerminalState(q=goal), terms.TerminalRest(q=goal)),
        "default_intervals": 6,
        "default_transcription": "legendre:2",
    }
    return Problem(**(given | changes))


def solved_again(problem: Problem, plan: Solution, change: np.ndarray) -> np.ndarray:
    """Derivative (nu,) of the first torques along a change (2 nv) of the start, by two more solves."""
    nv, ends = plan.model.nv, []
    for sign in (1, -1):
        q = pin.integrate(plan.model, problem.initial_q, sign * CHANGE * change[:nv])
        moved = replace(problem, initial_q=q, initial_v=problem.initial_v + sign * CHANGE * change[nv:])
        made = trajopt.solve(moved, mesh=mesh_of(plan), start=plan, tolerance=1e-10)
        assert made.converged
        ends.append(made.tau[0])
    return (ends[0] - ends[1]) / (2 * CHANGE)


def test_gains_of_a_double_integrator_are_those_of_its_closed_form():
    problem = slide(slider())
    plan = with_gains(problem, trajopt.solve(problem, fixed_mesh=True, tolerance=1e-10), stiffness=1e12)
    left = DURATION - plan.interval_t[:, 0]
    assert_allclose(plan.gain[:, 0, 0], -6 * MASS / left**2, rtol=HARD)
    assert_allclose(plan.gain[:, 0, 1], -4 * MASS / left, rtol=HARD)


def test_gains_of_a_triple_integrator_are_those_of_its_closed_form():
    """The least jerk to rest from a state whose acceleration is free: a polynomial of degree five."""
    goal = np.array([1.0])
    smooth = (terms.JerkCost(weight=1.0), terms.TerminalState(q=goal), terms.TerminalRest(q=goal))
    problem = slide(slider(), terms=smooth, actuation="jerk", default_transcription="legendre:3")
    plan = with_gains(problem, trajopt.solve(problem, fixed_mesh=True, tolerance=1e-10), stiffness=1e12)
    for gain, (start, _) in zip(plan.gain[:, 0], plan.interval_t, strict=True):
        left = DURATION - start
        powers = np.array(
            [[left ** (n - d) * np.prod(np.arange(n, n - d, -1.0)) for n in range(6)] for d in range(3)]
        )
        rows = np.vstack([np.eye(6)[[0, 1, 3]], np.where(np.isfinite(powers), powers, 0.0)])
        known = np.linalg.solve(rows, np.eye(6)[:, :2])
        assert_allclose(gain, MASS * 2 * known[2], rtol=1e-5)


def test_springs_change_gains_little_until_shortly_before_the_end():
    plan = trajopt.solve(slide(slider()), fixed_mesh=True, gains=True)
    left = DURATION - plan.interval_t[:, 0]
    natural = plan.units.time
    early = left > natural / 2
    assert early.sum() > 3
    assert_allclose(plan.gain[early, 0, 0], (-6 * MASS / left**2)[early], rtol=1e-3)


@pytest.mark.long
@pytest.mark.parametrize(
    ("name", "settings", "intervals"),
    [
        ("arm-reach", {"robot": "panda"}, 8),
        ("arm-transfer", {"robot": "ur5"}, 12),
    ],
)
def test_gains_are_the_derivative_of_the_first_torques(name, settings, intervals):
    problem = trajopt.load(name, **settings)
    plan = trajopt.solve(problem, intervals=intervals, tolerance=1e-10)
    plan = with_gains(problem, plan, stiffness=1e9)
    change = np.random.default_rng(1).standard_normal(2 * plan.model.nv)
    expected = solved_again(problem, plan, change)
    assert_allclose(plan.gain[0] @ change, expected, atol=DERIVATIVE * np.abs(expected).max())


@pytest.mark.slow
@pytest.mark.parametrize(("name", "robot"), [("quadruped-jump-up", "solo12"), ("biped-squat", "g1")])
def test_gains_of_legs_are_the_derivative_of_the_first_torques(name, robot):
    problem = trajopt.load(name, robot=robot)
    plan = trajopt.solve(problem, intervals=16, transcription="legendre:2", tolerance=1e-10)
    plan = with_gains(problem, plan, stiffness=1e9)
    change = np.random.default_rng(1).standard_normal(2 * plan.model.nv)
    expected = solved_again(problem, plan, change)
    assert_allclose(plan.gain[0] @ change, expected, atol=DERIVATIVE * np.abs(expected).max())


def test_a_torque_at_its_limit_has_no_gain():
    robot = slider()
    goal = np.array([1.0])
    # Speed is free at the end, so that the force may be at its limit at first.
    costs = (
        terms.TorqueCost(weight=1.0),
        terms.TorqueLimits(limit=np.array([2.2])),
        terms.TerminalState(q=goal),
    )
    plan = trajopt.solve(slide(robot, terms=costs, default_intervals=12), fixed_mesh=True, gains=True)
    full = np.abs(plan.tau[plan.collocation, 0]).reshape(12, -1).min(axis=1) > 2.2 * (1 - 1e-6)
    assert full.any()
    assert not full.all()
    largest = np.abs(plan.gain).max()
    assert np.abs(plan.gain[full]).max() < 1e-3 * largest


def test_gains_at_samples_and_times_agree_and_are_saved(tmp_path):
    plan = trajopt.solve(slide(slider()), fixed_mesh=True, gains=True)
    assert plan.gains().shape == (plan.n_samples, 1, 2)
    assert_allclose(plan.gains(plan.interval_t[:, 0]), plan.gain)
    starts = np.flatnonzero(np.diff(plan.interval, prepend=-1))
    assert_allclose(plan.gains()[starts], plan.gain)
    middle = plan.interval_t[1].mean()
    assert_allclose(plan.gains([middle])[0], plan.gain[1:3].mean(axis=0))
    read = Solution.load(plan.save(tmp_path / "plan.npz"))
    assert_allclose(read.gain, plan.gain, rtol=0, atol=0)
    with pytest.raises(InputError, match="gain"):
        replace(plan, gain=plan.gain[:-1]).save(tmp_path / "short.npz")


@pytest.mark.slow
def test_gains_of_half_a_cycle_are_mirrored_in_the_other():
    problem = trajopt.load("biped-gait", robot="bolt")
    plan = trajopt.solve(problem, gains=True)
    assert plan.success
    image = plan.description.periodicity
    assert image is not None
    assert image.mirror
    once = gains_in_passes(plan, plan.interval_t[:3, 0], np.zeros(3, dtype=int))
    twice = gains_in_passes(plan, plan.interval_t[:3, 0], np.full(3, 2))
    assert_allclose(twice, once, atol=1e-9 * np.abs(once).max())
    mirrored = gains_in_passes(plan, plan.interval_t[:3, 0], np.ones(3, dtype=int))
    rng = np.random.default_rng(0)
    change, nv = rng.standard_normal(2 * plan.model.nv), plan.model.nv
    turned = np.concatenate([image.sign * part[image.index] for part in (change[:nv], change[nv:])])
    rows = plan.actuated_rows
    torque = np.zeros(nv)
    torque[rows] = once[1] @ change
    assert_allclose(mirrored[1] @ turned, (image.sign * torque[image.index])[rows], rtol=1e-9, atol=1e-9)
    reports = {
        name: trajopt.simulate(plan, controller=name, cycles=3, noise=0.002).report
        for name in ("gains", "joints")
    }
    assert reports["gains"].passed
    assert reports["gains"].base_error_end < reports["joints"].base_error_end


REFUSED = {
    "no multipliers": "gains of a plan without multipliers",
    "another problem": "multipliers for a problem with",
    "velocities": "inputs are velocities",
    "no gains": "the plan has no gains",
    "simulated without gains": "the plan has no gains",
    "outside": "allowed: within the motion",
}


@pytest.mark.parametrize("case", REFUSED)
def test_bad_input_is_refused_in_one_line(case):
    robot = slider()
    problem = slide(robot)
    plan = trajopt.solve(problem, fixed_mesh=True, gains=case == "outside")
    calls = {
        "no multipliers": lambda: with_gains(
            problem, replace(plan, row_multiplier=None, row_place=None, bound_multiplier=None)
        ),
        "another problem": lambda: with_gains(
            replace(problem, terms=(*problem.terms, terms.TorqueLimits(limit=np.array([50.0])))), plan
        ),
        "velocities": lambda: trajopt.solve(
            slide(robot, actuation="velocity", terms=(terms.TerminalState(q=np.array([1.0])),)), gains=True
        ),
        "no gains": plan.gains,
        "simulated without gains": lambda: trajopt.simulate(plan, controller="gains"),
        "outside": lambda: plan.gains([2 * DURATION]),
    }
    with pytest.raises(InputError) as error:
        calls[case]()
    assert REFUSED[case] in str(error.value)
    assert "\n" not in str(error.value)
