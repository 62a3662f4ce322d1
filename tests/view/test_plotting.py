"""Plots: what is drawn equals independent computations."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pinocchio as pin
from numpy.testing import assert_allclose

from tests.support.plots import arm, drawn, jump, lines, track_of
from tests.support.problems import hopper
from tests.support.symbolic_interpolation import SymbolicInterpolation
from tests.support.synthetic_motions import sampled, tumbling_flight
from trajopt.certify.check import check
from trajopt.solution.solution import Solution
from trajopt.view.plotting.joints import limbs_of
from trajopt.view.plotting.topics_contacts import stance_spans

# Two computations of the same numbers differ by rounding.
ROUNDING = 1e-9


def states(solution: Solution, t: np.ndarray) -> list[tuple[np.ndarray, np.ndarray]]:
    """States by the other implementation of the interpolation, on symbolic coordinates, inside intervals."""
    motion, found = SymbolicInterpolation(solution), []
    for time in t:
        index = int(np.searchsorted(solution.interval_t[:, 0], time, side="right")) - 1
        sample = motion.sample(max(index, 0), float(time))
        found.append((sample.q, sample.v))
    return found


def inner(solution: Solution, t: np.ndarray) -> np.ndarray:
    """Which times are no node, where a quantity may have two values."""
    return np.array([np.abs(solution.interval_t - time).min() > 1e-6 for time in t])


def test_momentum_is_that_of_numeric_pinocchio() -> None:
    solution = jump()
    model, data = solution.model, solution.model.createData()
    for panel, rows in (("linear momentum", slice(0, 3)), ("angular momentum", slice(3, 6))):
        shown = lines(drawn(solution, "momentum"), panel)
        for axis, name in enumerate("xyz"):
            t, y = shown[name]
            use = inner(solution, t)
            expected = []
            for q, v in states(solution, t[use]):
                pin.ccrba(model, data, q, v)
                expected.append(data.hg.vector[rows][axis])
            assert_allclose(y[use], expected, atol=ROUNDING)


def test_curves_pass_through_collocation_points() -> None:
    solution = jump()
    track = track_of(solution)
    figures = drawn(solution, "joints")
    for limb in limbs_of(track.axes, solution.model):
        for name, axis in zip(limb.short, limb.axes, strict=True):
            t, y = lines(figures, f"position:{limb.name}")[name]
            motion = [q[axis.column] for q, _ in states(solution, t)]
            use = inner(solution, t)
            assert_allclose(y[use], np.array(motion)[use], atol=ROUNDING)


def test_velocities_and_torques_jump_without_a_ramp() -> None:
    solution = jump()
    row = int(solution.impact_index[0])
    track = track_of(solution)
    t, y = track.curve(lambda motion: motion.solution.v[:, -1])
    at = np.flatnonzero(np.abs(t - solution.t[row]) < 1e-12)
    assert np.isnan(y[at]).sum() == 1
    assert_allclose(y[at][[0, -1]], [solution.v[row - 1, -1], solution.v[row, -1]], atol=ROUNDING)


def test_limits_are_those_of_the_solution() -> None:
    solution = jump()
    for axis in track_of(solution).axes:
        assert axis.effort == solution.meta["effort_limit"][axis.torque]
        assert axis.speed == solution.meta["velocity_limit"][axis.row]
        assert (axis.lower, axis.upper) == (
            solution.model.lowerPositionLimit[axis.column],
            solution.model.upperPositionLimit[axis.column],
        )


def test_a_limit_is_drawn_where_values_come_near_it() -> None:
    solution = jump()
    most = np.abs(solution.tau).max(axis=0)
    meta = {**solution.meta, "effort_limit": [float(1.05 * most[0]), float(1e3 * most[1])]}
    axes = next(a for a in drawn(replace(solution, meta=meta), "joints")[0].axes if "torque" in a.get_label())
    levels = {round(float(line.get_ydata()[0]), 6) for line in axes.get_lines() if len(line.get_ydata()) == 2}
    assert any(abs(abs(level) - 1.05 * most[0]) < 1e-5 for level in levels)
    assert not any(abs(level) > 2 * most.max() for level in levels)


def test_friction_shares_give_the_margin_of_the_check() -> None:
    solution = jump()
    motion = track_of(solution).points
    rows = solution.collocation & solution.active[:, 0]
    weight = motion.units.weight
    margin = (motion.cone - motion.tangential)[rows] / weight
    assert_allclose(margin.min(), check(solution).friction_margin, atol=ROUNDING)
    assert_allclose(motion.cone_share[rows], motion.tangential[rows] / (motion.cone[rows]), rtol=1e-9)


def test_contact_force_lines_are_the_files_forces() -> None:
    solution = jump()
    t, y = lines(drawn(solution, "forces"), "force:foot")["normal"]
    points = solution.t[solution.collocation & solution.active[:, 0]]
    force = solution.f[solution.collocation & solution.active[:, 0], 0, 2]
    dense = np.interp(points, t, y)  # the curve is linear between two points of degree two
    assert_allclose(dense, force, atol=1e-3 * np.abs(force).max())


def test_stances_are_where_contacts_are_active_whatever_the_phases() -> None:
    solution = jump()
    assert_allclose(stance_spans(track_of(solution), 0), [[0.0, 0.3], [0.5, 0.8]], atol=ROUNDING)
    active = solution.active.copy()
    active[solution.interval == 0] = False  # as a simulation may find: contacts come and go within a phase
    changed = stance_spans(track_of(replace(solution, active=active)), 0)
    assert_allclose(changed[0], [solution.interval_t[0, 1], 0.3], atol=ROUNDING)
    force = lines(drawn(solution, "forces"), "force:foot")["normal"][0]
    assert not ((force > 0.3) & (force < 0.5)).any()


def test_the_centre_of_pressure_is_where_tangential_moments_vanish() -> None:
    solution, model = jump(), jump().model
    motion, data = track_of(solution).points, model.createData()
    frame = model.getFrameId("foot")
    for row in np.flatnonzero(solution.collocation & solution.active[:, 0])[::5]:
        pin.framesForwardKinematics(model, data, solution.q[row])
        rotation = data.oMf[frame].rotation
        offset = rotation @ np.append(motion.pressure_centre[row, 0], 0.0)
        moment = solution.f[row, 0, 3:] - np.cross(offset, solution.f[row, 0, :3])
        assert_allclose((rotation.T @ moment)[:2], 0.0, atol=1e-9 * motion.units.weight)


def test_residuals_are_those_of_the_accuracy() -> None:
    solution = jump()
    track = track_of(solution)
    measured = track.accuracy
    shown = lines(drawn(solution, "accuracy"), "residual")
    assert_allclose(shown["base"][1].max(), measured.base_error, rtol=1e-6)
    assert_allclose(shown["actuated"][1].max(), measured.actuated_error, rtol=1e-6)
    local = lines(drawn(solution, "accuracy"), "local error")["interval"][1]
    assert_allclose(np.unique(local), np.unique(measured.interval_errors), rtol=1e-9)


def test_power_is_torque_of_the_drives_times_rate() -> None:
    solution = arm()
    t, y = lines(drawn(solution, "momentum"), "power")["all"]
    track = track_of(solution)
    joint_side = (solution.tau * solution.v).sum(axis=1)[solution.collocation]
    assert (track.points.power.sum(axis=1)[solution.collocation] >= joint_side - ROUNDING).all()
    assert len(t) == len(y) > solution.n_samples


def test_shares_of_drives_are_those_of_the_check() -> None:
    solution = arm()
    shown = lines(drawn(solution, "drives"), "torque_share:0")
    motion = track_of(solution).points
    excess = check(solution).drive_torque_excess
    most = max(
        np.abs(motion.drive_torque[solution.collocation, i]).max() / drive.joint_torque_limit
        for i, drive in enumerate(motion.drives)
        if np.isfinite(drive.torque_limit)
    )
    assert_allclose(most - 1, excess, atol=ROUNDING)
    assert max(y.max() for _, y in shown.values()) >= most - 1e-6


def test_the_summary_of_a_flip_counts_whole_turns() -> None:
    robot = hopper()
    motion = tumbling_flight(robot, 1.2)
    track = track_of(sampled(robot, [motion], 20))
    angles = track.dense.base_angles
    assert np.abs(np.diff(angles, axis=0)).max() < np.pi / 2  # no jump
    for row in (0, 57, len(angles) - 1):
        turned = pin.rpy.rpyToMatrix(*angles[row])
        quaternion = pin.Quaternion(np.array(track.dense.solution.q[row, 3:7]))
        assert_allclose(turned, quaternion.toRotationMatrix(), atol=ROUNDING)
