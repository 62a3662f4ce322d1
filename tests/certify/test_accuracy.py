"""Accuracy of motions whose errors are known: closed forms, orders, errors put in by hand."""

import json
from dataclasses import replace
from functools import lru_cache

import numpy as np
import pinocchio as pin
import pytest
from numpy.testing import assert_allclose

import trajopt
from tests.support.problems import SCHEME_ORDERS, hopper, landing, lean, one_joint_arm, reach, still
from tests.support.synthetic_motions import (
    Motion,
    arm_motion,
    pushing_off,
    sampled,
    standing,
    tumbling_flight,
)
from trajopt import InputError, Robot, Solution
from trajopt.certify import impact
from trajopt.certify.accuracy import interval_errors, measure
from trajopt.certify.reintegration import active_contacts
from trajopt.errors import SolutionFileError
from trajopt.motion.description import CarriedBody, PlannedContact
from trajopt.motion.quantities import MotionQuantities
from trajopt.robot.natural_units import NaturalUnits
from trajopt.robot.payload import loaded_model
from trajopt.transcription.mesh import Mesh, PhaseMesh
from trajopt_library import problems, robots

pytestmark = pytest.mark.long

# Motions are of order one and integrated to 1e-10 relative; differences lose some digits.
EXACT = 1e-8
# A motion that is exact in the file: rounding.
ROUNDING = 1e-12
# Two steps near the limit of small ones tell an order to this.
ORDER = 0.4
INTERVALS = 10


def falling(robot: Robot, missing: float, duration: float = 0.4) -> Solution:
    """A robot without torques that falls, as planned, with ``missing`` m/s^2 less than gravity."""
    gravity, start = 9.81 - missing, robot.reference.copy()
    start[2] += 2.0
    down, at_rest = np.eye(robot.nv)[2], np.zeros(robot.nv)
    motion = Motion(
        duration=duration,
        contacts=(),
        q=lambda t: pin.integrate(robot.model, start, -down * gravity * t**2 / 2),
        v=lambda t: at_rest - down * gravity * t,
        a=lambda t: at_rest - down * gravity,
        tau=lambda t: np.zeros(robot.nu),
        f=lambda t: np.zeros((len(robot.contacts), 6)),
    )
    return sampled(robot, [motion], INTERVALS)


@lru_cache
def two_phases() -> Solution:
    solo = robots.load("solo12")
    return sampled(solo, [standing(solo), tumbling_flight(solo)], INTERVALS)


@lru_cache
def landed() -> Solution:
    solution = trajopt.solve(landing(impact=True), intervals=24)
    assert solution.converged
    return solution


def test_wrong_gravity_is_measured_in_metres_and_in_g():
    robot, missing, duration = hopper(), 0.05, 0.4
    found = measure(falling(robot, missing, duration))
    units, step = NaturalUnits.of(robot.model), duration / INTERVALS
    assert found.open_loop == pytest.approx(missing * duration**2 / 2, rel=EXACT)
    assert found.open_loop_motion == pytest.approx(found.open_loop, rel=EXACT)
    assert found.open_loop_joints < EXACT
    local = missing * step**2 / 2 + units.time * missing * step
    assert_allclose(found.interval_errors, local, rtol=1e-6)
    assert found.base_error == pytest.approx(missing / 9.81, rel=1e-6)
    assert_allclose(found.collocation_errors, found.base_error, rtol=1e-6)


@pytest.mark.parametrize("which", ["standing", "flight", "push"])
def test_true_motions_have_no_error(which):
    solo = robots.load("solo12")
    motion = {"standing": standing, "flight": tumbling_flight, "push": pushing_off}[which](solo)
    found = measure(sampled(solo, [motion], 20))
    assert found.open_loop < EXACT
    assert found.open_loop_farthest < EXACT
    assert found.interval_error < EXACT
    assert found.open_loop_motion < EXACT


def test_cubic_of_least_acceleration_is_exact_between_points_too():
    found = measure(trajopt.solve(reach(), intervals=4))
    assert found.interval_error < ROUNDING
    assert found.collocation_error < EXACT
    assert found.position_gap < ROUNDING


@pytest.mark.parametrize(("scheme", "order"), SCHEME_ORDERS.items())
def test_local_error_falls_with_the_order_and_one_more_of_the_step(scheme, order):
    errors, whole = [], []
    for intervals in (6, 12):
        plan = trajopt.solve(reach(gravity=True), transcription=scheme, intervals=intervals, tolerance=1e-10)
        assert plan.converged
        found = measure(plan)
        errors.append(found.interval_error)
        whole.append(found.open_loop)
    assert np.log2(errors[0] / errors[1]) == pytest.approx(order + 1, abs=ORDER)
    assert np.log2(whole[0] / whole[1]) == pytest.approx(order, abs=ORDER)


def test_local_error_in_stance_falls_with_the_fifth_power_of_the_step():
    plans = [trajopt.solve(lean(), intervals=n, tolerance=1e-10) for n in (4, 8)]
    coarse, fine = (interval_errors(plan).max() for plan in plans)
    assert np.log2(coarse / fine) == pytest.approx(5, abs=ORDER)


def test_intervals_of_unequal_width_and_phases_of_other_schemes_are_measured():
    widths = (0.4, 0.3, 0.2, 0.1)
    phases = [PhaseMesh(scheme=name, widths=widths) for name in ("legendre:1", "legendre:3", "radau:2")]
    plan = trajopt.solve(landing(), mesh=Mesh(phases=tuple(phases)))
    assert plan.converged
    found = measure(plan)
    assert found.interval_errors.shape == (12,)
    assert found.phases[0].interval_error == found.interval_errors[:4].max()
    assert found.interval_errors[0] == found.interval_errors[:4].max()  # the widest, of the lowest order
    assert found.phases[1].interval_error < found.phases[0].interval_error


@pytest.mark.parametrize("interval", [3, INTERVALS + 6])
def test_wrong_torque_is_found_in_its_interval_and_its_phase(interval):
    plan = two_phases()
    tau = plan.tau.copy()
    tau[plan.interval == interval] += 0.05
    found = measure(replace(plan, tau=tau))
    others = np.delete(found.interval_errors, interval)
    assert int(np.argmax(found.interval_errors)) == interval
    assert found.interval_errors[interval] > 1e3 * others.max()
    assert int(np.argmax(found.collocation_errors)) == interval
    wrong = interval // INTERVALS
    assert found.phases[wrong].open_loop.farthest > 1e-5
    assert found.phases[1 - wrong].open_loop.farthest < EXACT


def test_wrong_acceleration_at_one_point_shows_between_points_of_its_interval():
    plan = two_phases()
    a = plan.a.copy()
    row = plan.intervals[INTERVALS + 2][1]
    a[row, 2] += 0.981
    found = measure(replace(plan, a=a))
    assert int(np.argmax(found.collocation_errors)) == INTERVALS + 2
    assert found.base_error > 0.05
    assert found.velocity_gap > 1e-3


def test_motion_goes_through_its_impact_by_the_law_of_impacts():
    found = measure(landed())
    assert len(found.phases) == 3
    assert found.phases[2].motion.position < 10 * max(phase.open_loop.position for phase in found.phases)
    without = measure(replace(landed(), impulse=None, impact_index=None))
    assert without.phases[2].motion.position > 10 * found.phases[2].motion.position
    assert without.phases[1].motion == found.phases[1].motion


def test_whole_motion_carries_the_error_of_one_phase_into_the_next():
    plan = two_phases()
    tau = plan.tau.copy()
    tau[plan.phase == 0] += 0.01
    found = measure(replace(plan, tau=tau))
    assert found.phases[1].open_loop.farthest < EXACT
    assert found.phases[1].motion.farthest > found.phases[0].motion.farthest > 1e-6


def test_pendulum_is_measured_where_its_mass_is():
    robot = one_joint_arm(gravity=True)
    found = measure(trajopt.solve(reach(gravity=True), intervals=8))
    lever = np.linalg.norm(robot.model.inertias[1].lever)
    assert found.open_loop == pytest.approx(found.open_loop_joints * lever, rel=1e-3)
    assert found.open_loop_orientation is None
    assert found.foot_drift is None


def test_arm_is_measured_at_its_farthest_point():
    plan = sampled(robots.load("ur5"), [arm_motion(robots.load("ur5"))], INTERVALS)
    found = measure(replace(plan, tau=plan.tau + np.eye(6)[5] * 0.05))
    assert found.open_loop == found.open_loop_farthest > 0


def test_source_of_velocity_is_exact_where_its_rates_are_polynomials():
    found = measure(trajopt.solve(still(), intervals=6))
    assert found.open_loop < 1e-6
    assert found.violations["friction"] == 0.0
    assert found.contact_error > 0  # between points the foot is held to the scheme's order alone


@pytest.mark.parametrize("coordinates", ["excess", "minimal"])
def test_both_coordinates_of_a_hop_are_measured(coordinates):
    problem = problems.load("hopper-hop", coordinates=coordinates)
    plan = trajopt.solve(problem, fixed_mesh=True)
    assert plan.converged
    found = measure(plan)
    assert found.open_loop < 0.05
    assert found.interval_error < 1e-3
    assert found.phases[0].foot_drift < 1e-3


def test_torque_that_runs_away_is_infinite_and_null_in_json():
    plan = two_phases()
    found = measure(replace(plan, tau=plan.tau * 1e12))
    assert found.open_loop == found.interval_error == found.open_loop_motion == np.inf
    entry = json.loads(json.dumps(found.to_dict(), allow_nan=False))
    assert entry["open_loop"] is None
    assert entry["phases"][1]["open_loop"]["position"] is None
    assert len(entry["interval_errors"]) == 2 * INTERVALS


def test_measure_reads_files_and_refuses_what_is_wrong(tmp_path):
    path = two_phases().save(tmp_path / "plan.npz")
    assert_allclose(interval_errors(path), interval_errors(two_phases()))
    assert "whole motion" in measure(path, path).table()
    with pytest.raises(SolutionFileError, match="does not exist"):
        measure(tmp_path / "none.npz")
    q = two_phases().q.copy()
    q[3, 0] = np.nan
    with pytest.raises(InputError, match="'q' holds NaN"):
        measure(replace(two_phases(), q=q))


def test_impact_with_a_carried_body_is_judged_with_its_mass():
    """The foot lands while the trunk carries a body: the jump follows the loaded model's law."""
    plan = landed()
    row = int(plan.impact_index[0])
    body = {"frame": "trunk", "mass": 2.0, "centre": [0.0, 0.0, 0.1], "inertia": np.eye(3).tolist()}
    model = pin.Model(plan.model)
    model.addFrame(pin.Frame("trunk", 1, 0, pin.SE3.Identity(), pin.OP_FRAME))
    inertia = pin.Inertia(body["mass"], np.array(body["centre"]), np.eye(3))
    carrying = loaded_model(model, "trunk", inertia)
    law = impact(carrying, plan.q[row], plan.v[row - 1], active_contacts(MotionQuantities(plan), row))
    v, impulse = plan.v.copy(), plan.impulse.copy()
    v[row], impulse[0] = law.velocity, 0.0
    impulse[0, plan.active[row]] = law.impulses
    hand = PlannedContact(name="trunk", frame="trunk", kind="surface", friction=0.7)
    carried = CarriedBody(**{**body, "inertia": np.eye(3)}, phases=(2,))
    contacts = (*plan.description.contacts, hand)
    wider = {
        "f": np.concatenate([plan.f, np.zeros_like(plan.f[:, :1])], axis=1),
        "active": np.concatenate([plan.active, np.zeros_like(plan.active[:, :1])], axis=1),
        "impulse": np.concatenate([impulse, np.zeros_like(impulse[:, :1])], axis=1),
    }
    held = plan.with_description(contacts=contacts, payloads=(carried,))
    loaded = replace(held, model=model, v=v, **wider)
    report = trajopt.check(loaded)
    assert report.impact_residual < EXACT
    assert report.impact_momentum_error < EXACT
    assert trajopt.check(replace(loaded, v=plan.v)).impact_residual > 1e-3
