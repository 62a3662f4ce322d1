"""Known wrenches on links over time: in plans, their checks and files, and in simulation."""

from dataclasses import replace
from functools import lru_cache
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from numpy.testing import assert_allclose, assert_array_equal

import trajopt
from tests.support.command_lines import assert_refused, invoke
from tests.support.models import placement
from tests.support.refusals import refusals, refused
from trajopt import FlatGround, Phase, Problem, Schedule, Solution
from trajopt.certify.report import AT_POINTS
from trajopt.dynamics.model_quantities import contact_jacobian, mass_of
from trajopt.problem.problem import rest
from trajopt.robot import LinkWrench
from trajopt.robot.link_wrench import wrench_force
from trajopt.view.replay.balance import balance_of
from trajopt.view.replay.motion import replay_motion
from trajopt_library import problems, robots

FORCE, TORQUE, POINT = np.array([12.0, -7.0, 5.0]), np.array([0.6, 0.8, -0.5]), np.array([0.02, 0.1, -0.05])
# Torques of two ways of writing the same dynamics, N m: the solver's tolerance of an arm at rest.
SAME_TORQUE = 1e-8
# Balance of forces between the points of a jump's mesh over the weight; 2e-3 at the time of writing.
BETWEEN = 1e-2
# Of points that are drawn between samples, m; the wind moves this one by 27 mm.
DRAWN = 1e-3
# Residual of MuJoCo's equations of motion over the weight: its solver's tolerance.
SIMULATED = 1e-6
# From which the wind of a quadruped blows in full, s, and its force, N: a tenth of the weight.
RAMP, WIND = 0.2, 2.5


def at_rest(name: str, *wrenches: LinkWrench) -> Problem:
    return replace(rest(robots.load(name)), wrenches=wrenches)


def side_wind() -> LinkWrench:
    force = [(0.0, 0.0, 0.0), (0.0, WIND, 0.0)]
    return LinkWrench(frame="base_link", force=force, times=(0.0, RAMP), point=(0.0, 0.0, 0.05))


@lru_cache
def stance() -> Solution:
    return trajopt.solve(at_rest("solo12", side_wind()))


@lru_cache
def arm() -> Solution:
    return trajopt.solve(at_rest("ur5"))


def test_between_samples_it_is_linear_and_outside_them_constant() -> None:
    rows = np.array([[0.0, 0.0, 0.0], [2.0, 0.0, 0.0], [0.0, 4.0, 0.0], [0.0, 6.0, 8.0]])
    wrench = LinkWrench(frame="tool0", force=rows, torque=TORQUE, times=(1.0, 2.0, 2.0, 4.0))
    times = np.array([0.0, 1.5, 2.0, 3.0, 9.0])
    assert_allclose(
        wrench.at(times)[:, :3], [rows[0], rows[1] / 2, rows[2], (rows[2] + rows[3]) / 2, rows[3]]
    )
    assert_array_equal(wrench.at(times)[:, 3:], np.tile(TORQUE, (5, 1)))
    assert_array_equal(wrench.at(1.5), wrench.at(times)[1])


@pytest.mark.long
@pytest.mark.parametrize(("name", "frame"), [("ur5", "tool0"), ("panda", "panda_hand_tcp")])
def test_an_arm_that_holds_still_has_the_torques_of_gravity_less_the_wrench(name: str, frame: str) -> None:
    wrench = LinkWrench(frame=frame, force=FORCE, torque=TORQUE, point=POINT)
    solution = trajopt.solve(at_rest(name, wrench))
    assert trajopt.check(solution).within(AT_POINTS)
    model, q = solution.model, solution.q[0]
    arm = placement(model, q, frame).rotation @ POINT
    acting = np.concatenate([FORCE, TORQUE + np.cross(arm, FORCE)])
    gravity = pin.computeGeneralizedGravity(model, model.createData(), q)
    expected = gravity - contact_jacobian(model, q, [(frame, 6)]).T @ acting
    assert_allclose(solution.tau, np.tile(expected, (len(solution.tau), 1)), atol=SAME_TORQUE)


def test_a_multirotor_in_an_updraught_needs_less_thrust() -> None:
    updraught = LinkWrench(frame=robots.load("iris").model.frames[2].name, force=(0.0, 0.0, 2.0))
    hover = trajopt.solve(replace(at_rest("iris", updraught), terrain=FlatGround(height=-2.0)))
    assert_allclose(hover.tau.sum(axis=1), mass_of(hover.model) * 9.81 - 2.0, atol=SAME_TORQUE)


def newton_error(plan: Solution, times: np.ndarray) -> float:
    """Largest m a - sum f - w - m g over the weight, by numeric Pinocchio, at times between the nodes."""
    motion, model, data = plan.sample(times=times), plan.model, plan.model.createData()
    forces = motion.f[..., :3].sum(axis=1) + sum(each.at(times)[:, :3] for each in plan.description.wrenches)
    rates = [
        pin.computeCentroidalMomentumTimeVariation(model, data, *state).linear.copy()
        for state in zip(motion.q, motion.v, motion.a, strict=True)
    ]
    weight = mass_of(model) * model.gravity.linear
    return float(np.abs(np.array(rates) - forces - weight).max() / np.linalg.norm(weight))


@pytest.mark.slow
def test_a_jump_in_side_wind_is_clean_balanced_replayed_and_tracked() -> None:
    jump = replace(problems.load("quadruped-jump-up", robot="solo12"), wrenches=(side_wind(),))
    plan = trajopt.solve(jump)
    report = trajopt.check(plan)
    assert plan.success
    assert plan.active.any(axis=1).sum() < plan.n_samples  # it flies
    assert report.open_loop_position is not None
    assert report.ballistic_error is None  # no parabola in wind
    assert newton_error(plan, np.linspace(0, plan.t[-1], 97)) < BETWEEN
    in_wind = trajopt.simulate(plan, controller="whole-body")
    in_calm = trajopt.simulate(plan.with_description(wrenches=()), controller="whole-body")
    assert in_wind.report.passed
    assert in_wind.report.base_error_max < in_calm.report.base_error_max / 10


@pytest.mark.long
def test_ground_forces_balance_a_ramp_of_wind() -> None:
    plan = stance()
    assert plan.success
    assert newton_error(plan, np.linspace(0, plan.t[-1], 33)) < BETWEEN
    assert plan.f[-1, :, 1].sum() == pytest.approx(-WIND, rel=BETWEEN)


def test_forgetting_the_wind_is_found() -> None:
    assert trajopt.check(stance()).within(AT_POINTS)
    calm = trajopt.check(stance().with_description(wrenches=()))
    assert calm.base_residual == pytest.approx(WIND / (mass_of(stance().model) * 9.81), rel=0.1)
    assert calm.open_loop_position > 0.01


def test_a_file_records_it(tmp_path: Path) -> None:
    read = Solution.load(stance().save(tmp_path / "wind.npz"))
    (kept,), given = read.description.wrenches, side_wind()
    for name in ("frame", "force", "torque", "times", "point"):
        assert_array_equal(getattr(kept, name), getattr(given, name))
    assert trajopt.check(read).to_dict() == trajopt.check(stance()).to_dict()
    assert "wrenches" not in arm().meta


def test_the_zero_moment_point_in_wind_is_the_centre_of_pressure() -> None:
    motion = replay_motion(stance())
    place, force = motion.feet, motion.force
    turned = (place[..., :2] * force[..., 2:] - place[..., 2:] * force[..., :2]).sum(axis=1)
    assert_allclose(balance_of(stance(), motion).zmp[:, :2], turned / force[..., 2:].sum(axis=1), atol=DRAWN)


@pytest.mark.long
def test_a_wrench_in_mujoco_is_its_generalised_force_in_pinocchio() -> None:
    wrench = LinkWrench(frame="tool0", force=FORCE, torque=TORQUE, point=POINT, times=(0.0,))
    simulated = trajopt.simulate(arm(), wrenches=[wrench]).as_solution()
    (recorded,) = simulated.description.wrenches
    assert recorded is wrench
    assert np.abs(simulated.v).max() > 1e-3  # it gives way
    for q, v, a, tau in zip(simulated.q, simulated.v, simulated.a, simulated.tau, strict=True):
        inverse = pin.rnea(simulated.model, simulated.model.createData(), q, v, a)
        force = inverse - wrench_force(simulated.model, (wrench,), 0.0, q)
        assert_allclose(force, tau, atol=SIMULATED * mass_of(simulated.model) * 9.81)


@pytest.mark.long
def test_a_wrench_of_the_command_line_acts_in_its_window(tmp_path: Path) -> None:
    file, out = arm().save(tmp_path / "arm.npz"), tmp_path / "out.npz"
    invoke("simulate", file, "--wrench", "tool0:0,0,-30,0,0,1:0.2,0.4", "-o", out)
    simulated = Solution.load(out)
    moved = np.abs(simulated.q - arm().q[0]).max(axis=1)
    assert moved[simulated.t < 0.2].max() < 1e-3 * moved.max()
    assert_allclose(
        simulated.description.wrenches[0].at([0.1, 0.2, 0.3, 0.4])[:, [2, 5]],
        [[0, 0], [-30, 1], [-30, 1], [0, 0]],
    )


@pytest.mark.parametrize(
    ("text", "line"),
    [
        ("tool0", "--wrench is 'tool0'; allowed: FRAME:FX,FY,FZ[,TX,TY,TZ][:START,END]"),
        ("tool0:1,2", "--wrench is 'tool0:1,2'; allowed: FRAME:"),
        ("tool0:1,2,nan", "a number of --wrench 'tool0:1,2,nan' is 'nan'; allowed: a finite number"),
        ("tool0:1,2,3:0.3,0.2", "--wrench is 'tool0:1,2,3:0.3,0.2'; allowed: "),
        ("tool0:1,2,3:9,10", "a wrench on 'tool0' at 9 s is after the simulation; allowed: 0 to "),
        ("tool:1,2,3", "a wrench names frame 'tool', which the model does not have; close matches: tool0"),
        ("base_link:1,2,3", "a wrench acts on frame 'base_link', which is fixed; allowed: moving ones"),
    ],
)
def test_wrong_wrenches_of_the_command_line_are_refused(text: str, line: str, tmp_path: Path) -> None:
    file = arm().save(tmp_path / "arm.npz")
    assert_refused(invoke("simulate", file, "--wrench", text), line)


test_invalid_wrenches_are_refused = refusals(
    lambda given: LinkWrench(**{"frame": "tool0", **given}),
    ({"force": (1.0, 2.0)}, r"force of the wrench on 'tool0' is \(1.0, 2.0\); allowed: \(3,\) or \(1, 3\)"),
    ({"torque": (np.nan, 0.0, 0.0)}, "torque of the wrench on 'tool0' is .*nan.*; allowed"),
    ({"times": (1.0, 0.0)}, "times of the wrench on 'tool0' are .*; allowed: "),
    ({"times": ()}, "times of the wrench"),
    ({"force": np.ones((2, 3)), "times": (0.0, 1.0, 2.0)}, r"allowed: \(3,\) or \(3, 3\)"),
)


def hop(*, free: bool, **given: object) -> Problem:
    """Solo12 stands, then for a free duration, in a wrench."""
    bounds = (0.2, 0.6) if free else None
    feet = tuple(contact.name for contact in robots.load("solo12").contacts)
    first = Phase(name="first", duration=0.3, contacts=feet)
    second = Phase(name="second", duration=0.3, contacts=feet, duration_bounds=bounds)
    wrench = LinkWrench(**{"frame": "base_link", "force": (0.0, 1.0, 0.0), **given})
    return replace(at_rest("solo12", wrench), schedule=Schedule((first, second)))


RAMPED = {"force": [(0.0, 0.0, 0.0), (0.0, 1.0, 0.0)]}
test_plans_refuse_what_they_cannot_know = refusals(
    lambda given: hop(**given),
    ({"free": False, "frame": "trunk"}, "a wrench names frame 'trunk'"),
    ({"free": False, **RAMPED, "times": (0.1, 0.1)}, "allowed: times that ascend, in a plan"),
    (
        {"free": True, **RAMPED, "times": (0.0, 0.4)},
        "a wrench on 'base_link' varies until 0.4 s; allowed: constant from 0.3 s on, when phase 'second' of",
    ),
)


@pytest.mark.long
def test_a_wrench_that_is_constant_where_durations_are_free_is_planned() -> None:
    plan = trajopt.solve(hop(free=True, **RAMPED, times=(0.0, 0.3)), intervals=6)
    assert plan.success
    assert newton_error(plan, np.linspace(0, plan.t[-1], 33)) < BETWEEN


def test_periodic_plans_take_constant_wrenches_alone() -> None:
    trot = problems.load("quadruped-trot", robot="solo12")
    with refused("allowed: constant ones in a periodic motion, without mirror and turn"):
        replace(trot, wrenches=(side_wind(),))
    assert replace(trot, wrenches=(LinkWrench(frame="base_link", force=(0.0, 1.0, 0.0)),)).wrenches
