"""Plots: what is drawn equals independent computations."""

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from matplotlib.figure import Figure
from matplotlib.text import Text
from numpy.testing import assert_allclose

from tests.support.plots import arm, drawn, jump, lines, panels, standing, track_of
from tests.support.problems import hopper
from tests.support.symbolic_interpolation import SymbolicInterpolation
from tests.support.synthetic_motions import sampled, tumbling_flight, with_meta
from trajopt import Solution, check
from trajopt.view.plotting.joints import limbs_of
from trajopt.view.plotting.topics_contacts import NORMAL, stance_spans

pytestmark = pytest.mark.long

# A limit as descriptions have where nobody knew better.
PLACEHOLDER = 5000.0
BEYOND = {
    "velocity": "limits 5000 rad/s, 5000 m/s, beyond the axis",
    "torque": "limits 5000 N m, 5000 N, beyond the axis",
}
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
    figure = drawn(solution, "joints")
    for limb in limbs_of(track.axes, solution.model):
        for name, axis in zip(limb.short, limb.axes, strict=True):
            t, y = lines(figure, f"position:{limb.name}")[name]
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
        assert axis.effort == solution.description.effort_limit[axis.torque]
        assert axis.speed == solution.description.velocity_limit[axis.row]
        assert (axis.lower, axis.upper) == (
            solution.model.lowerPositionLimit[axis.column],
            solution.model.upperPositionLimit[axis.column],
        )


def test_a_limit_is_drawn_where_values_come_near_it() -> None:
    solution = jump()
    most = np.abs(solution.tau).max(axis=0)
    limited = solution.with_description(effort_limit=np.array([1.05 * most[0], 1e3 * most[1]]))
    figure = drawn(limited, "joints")
    axes = next(axes for axes in panels(figure) if "torque" in axes.get_label())
    levels = {round(float(line.get_ydata()[0]), 6) for line in axes.get_lines() if len(line.get_ydata()) == 2}
    assert any(abs(abs(level) - 1.05 * most[0]) < 1e-5 for level in levels)
    assert not any(abs(level) > 2 * most.max() for level in levels)


@pytest.fixture
def unlimited() -> Solution:
    """A jump of a robot whose limits are placeholders."""
    solution = jump()
    speed, effort = (len(solution.meta[f"{name}_limit"]) * [PLACEHOLDER] for name in ("velocity", "effort"))
    return with_meta(solution, velocity_limit=speed, effort_limit=effort)


def used_of(solution: Solution) -> dict[str, float]:
    """The largest velocity and torque of the interpolated motion."""
    dense = track_of(solution).dense.solution
    return {
        "velocity": float(np.abs(dense.v[:, dense.n_unactuated :]).max()),
        "torque": float(np.abs(dense.tau).max()),
    }


def words_of(figure: Figure) -> str:
    return "\n".join(text.get_text() for text in figure.findobj(Text))


@pytest.mark.parametrize("kind", ["velocity", "torque"])
def test_panels_with_placeholders_are_scaled_by_what_is_used_and_say_so(
    unlimited: Solution, kind: str
) -> None:
    figure = drawn(unlimited, "joints")
    shown = [axes for axes in panels(figure) if axes.get_label().startswith(kind)]
    used = used_of(unlimited)[kind]
    assert shown
    assert all(max(np.abs(axes.get_ylim())) < 1.5 * used for axes in shown)
    assert BEYOND[kind] in words_of(figure)


@pytest.mark.parametrize("page", ["summary", "limits"])
def test_maps_with_placeholders_are_of_the_largest_value_used_and_say_so(
    unlimited: Solution, page: str
) -> None:
    figure = drawn(unlimited, page)
    for kind, used in used_of(unlimited).items():
        image = next(a for a in panels(figure) if a.get_label() == f"share:{kind}:0").get_images()[0]
        assert np.nanmax(np.asarray(image.get_array())) == pytest.approx(1.0, abs=0.02)
        assert f"{kind}, 100 % is {used:.3g} " in words_of(figure)
        assert BEYOND[kind] in words_of(figure)


def test_shares_of_placeholders_are_curves_that_fill_their_panel(unlimited: Solution) -> None:
    figure = drawn(unlimited, "limits")
    axes = next(axes for axes in panels(figure) if axes.get_label() == "used:torque")
    assert axes.get_ylim()[1] < 1.5 * used_of(unlimited)["torque"] / PLACEHOLDER
    assert "limit 1, beyond the axis" in words_of(figure)


def test_limits_that_matter_are_not_called_beyond_the_axis() -> None:
    solution = jump()
    most = np.abs(solution.tau).max()
    for limit in (1.01 * most, 1.3 * most):
        limited = solution.with_description(effort_limit=np.full(solution.tau.shape[1], float(limit)))
        assert "N m, beyond" not in words_of(drawn(limited, "joints"))


@pytest.mark.parametrize("page", ["summary", "limits"])
def test_maps_have_a_colour_bar(page: str) -> None:
    bars = [axes for axes in panels(drawn(jump(), page)) if axes.get_label() == "scale"]
    assert len(bars) == 1
    assert [label.get_text() for label in bars[0].get_yticklabels()] == ["0", "50", "100 %"]


def test_the_summary_of_a_legged_robot_shows_torques() -> None:
    solution = jump()
    figure = drawn(solution, "summary")
    limb = limbs_of(track_of(solution).axes, solution.model)[0]
    shown = lines(figure, f"torque:{limb.name}")
    assert set(shown) == set(limb.short)
    for name, axis in zip(limb.short, limb.axes, strict=True):
        assert_allclose(np.abs(shown[name][1]).max(), np.abs(solution.tau[:, axis.torque]).max(), rtol=0.05)


def test_friction_cones_have_a_legend() -> None:
    words = words_of(drawn(jump(), "forces"))
    assert "f\u209c \u2264 \u03bc f\u2099" in words
    assert "\u03bc = " in words


def test_curves_of_several_feet_differ_by_line_style_and_in_the_legend_too() -> None:
    solution = standing()
    figure = drawn(solution, "summary")
    axes = next(axes for axes in panels(figure) if axes.get_label() == "normal")
    styles = {repr(line._unscaled_dash_pattern) for line in axes.get_lines()}  # type: ignore[attr-defined]
    assert len(axes.get_lines()) == len(styles) == len(solution.contact_frames) == 4
    entries = axes.get_legend().get_lines()
    assert len({repr(line._unscaled_dash_pattern) for line in entries}) == 4  # type: ignore[attr-defined]


def test_curves_of_several_solutions_keep_the_solutions_line_style_and_differ_by_width() -> None:
    solution = standing()
    figure = drawn(solution, "summary", solution)
    axes = next(axes for axes in panels(figure) if axes.get_label() == "normal")
    curves = [line for line in axes.get_lines() if line.get_linestyle() != "None"]  # no points
    first, second = curves[:4], curves[4:]
    assert {line.get_linestyle() for line in first} == {"-"}
    assert {line.get_linestyle() for line in second} == {"--"}
    assert len({line.get_linewidth() for line in first}) == 4


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
    t, y = lines(drawn(solution, "forces"), "force:foot")[NORMAL]
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
    force = lines(drawn(solution, "forces"), "force:foot")[NORMAL][0]
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
