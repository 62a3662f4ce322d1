"""The check: truth is accepted to rounding, and one corruption is found by its own figure."""

import json
from dataclasses import replace

import casadi
import numpy as np
import pinocchio as pin
import pytest

from tests.support.solved_problems import motion
from tests.support.synthetic_motions import planar_flight, pushing_off, sampled, tumbling_flight, with_meta
from trajopt import InputError, Robot, Solution, check
from trajopt.certify.report import FIGURES, OPEN_LOOP, Tolerances
from trajopt.errors import SolutionFileError
from trajopt_library import robots

INTERVALS = 20
EXACT = 1e-9  # motions are integrated to 1e-13; differences of accelerations lose some digits
INTERPOLATED = 1e-7  # between samples, a motion is that of polynomials of its points
POINT = 1  # the first collocation point
FOOT = 2


@pytest.fixture(scope="module")
def planar() -> Solution:
    solo = robots.load("solo12")
    feet = [contact.frame for contact in solo.contacts]
    robot = Robot.from_urdf(solo.visual.urdf, base="planar", contacts=feet, reference=solo.reference[7:])
    return sampled(robot, [planar_flight(robot)], INTERVALS)


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


@pytest.mark.parametrize(
    "points",
    [(0.5,), (1 / 3, 1.0), (0.0, 1.0), (0.0, 0.5, 1.0), (0.0,)],
    ids=["legendre", "radau", "trapezoidal", "simpson", "euler"],
)
def test_points_at_the_ends_of_an_interval_are_read(points, solo):
    report = check(sampled(solo, [pushing_off(solo, 0.05)], 50, points=points))
    assert report.ok
    assert report.open_loop_joints < 1e-3


def test_feet_of_a_push_neither_drift_nor_slip(push):
    report = check(push)
    assert report.contact_acceleration < EXACT
    assert report.contact_velocity < EXACT
    assert report.foot_drift < INTERPOLATED
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


def test_wrong_torque_shows_in_the_actuated_rows_and_in_what_it_does_alone(stance, solo):
    wrong = changed(stance, "tau", (POINT, 3), stance.tau[POINT, 3] + 1e-3 * solo.weight)
    report = check(wrong)
    assert report.failures()[0] == "actuated_residual"
    assert set(report.failures()[1:]) <= {"local_position", "local_joints", *OPEN_LOOP}
    assert report.actuated_residual == pytest.approx(1e-3, rel=1e-6)


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
    assert report.failures() == ("friction_margin", "friction_margin_between")
    share = 40 * direction[1] / solo.weight
    assert report.friction_margin == pytest.approx(0.7 * 0.25 - share, abs=1e-3)


def test_friction_at_a_node_is_judged_as_between_points(stance):
    report = check(changed(stance, "f", (0, FOOT, 0), 100.0))
    assert report.failures() == ("friction_margin_between",)
    place = report.places["friction_margin_between"]
    assert (place.time, place.name) == (0.0, stance.contact_frames[FOOT])


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
    assert report.failures()[:2] == ("foot_drift", "stance_drift")
    assert set(report.failures()[2:]) <= {"local_position", *OPEN_LOOP}
    assert report.foot_drift == pytest.approx(0.01)
    assert report.places["foot_drift"].time == stance.t[-1]


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
    assert report.failures() == (figure, f"{figure}_between")
    assert getattr(report, figure) == pytest.approx(0.25)
    assert report.places[figure].name == list(arm.model.names)[2]
    assert getattr(check(with_meta(arm, **{key: None})), figure) is None


def test_exceeded_position_limit_is_found_as_part_of_the_range(arm):
    robot = robots.load("ur5")
    upper = robot.position_upper.copy()
    upper[0] = arm.q[:, 0].max() - 0.01
    model = pin.Model(arm.model)
    model.upperPositionLimit = upper
    report = check(replace(arm, model=model))
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


def test_report_reads_as_table_and_as_json(stance, tmp_path):
    report = check(stance.save(tmp_path / "stance.npz"))
    entry = json.loads(json.dumps(report.to_dict(), allow_nan=False))
    assert entry["ok"] is True
    assert entry["foot_drift"] == report.foot_drift
    assert entry["phases"][0]["contacts"] == list(stance.contact_frames)
    wrong = check(replace(stance, q=stance.q - 0.1 * np.eye(19)[2]))
    beyond = [line for line in wrong.table().splitlines() if "  beyond  " in line]
    assert [line.split("  ")[0] for line in beyond] == [
        "depth below the terrain",
        "height of contacts where they begin",
    ]


def test_every_figure_has_a_tolerance_or_says_why_not():
    tolerances = Tolerances()
    for name, figure in FIGURES.items():
        judged = figure.tolerance is not None and getattr(tolerances, figure.tolerance) is not None
        assert judged != bool(figure.why), name


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


def test_solution_that_is_not_finite_is_refused(stance):
    with pytest.raises(InputError, match="'q' holds NaN"):
        check(changed(stance, "q", (0, 0), np.nan))


def test_vanishing_quaternion_is_a_figure_and_no_crash(stance):
    report = check(changed(stance, "q", (POINT, slice(3, 7)), 0.0))
    assert "quaternion_error" in report.failures()
    assert report.quaternion_error == 1


def test_check_does_not_use_casadi(stance, monkeypatch):
    def refuse(*_: object, **__: object) -> None:
        raise AssertionError("the check uses CasADi")

    for name in ("SX", "MX", "DM", "Function"):
        monkeypatch.setattr(casadi, name, refuse)
    assert check(stance).ok


def test_a_torque_that_chatters_is_said_with_its_joint():
    smooth = motion("ur5-reach")
    report = check(smooth)
    rough = smooth.tau.copy()
    limit = smooth.description.effort_limit[2]
    rough[:, 2] += 0.4 * limit * (-1.0) ** np.arange(len(rough))
    found = check(replace(smooth, tau=rough))
    assert report.chatter == ""
    assert report.torque_variation < 2
    assert found.torque_variation == pytest.approx(0.8 * (len(rough) - 1), rel=0.1)
    assert found.torque_reversals == len(rough) - 2
    assert f"the torque of {smooth.model.names[3]} changes by" in found.table()


def test_a_check_ends_with_its_verdict():
    plan = motion("ur5-reach")
    report = check(plan)
    assert str(report).splitlines()[-1].startswith("verdict: holds at all times")
    broken = check(replace(plan, tau=1.1 * plan.tau))
    assert broken.verdict().startswith("verdict: does not hold: actuated rows of the dynamics")
    assert broken.to_dict()["verdict"] == broken.verdict()
    simulated = check(plan.with_statistics(simulation={"kind": "test"}))
    assert simulated.verdict().startswith("verdict: a simulated run, which as a plan holds at all times")


def test_the_open_loop_of_an_unstable_phase_is_marked_and_does_not_count():
    report = check(motion("ur5-reach"))
    (phase,) = report.phases
    loose = replace(report, phases=(replace(phase, stable=False),), open_loop_joints=1.0)
    line = next(line for line in loose.table().splitlines() if line.startswith("open loop, joints"))
    assert "unstable" in line
    assert "beyond" not in line
    assert loose.ok
    assert f"{phase.name} is unstable without feedback" in loose.verdict()
