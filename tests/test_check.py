"""The check: truth is accepted to rounding, and one corruption is found by its own figure."""

from __future__ import annotations

import json
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from synthetic import Motion, arm_motion, planar_flight, pushing_off, sampled, standing, tumbling_flight

import robots
from trajopt.check import check
from trajopt.errors import SolutionFileError
from trajopt.reintegration import ContactDynamics, open_loop
from trajopt.report import Tolerances
from trajopt.robot import Contact, Robot
from trajopt.solution import Solution

INTERVALS = 20
EXACT = 1e-9  # motions are integrated to 1e-13; differences of accelerations lose some digits
POINT = 1  # the first collocation point
FOOT = 2


@pytest.fixture(scope="module")
def solo() -> Robot:
    return robots.load("solo12")


@pytest.fixture(scope="module")
def arm() -> Solution:
    robot = robots.load("ur5")
    return sampled(robot, [arm_motion(robot)], INTERVALS)


@pytest.fixture(scope="module")
def flight(solo: Robot) -> Solution:
    return sampled(solo, [tumbling_flight(solo)], INTERVALS)


@pytest.fixture(scope="module")
def planar() -> Solution:
    solo = robots.load("solo12")
    feet = [contact.frame for contact in solo.contacts]
    robot = Robot.from_urdf(solo.visual.urdf, base="planar", contacts=feet, reference=solo.reference[7:])
    return sampled(robot, [planar_flight(robot)], INTERVALS)


@pytest.fixture(scope="module")
def stance(solo: Robot) -> Solution:
    return sampled(solo, [standing(solo)], INTERVALS)


@pytest.fixture(scope="module")
def push(solo: Robot) -> Solution:
    return sampled(solo, [pushing_off(solo)], INTERVALS)


@pytest.mark.parametrize("which", ["flight", "planar", "stance", "push"])
def test_true_motion_is_accepted_to_rounding(which, request):
    report = check(request.getfixturevalue(which))
    assert report.ok, report.failures()
    assert report.base_residual < EXACT
    assert report.actuated_residual < EXACT
    assert report.inactive_force in (None, 0.0)
    assert report.open_loop_position < EXACT
    assert report.open_loop_orientation < EXACT
    assert report.open_loop_joints < EXACT


def test_feet_of_a_push_neither_drift_nor_slip(push):
    report = check(push)
    assert report.contact_acceleration < EXACT
    assert report.contact_velocity < EXACT
    assert report.foot_drift < EXACT
    assert 0 < report.friction_margin < 1
    assert 0 < report.unilateral_margin < 1


@pytest.mark.parametrize("which", ["flight", "planar"])
def test_free_motion_is_ballistic_and_keeps_its_angular_momentum(which, request):
    report = check(request.getfixturevalue(which))
    assert report.ballistic_error < EXACT
    assert report.momentum_error < EXACT
    assert report.friction_margin is None


def test_stance_shares_the_weight(stance):
    report = check(stance)
    assert report.unilateral_margin == pytest.approx(0.25, abs=0.01)
    assert report.ballistic_error is None


def test_open_loop_error_of_interpolated_torques_falls_with_the_fourth_power():
    robot = robots.load("ur5")
    coarse, fine = (check(sampled(robot, [arm_motion(robot)], n)).open_loop_joints for n in (20, 40))
    assert np.log2(coarse / fine) == pytest.approx(4, abs=0.3)


def test_gaps_within_intervals_fall_with_the_step(flight, solo):
    coarse = check(flight)
    fine = check(sampled(solo, [tumbling_flight(solo)], 2 * INTERVALS))
    assert coarse.position_gap < 1e-6
    assert np.log2(coarse.position_gap / fine.position_gap) == pytest.approx(5, abs=0.5)
    assert np.log2(coarse.velocity_gap / fine.velocity_gap) == pytest.approx(5, abs=0.5)


def test_fixed_base_has_no_base_figures(arm):
    report = check(arm)
    assert report.ok
    assert report.base_residual is None
    assert report.open_loop_position is None
    assert report.contact_acceleration is None
    assert -1 < report.effort_excess < 0


def changed(solution: Solution, name: str, index: object, value: object) -> Solution:
    array = getattr(solution, name).copy()
    array[index] = value
    return replace(solution, **{name: array})


def with_meta(solution: Solution, **changes: object) -> Solution:
    return replace(solution, meta={**solution.meta, **changes})


def test_wrong_torque_shows_in_the_actuated_rows_alone(stance, solo):
    wrong = changed(stance, "tau", (POINT, 3), stance.tau[POINT, 3] + 1e-3 * solo.weight)
    report = check(wrong)
    assert report.failures() == ("actuated_residual",)
    assert report.actuated_residual == pytest.approx(1e-3, rel=1e-6)


def test_wrong_torque_shows_in_the_open_loop(push):
    wrong = replace(push, tau=push.tau + 1e-2)
    assert check(wrong).open_loop_joints > 1e-3


def test_internal_force_beyond_friction_shows_in_the_friction_margin_alone(stance, solo):
    data = solo.model.createData()
    extra = np.zeros((4, 6))
    direction = np.array([0.0, 2 * 0.16891, 0.0])  # front feet pull at each other, along their line
    extra[0, :3], extra[1, :3] = 40 * direction, -40 * direction
    pin.computeJointJacobians(solo.model, data, solo.reference)
    pin.updateFramePlacements(solo.model, data)
    torque = np.zeros(solo.nv)
    for index, contact in enumerate(solo.contacts):
        frame = solo.model.getFrameId(contact.frame)
        torque -= pin.getFrameJacobian(solo.model, data, frame, pin.LOCAL_WORLD_ALIGNED).T @ extra[index]
    wrong = replace(stance, f=stance.f + extra, tau=stance.tau + torque[6:])
    report = check(wrong)
    assert report.failures() == ("friction_margin",)
    share = 40 * direction[1] / solo.weight
    assert report.friction_margin == pytest.approx(0.7 * 0.25 - share, abs=1e-3)


def test_friction_between_points_is_reported_but_not_judged(stance):
    report = check(changed(stance, "f", (0, FOOT, 0), 100.0))
    assert report.ok
    assert report.friction_margin_between < 0


def test_force_of_an_inactive_contact_is_found(flight, solo):
    wrong = changed(flight, "f", (0, FOOT, 2), 0.1 * solo.weight)
    report = check(wrong)
    assert report.failures() == ("inactive_force",)
    assert report.inactive_force == pytest.approx(0.1)


def test_raised_robot_shows_as_hovering_feet_alone(stance):
    report = check(replace(stance, q=stance.q + 0.01 * np.eye(19)[2]))
    assert report.failures() == ("landing_height",)
    assert report.landing_height == pytest.approx(0.01)


def test_creeping_robot_shows_as_foot_drift_alone(stance):
    creep = np.outer(0.01 * stance.t / stance.t[-1], np.eye(19)[0])
    report = check(replace(stance, q=stance.q + creep))
    assert report.failures() == ("foot_drift",)
    assert report.foot_drift == pytest.approx(0.01)


def test_low_flight_shows_as_penetration_alone(flight):
    report = check(replace(flight, q=flight.q - 1.05 * np.eye(19)[2]))
    assert report.failures() == ("penetration",)
    assert report.penetration > 0.04
    raised = with_meta(flight, terrain={**flight.meta["terrain"], "height": 2.0})
    assert check(raised).failures() == ("penetration",)
    assert check(with_meta(flight, terrain=None)).penetration is None


def test_scaled_quaternion_shows_in_its_norm_alone(flight):
    scaled = flight.q.copy()
    scaled[:, 3:7] *= 1 + 1e-5
    report = check(replace(flight, q=scaled))
    assert report.failures() == ("quaternion_error",)
    assert report.quaternion_error == pytest.approx(1e-5, rel=1e-6)


def test_velocity_that_is_no_derivative_shows_in_the_position_gap(arm):
    wrong = replace(arm, q=arm.q + np.outer(arm.t, np.full(6, 1e-3)))
    step = arm.t[-1] / INTERVALS
    assert check(arm).position_gap < EXACT
    assert check(wrong).position_gap == pytest.approx(1e-3 * step, rel=1e-3)


def test_acceleration_that_is_no_derivative_shows_in_the_velocity_gap(arm):
    wrong = replace(arm, a=arm.a + 1e-2)
    assert check(wrong).velocity_gap == pytest.approx(1e-2 * arm.t[-1] / INTERVALS, rel=1e-3)


def test_moving_foot_shows_as_contact_velocity_and_acceleration(stance):
    report = check(changed(stance, "a", (POINT, 2), 0.981))
    assert report.contact_acceleration == pytest.approx(0.1)
    report = check(changed(stance, "v", (POINT, 2), 0.3))
    assert report.contact_velocity == pytest.approx(0.3)


@pytest.mark.parametrize(
    ("key", "figure"), [("effort_limit", "effort_excess"), ("velocity_limit", "velocity_excess")]
)
def test_exceeded_limit_is_found(arm, key, figure):
    values = {"effort_limit": arm.tau[arm.collocation], "velocity_limit": arm.v}[key]
    limit = np.abs(values).max(axis=0)
    limit[1] *= 0.8
    report = check(with_meta(arm, **{key: limit.tolist()}))
    assert report.failures() == (figure,)
    assert getattr(report, figure) == pytest.approx(0.25)
    assert getattr(check(with_meta(arm, **{key: None})), figure) is None


def test_exceeded_position_limit_is_found_as_part_of_the_range(arm):
    robot = robots.load("ur5")
    upper = robot.position_upper.copy()
    upper[0] = arm.q[:, 0].max() - 0.01
    model = pin.Model(arm.model)
    model.upperPositionLimit = upper
    report = check(replace(arm, model_text=model.saveToString()))
    assert report.failures() == ("position_excess",)
    assert report.position_excess == pytest.approx(0.01 / (upper[0] - robot.position_lower[0]))


def test_flight_that_is_pushed_is_neither_ballistic_nor_keeps_momentum(flight):
    faster = flight.v.copy()
    faster[:, 5] += 0.5 * flight.t
    report = check(replace(flight, v=faster))
    assert report.momentum_error > 1e-3
    assert not report.within(Tolerances(flight=1e-3))
    pushed = replace(flight, q=flight.q + np.outer(flight.t**2, np.eye(19)[0]))
    assert check(pushed).ballistic_error > 0.05


def test_open_loop_runs_phase_by_phase(solo):
    both = sampled(solo, [standing(solo), tumbling_flight(solo)], INTERVALS)
    stance_error, flight_error = open_loop(replace(both, tau=both.tau + 0.1 * (both.phase == 1)[:, None]))
    assert stance_error.position < EXACT
    assert flight_error.joints > 0.1
    report = check(both)
    assert [phase.contacts for phase in report.phases] == [both.contact_frames, ()]
    assert report.phases[1].ballistic_error < EXACT


def test_torque_that_runs_away_is_reported_as_infinite(flight):
    report = check(replace(flight, tau=flight.tau * 1e12))
    assert report.open_loop_joints == np.inf
    assert report.to_dict()["open_loop_joints"] is None
    assert not report.within(Tolerances(open_loop_joints=1.0))


def box_on_a_sole(offset: float) -> tuple[Robot, Motion]:
    """A box of 2 kg that rests on one sole, its centre of mass ``offset`` m before the sole's origin."""
    model = pin.Model()
    joint = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "root_joint")
    inertia = pin.Inertia(2.0, np.array([offset, 0.0, 0.3]), 0.01 * np.eye(3))
    model.appendBodyToJoint(joint, inertia, pin.SE3.Identity())
    model.addFrame(pin.Frame("sole", joint, 0, pin.SE3.Identity(), pin.FrameType.OP_FRAME))
    sole = Contact(frame="sole", kind="surface", half_length=0.1, half_width=0.05)
    robot = Robot.from_model(model, name="box", contacts=[sole])
    still, weight = np.zeros(6), 2 * 9.81
    wrench = np.array([[0.0, 0.0, weight, 0.0, -weight * offset, 0.0]])
    q = pin.neutral(model)
    return robot, Motion(
        duration=0.2,
        contacts=("sole",),
        q=lambda t: q,
        v=lambda t: still,
        a=lambda t: still,
        tau=lambda t: np.zeros(0),
        f=lambda t: wrench,
    )


@pytest.mark.parametrize(("offset", "failures"), [(0.03, ()), (0.12, ("sole_margin",))])
def test_surface_contact_holds_force_and_moment(offset, failures):
    robot, motion = box_on_a_sole(offset)
    report = check(sampled(robot, [motion], 3, contact_sizes=[[0.1, 0.05]]))
    assert report.failures() == failures
    assert report.sole_margin == pytest.approx(min(0.1 - offset, 0.7 * 0.075, 0.05))
    assert report.base_residual < EXACT
    assert report.foot_turn == 0
    assert report.open_loop_position < EXACT
    assert report.open_loop_orientation < EXACT


def test_turning_sole_is_measured():
    robot, motion = box_on_a_sole(0.0)
    still = sampled(robot, [motion], 3)
    turned = still.q.copy()
    turned[-1, 3:7] = pin.Quaternion(pin.exp3(np.array([0.0, 0.0, 0.2]))).coeffs()
    report = check(replace(still, q=turned))
    assert report.foot_turn == pytest.approx(0.2)
    assert report.sole_margin is None


def test_redundant_contacts_give_the_acceleration_of_the_independent_ones(solo):
    model = solo.model
    frames = [model.getFrameId(contact.frame) for contact in solo.contacts]
    random = np.random.default_rng(4)
    q = pin.integrate(model, solo.reference, 0.1 * random.standard_normal(solo.nv))
    v, force = random.standard_normal(solo.nv), random.standard_normal(solo.nv)
    once = ContactDynamics(model, frames, [3] * 4).acceleration(q, v, force)
    twice = ContactDynamics(model, frames * 2, [3] * 8).acceleration(q, v, force)
    np.testing.assert_allclose(twice, once, rtol=1e-8, atol=1e-8)


def test_forward_dynamics_without_contacts_is_that_of_pinocchio(solo):
    random = np.random.default_rng(5)
    q = pin.integrate(solo.model, solo.reference, random.standard_normal(solo.nv))
    v, force = random.standard_normal(solo.nv), random.standard_normal(solo.nv)
    expected = pin.aba(solo.model, solo.model.createData(), q, v, force)
    np.testing.assert_allclose(
        ContactDynamics(solo.model, [], []).acceleration(q, v, force), expected, rtol=1e-9
    )


def test_report_reads_as_table_and_as_json(stance, tmp_path):
    report = check(stance.save(tmp_path / "stance.npz"))
    entry = json.loads(json.dumps(report.to_dict(), allow_nan=False))
    assert entry["ok"] is True
    assert entry["foot_drift"] == report.foot_drift
    assert entry["phases"][0]["contacts"] == list(stance.contact_frames)
    wrong = check(replace(stance, q=stance.q - 0.1 * np.eye(19)[2]))
    beyond = [line for line in wrong.table().splitlines() if line.endswith("beyond")]
    assert [line.split("  ")[0] for line in beyond] == [
        "depth below the terrain",
        "height of contacts where they begin",
    ]


def test_tolerances_can_be_set_or_left_out(stance):
    raised = check(replace(stance, q=stance.q + 0.01 * np.eye(19)[2]))
    assert not raised.ok
    assert raised.within(Tolerances(foot_drift=None))
    assert raised.within(Tolerances(foot_drift=0.02))


def test_damaged_file_and_unknown_terrain_are_refused(stance, tmp_path):
    path = stance.save(tmp_path / "stance.npz")
    path.write_bytes(path.read_bytes()[:-100])
    with pytest.raises(SolutionFileError, match="truncated or damaged"):
        check(path)
    for terrain in (
        {"kind": "stairs"},
        "moon",
        {"kind": "flat", "height": "low"},
        {"kind": "flat", "normal": [0, 0, 0]},
    ):
        with pytest.raises(SolutionFileError, match="terrain"):
            check(with_meta(stance, terrain=terrain))


def test_check_does_not_use_casadi():
    code = (
        "import sys, trajopt; had = 'casadi' in sys.modules; import trajopt.check as c;"
        "sys.exit(not had and 'casadi' in sys.modules)"
    )
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
