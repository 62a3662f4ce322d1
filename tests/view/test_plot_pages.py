"""Plots as pages: which there are, texts and colours that are told apart, files, bad input."""

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
from matplotlib.text import Text

import trajopt
from tests.support.plots import arm, drawn, jump, lines, panels, track_of
from tests.support.problems import one_joint_arm, planar_hopper
from tests.support.synthetic_motions import arm_motion, sampled, tumbling_flight, with_meta
from trajopt import InputError, Robot, Solution
from trajopt.robot import read_urdf
from trajopt.view.plotting import style, write_plots
from trajopt.view.plotting.joints import limbs_of
from trajopt.view.plotting.track import Track, tracks_of
from trajopt.view.plotting.writing import TOPICS, sheet_of

# CIE 1976 distance of two colours: about 2.3 is a just noticeable difference, 15 is told apart at a glance.
APART = 15.0
# Overlap of two texts' boxes in pixels that is no contact of letters: boxes have empty edges.
EDGE = 2.0
TALOS = "cmeel.prefix/share/example-robot-data/robots/talos_data/robots/talos_full_v2.urdf"


@lru_cache
def many_joints() -> Solution:
    """A humanoid of 44 joints with grippers, tumbling."""
    urdf = importlib.metadata.distribution("example-robot-data").locate_file(TALOS)
    model = read_urdf(Path(str(urdf)), "freeflyer")  # fingers that mimic others, as independent joints
    robot = Robot.from_model(model, name="talos_full")
    return sampled(robot, [tumbling_flight(robot, 0.05)], 2)


@lru_cache
def flight() -> Solution:
    """A quadrotor, which has thrusters and no joints."""
    return trajopt.solve(trajopt.load("quadrotor-window"), draft=True)


@pytest.mark.parametrize(
    ("solution", "names"),
    [
        (flight, {"summary", "base", "momentum", "clearance", "accuracy"}),
        (jump, {"summary", "limits", "joints", "forces", "soles", "base", "momentum", "accuracy"}),
        (arm, {"summary", "limits", "joints", "drives", "momentum", "accuracy"}),
        (many_joints, {"summary", "limits", "joints", "base", "momentum", "accuracy"}),
    ],
)
def test_pages_are_those_that_the_robot_has_something_for(solution: object, names: set[str]) -> None:
    assert set(sheet_of(tracks_of([solution()]), list(TOPICS)).topics) == names


@pytest.mark.long
@pytest.mark.parametrize(
    ("solution", "name"),
    [
        (jump, "summary"), (jump, "forces"), (arm, "drives"),
        (many_joints, "summary"), (many_joints, "limits"), (many_joints, "joints"),
    ],
)  # fmt: skip
def test_no_text_lies_on_another_or_beyond_the_page(solution: object, name: str) -> None:
    figure = drawn(solution(), name)
    renderer = FigureCanvasAgg(figure).get_renderer()
    figure.draw(renderer)
    width, height = figure.canvas.get_width_height()
    boxes = [(text, box) for text in texts(figure) for box in [text.get_window_extent(renderer)]]
    for text, box in boxes:
        assert box.x0 >= 0 <= box.y0, text.get_text()
        assert box.x1 <= width, text.get_text()
        assert box.y1 <= height, text.get_text()
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


def test_forces_of_thrusters_are_drawn_between_their_limits() -> None:
    figure = drawn(flight(), "base")
    (axes,) = (axes for axes in panels(figure) if axes.get_ylabel() == "force u [N]")
    assert {f"rotor_{i}" for i in range(4)} <= {line.get_label() for line in axes.lines}
    levels = {float(line.get_ydata()[0]) for line in axes.lines if len(set(line.get_ydata())) == 1}
    assert {0.0, flight().description.thrusters[0].most} <= levels


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
    renamed = Track(label="renamed", solution=replace(solution, model=model))
    again = limbs_of(renamed.axes, renamed.solution.model)
    assert [[axis.row for axis in limb.axes] for limb in again] == [
        [axis.row for axis in limb.axes] for limb in found
    ]


@pytest.mark.long
def test_an_iterate_that_is_not_finite_is_plotted_as_far_as_it_goes(tmp_path: Path) -> None:
    solution = jump()
    q, v = solution.q.copy(), solution.v.copy()
    q[20:], v[20:] = np.nan, np.nan
    failed = solution.with_statistics(success=False, status="not_finite")
    broken = replace(failed, q=q, v=v)
    shown = lines(
        drawn(broken, "joints"), "position:" + limbs_of(track_of(broken).axes, broken.model)[0].name
    )
    assert all(0 < t.max() < solution.t[-1] for t, _ in shown.values())
    figure = drawn(broken, "summary")
    said = " ".join(text.get_text() for text in figure.findobj(Text))
    assert "NOT SOLVED" in said
    assert "NOT FINITE" in said
    assert write_plots(broken, tmp_path / "broken.html", pages=["summary", "accuracy"]).size > 0


@pytest.mark.parametrize("actuation", ["torque", "velocity", "acceleration"])
def test_one_interval_and_one_joint_are_enough(actuation: str) -> None:
    robot = one_joint_arm()
    tracks = tracks_of([sampled(robot, [arm_motion(robot)], 1, actuation=actuation)])
    sheet = sheet_of(tracks, list(TOPICS))
    assert panels(sheet.figure)
    assert "joints" in sheet.topics


def test_a_robot_in_a_plane_shows_what_moves_in_it(tmp_path: Path) -> None:
    from tests.support.synthetic_motions import planar_flight

    robot = planar_hopper()
    solution = sampled(robot, [planar_flight(robot)], 4)
    assert set(lines(drawn(solution, "base"), "base position")) == {"x", "z"}
    assert set(lines(drawn(solution, "base"), "base orientation")) == {"pitch"}


def test_solutions_are_overlaid_with_a_line_of_their_own() -> None:
    solution = arm()
    other = with_meta(solution, simulation={})
    figure = drawn(solution, "joints", other)
    styles: dict[str, list[str]] = {}
    for line in panels(figure)[0].get_lines():
        if not str(line.get_label()).startswith("_"):
            styles.setdefault(line.get_label(), []).append(line.get_linestyle())
    assert len(styles) > 1
    assert all(first != second for first, second in styles.values())
    words = " ".join(text.get_text() for text in figure.findobj(Text))
    assert "plan:" in words
    assert "simulation:" in words


@pytest.mark.long
def test_every_ending_is_written_and_html_needs_no_network(tmp_path: Path) -> None:
    # several pages as one picture, and pages of a document
    solution, heads = arm(), {".png": b"\x89PNG", ".svg": b"<?xml", ".pdf": b"%PDF", ".html": b"<!doctype"}
    for ending, head in heads.items():
        plotted = write_plots(solution, tmp_path / f"arm{ending}", pages=["joints", "momentum"])
        content = plotted.path.read_bytes()
        assert content.startswith(head)
        assert plotted.size == len(content)
    page = (tmp_path / "arm.html").read_text()
    assert 'src="http' not in page
    assert 'href="http' not in page
    ids = [part.split('"')[0] for part in page.split(' id="')[1:]]
    assert len(ids) == len(set(ids))
    document = (tmp_path / "arm.pdf").read_bytes()
    assert document.count(b"/MediaBox [ 0 0 595.44 ") == 2  # a page for each topic, as wide as A4
    for name in ("problem", "iterations", "torque beyond its limit", "local error of one interval"):
        assert name in page


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
