"""Plots: what is drawn equals independent computations; pages by robot; texts, colours, bad input."""

from __future__ import annotations

import importlib.metadata
from dataclasses import replace
from functools import lru_cache
from itertools import combinations
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from numpy.testing import assert_allclose

from tests.support.problems import hop, hopper, one_joint_arm, planar_hopper
from tests.support.symbolic_interpolation import SymbolicInterpolation
from tests.support.synthetic_motions import arm_motion, sampled, tumbling_flight
from trajopt import solve
from trajopt.certify.check import check
from trajopt.errors import InputError
from trajopt.robot.robot import Robot
from trajopt.schedule.schedule import Phase, Schedule
from trajopt.solution.solution import Solution
from trajopt.view.plotting import style
from trajopt.view.plotting.figure import figure_of
from trajopt.view.plotting.joints import limbs_of
from trajopt.view.plotting.summary import PAGES, pages_of
from trajopt.view.plotting.topics_contacts import stance_spans
from trajopt.view.plotting.track import Track, tracks_of
from trajopt.view.plotting.writing import write_plots
from trajopt_library import robots

# Two computations of the same numbers differ by rounding.
ROUNDING = 1e-9
# CIE 1976 distance of two colours: about 2.3 is a just noticeable difference, 15 is told apart at a glance.
APART = 15.0
# Overlap of two texts' boxes in pixels that is no contact of letters: boxes have empty edges.
EDGE = 2.0
TALOS = "cmeel.prefix/share/example-robot-data/robots/talos_data/robots/talos_full_v2.urdf"


@lru_cache
def jump() -> Solution:
    """A hop of a floating robot with a sole that lands by an impact: phases, forces, impulses."""
    phases = (
        Phase(name="stance", duration=0.3, contacts=("foot",)),
        Phase(name="flight", duration=0.2),
        Phase(name="landing", duration=0.3, contacts=("foot",), impact=True),
    )
    return solve(hop("surface", schedule=Schedule(phases)), compile="none")


@lru_cache
def arm() -> Solution:
    robot = robots.load("irb1600")
    drives = [None if drive is None else drive.to_meta() for drive in robot.drives]
    return sampled(robot, [arm_motion(robot)], 6, drives=drives)


@lru_cache
def many_joints() -> Solution:
    """A humanoid of 44 joints with grippers, tumbling."""
    urdf = importlib.metadata.distribution("example-robot-data").locate_file(TALOS)
    robot = Robot.from_urdf(Path(str(urdf)), name="talos_full")
    return sampled(robot, [tumbling_flight(robot, 0.05)], 2)


def track_of(solution: Solution) -> Track:
    return tracks_of([solution])[0]


def drawn(solution: Solution, name: str, *others: Solution) -> list[Figure]:
    tracks = tracks_of([solution, *others])
    return [figure_of(page, tracks, fixed=True) for page in pages_of(tracks, [name])]


def lines(figures: list[Figure], panel: str) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Data of the named lines of a panel, without gaps."""
    found = {}
    for axes in (axes for figure in figures for axes in figure.axes if axes.get_label() == panel):
        for line in axes.get_lines():
            name = str(line.get_label())
            if not name.startswith("_"):
                x, y = (np.asarray(values, dtype=float) for values in line.get_data())
                keep = np.isfinite(y)
                found[name.partition("/")[0]] = (x[keep], y[keep])
    assert found, f"no panel {panel}"
    return found


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


@pytest.mark.parametrize(
    ("solution", "names"),
    [
        (jump, {"summary", "limits", "joints", "forces", "soles", "base", "momentum", "accuracy"}),
        (arm, {"summary", "limits", "joints", "drives", "momentum", "accuracy"}),
        (many_joints, {"summary", "limits", "joints", "base", "momentum", "accuracy"}),
    ],
)
def test_pages_are_those_that_the_robot_has_something_for(solution: object, names: set[str]) -> None:
    tracks = tracks_of([solution()])
    assert {page.name for page in pages_of(tracks, list(PAGES))} == names


@pytest.mark.parametrize("solution", [jump, arm, many_joints])
@pytest.mark.parametrize("name", ["summary", "limits", "joints"])
def test_no_text_lies_on_another(solution: object, name: str) -> None:
    for figure in drawn(solution(), name):
        renderer = FigureCanvasAgg(figure).get_renderer()
        figure.draw(renderer)
        boxes = [(text, box) for text in texts(figure) for box in [text.get_window_extent(renderer)]]
        for (one, a), (two, b) in combinations(boxes, 2):
            width = min(a.x1, b.x1) - max(a.x0, b.x0)
            height = min(a.y1, b.y1) - max(a.y0, b.y0)
            assert width < EDGE or height < EDGE, f"'{one.get_text()}' on '{two.get_text()}'"


def texts(figure: Figure) -> list[object]:
    """Texts that are seen: not ticks outside the view, which matplotlib keeps but does not draw."""
    from matplotlib.axis import Axis
    from matplotlib.text import Text

    kept = []
    hidden = set()
    for axis in figure.findobj(Axis):
        for tick in axis.get_major_ticks():
            low, high = sorted(axis.get_view_interval())
            if not low <= tick.get_loc() <= high:
                hidden |= {tick.label1, tick.label2}
            if not tick.label1.get_visible():
                hidden.add(tick.label1)
            if not tick.label2.get_visible():
                hidden.add(tick.label2)
    for text in figure.findobj(Text):
        if text.get_visible() and text.get_text().strip() and text not in hidden:
            kept.append(text)
    return kept


# Machado, Oliveira, Fernandes, "A physiologically-based model for simulation of color vision deficiency",
# IEEE TVCG 2009, severity 1, on linear RGB.
DEFICIENCIES = {
    "none": np.eye(3),
    "protanopia": [
        [0.152286, 1.052583, -0.204868], [0.114503, 0.786281, 0.099216], [-0.003882, -0.048116, 1.051998]
    ],
    "deuteranopia": [
        [0.367322, 0.860646, -0.227968], [0.280085, 0.672501, 0.047413], [-0.011820, 0.042940, 0.968881]
    ],
    "tritanopia": [
        [1.255528, -0.076749, -0.178779], [-0.078411, 0.930809, 0.147602], [0.004733, 0.691367, 0.303900]
    ],
}  # fmt: skip


@pytest.mark.parametrize("kind", DEFICIENCIES)
def test_colours_are_told_apart_by_colour_blind_eyes(kind: str) -> None:
    seen = [lab(colour, np.array(DEFICIENCIES[kind])) for colour in (*style.COLOURS, "white")]
    distances = {
        (a, b): float(np.linalg.norm(seen[a] - seen[b])) for a, b in combinations(range(len(seen)), 2)
    }
    assert min(distances.values()) > APART, min(distances, key=distances.get)


def lab(colour: str, deficiency: np.ndarray) -> np.ndarray:
    """CIE L*a*b* (D65) of an sRGB colour as a deficient eye sees it."""
    value = np.array(to_rgb(colour))
    linear = np.where(value <= 0.04045, value / 12.92, ((value + 0.055) / 1.055) ** 2.4)
    linear = np.clip(deficiency @ linear, 0.0, 1.0)
    to_xyz = np.array([[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]])
    ratio = to_xyz @ linear / (to_xyz @ np.ones(3))
    f = np.where(ratio > (6 / 29) ** 3, np.cbrt(ratio), ratio / (3 * (6 / 29) ** 2) + 4 / 29)
    return np.array([116 * f[1] - 16, 500 * (f[0] - f[1]), 200 * (f[1] - f[2])])


def test_shares_darken_evenly_so_that_grey_print_shows_them() -> None:
    import matplotlib as mpl

    ramp = mpl.colormaps[style.SHARES](np.linspace(0, 1, 32))[:, :3]
    lightness = [lab(tuple(colour), np.eye(3))[0] for colour in ramp]
    assert (np.diff(lightness) < 0).all()


def test_curves_of_one_panel_have_different_markers_and_solutions_different_lines() -> None:
    assert len(set(style.MARKERS)) == len(style.MARKERS) >= len(style.COLOURS)
    assert len(set(style.LINES)) == len(style.LINES) >= 4


def test_limbs_follow_the_tree_and_not_names() -> None:
    solution = many_joints()
    model = pin.Model(solution.model)
    found = limbs_of(track_of(solution).axes, model)
    assert sum(len(limb.axes) for limb in found) == model.nv - 6
    assert max(len(limb.axes) for limb in found) <= len(style.COLOURS)
    for number in range(1, model.njoints):
        model.names[number] = f"j{number}"
    renamed = Track(label="renamed", solution=replace(solution, model_text=model.saveToString()))
    again = limbs_of(renamed.axes, renamed.solution.model)
    assert [[axis.row for axis in limb.axes] for limb in again] == [
        [axis.row for axis in limb.axes] for limb in found
    ]


def test_an_iterate_that_is_not_finite_is_plotted_as_far_as_it_goes(tmp_path: Path) -> None:
    solution = jump()
    q, v = solution.q.copy(), solution.v.copy()
    q[20:], v[20:] = np.nan, np.nan
    meta = {**solution.meta, "success": False, "status": "not_finite"}
    broken = replace(solution, q=q, v=v, meta=meta)
    shown = lines(
        drawn(broken, "joints"), "position:" + limbs_of(track_of(broken).axes, broken.model)[0].name
    )
    assert all(0 < t.max() < solution.t[-1] for t, _ in shown.values())
    figure = drawn(broken, "summary")[0]
    said = " ".join(text.get_text() for text in figure.texts)
    assert "NOT SOLVED" in said
    assert "NOT FINITE" in said
    assert write_plots(broken, tmp_path / "broken.html").size > 0


@pytest.mark.parametrize("actuation", ["torque", "velocity", "acceleration"])
def test_one_interval_and_one_joint_are_enough(tmp_path: Path, actuation: str) -> None:
    robot = one_joint_arm()
    solution = sampled(robot, [arm_motion(robot)], 1, actuation=actuation)
    assert write_plots(solution, tmp_path / "one.png", pages=list(PAGES)).size > 0


def test_a_robot_in_a_plane_shows_what_moves_in_it(tmp_path: Path) -> None:
    from tests.support.synthetic_motions import planar_flight

    robot = planar_hopper()
    solution = sampled(robot, [planar_flight(robot)], 4)
    assert set(lines(drawn(solution, "base"), "base position")) == {"x", "z"}
    assert set(lines(drawn(solution, "base"), "base orientation")) == {"pitch"}


def test_solutions_are_overlaid_with_a_line_of_their_own() -> None:
    solution = arm()
    other = replace(solution, meta={**solution.meta, "simulated": True})
    axes = drawn(solution, "joints", other)[0].axes[0]
    styles = {}
    for line in axes.get_lines():
        name = str(line.get_label())
        if not name.startswith("_"):
            styles.setdefault(name.partition("/")[2], set()).add(line.get_linestyle())
    assert set(styles) == {"plan", "simulation"}
    assert styles["plan"].isdisjoint(styles["simulation"])


def test_every_ending_is_written_and_html_needs_no_network(tmp_path: Path) -> None:
    solution, heads = arm(), {".png": b"\x89PNG", ".svg": b"<svg", ".pdf": b"%PDF", ".html": b"<!doctype"}
    for ending, head in heads.items():
        plotted = write_plots(solution, tmp_path / f"arm{ending}", pages=["summary", "joints"])
        content = plotted.path.read_bytes()
        assert content.startswith(head)
        assert plotted.size == len(content)
    page = (tmp_path / "arm.html").read_text()
    assert 'src="http' not in page
    assert 'href="http' not in page
    ids = [part.split('"')[0] for part in page.split(' id="')[1:]]
    assert len(ids) == len(set(ids))
    for name in ("problem", "iterations", "torque beyond its limit", "local error of one interval"):
        assert name in page


def test_pdf_pages_are_a4(tmp_path: Path) -> None:
    content = write_plots(arm(), tmp_path / "arm.pdf", pages=["joints"]).path.read_bytes()
    assert b"/MediaBox [ 0 0 595.44 841.68 ]" in content


def test_bad_input_is_one_line(tmp_path: Path) -> None:
    solution, place = arm(), tmp_path / "a.png"
    cases = [
        (lambda: write_plots(solution, tmp_path / "a.gif"), "'.gif'"),
        (lambda: write_plots(solution, tmp_path / "none" / "a.png"), "does not exist"),
        (lambda: write_plots(tmp_path / "none.npz", place), "does not exist"),
        (lambda: write_plots(solution, place, pages=["forces"]), "allowed: summary"),
        (lambda: write_plots(solution, place, pages=["force"]), "'force' is unknown"),
        (lambda: write_plots([solution, solution], place, labels=["one"]), "1 labels for 2 solutions"),
        (lambda: write_plots([], place), "no solution"),
        (lambda: write_plots([solution, jump()], place), "one robot"),
    ]
    for call, words in cases:
        with pytest.raises(InputError, match=words) as caught:
            call()
        assert "\n" not in str(caught.value)
    assert list(tmp_path.iterdir()) == []
