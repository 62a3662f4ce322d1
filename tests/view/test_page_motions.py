"""Pages in Chromium at three times: parts against numeric Pinocchio, pixels, clock; playing; no network."""

import contextlib
import os
import re
import signal

import numpy as np
import pinocchio as pin
import pytest
from numpy.testing import assert_allclose

import trajopt
from tests.support.browser import (
    boxes,
    descendants,
    drawn_by,
    extent,
    pixels_of,
    placements,
    require_chromium,
    until,
)
from tests.support.refusals import refused
from tests.support.synthetic_motions import arm_motion, sampled
from trajopt import Solution, TrajoptError, replay
from trajopt.motion.configurations import geodesic_configurations
from trajopt.problem import families
from trajopt.view.replay.browser import EXECUTABLE_VARIABLE, chromium, find_chromium, open_page
from trajopt.view.replay.robot import joint_path
from trajopt_library import robots

pytestmark = pytest.mark.long

SIZE = (480, 360)
INTERVALS = 20
# s, of frames at 60 a second: in stance, flight and landing of the jump; the last one after an arm's end.
TIMES, ARM_TIME = (0.3, 0.5, 1.0), 0.8
# A page leaves frames out where that moves a joint by at most 2e-4 of the robot and turns it by 5e-4 rad.
PLACE, TURN = 3e-4, 1e-3
# Pixels: the half width of an arrow's head, drawn smooth.
ARROW = 4.0
ARROW_SCALE = r"forces: ([0-9.]+) m is the weight, ([0-9.]+) N"
ABOUT = "document.getElementById('caption').textContent"
# The middle of a silhouette moves as the projected joints do but for this part of its height: legs fold.
MIDDLE = 0.25


@pytest.fixture(scope="module")
def jump() -> Solution:
    problem = families()["solo12-jump"].load({})
    return trajopt.solve(problem, intervals=INTERVALS)


@pytest.fixture(scope="module")
def arm() -> Solution:
    robot = robots.load("ur5")
    return sampled(robot, [arm_motion(robot, duration=ARM_TIME)], INTERVALS, visual=robot.visual.to_meta())


@pytest.fixture(scope="module")
def pages(jump, arm, tmp_path_factory) -> dict:
    require_chromium()
    folder = tmp_path_factory.mktemp("pages")
    shown = {"jump": [jump], "arm": [arm], "both": [jump, arm]}
    layout = "side-by-side"
    return {name: replay(s, html=folder / f"{name}.html", layout=layout) for name, s in shown.items()}


def kinematics(solution: Solution, t: float) -> list[pin.SE3]:
    """World placements of all joints but the universe; after its end a motion stands still."""
    data = solution.model.createData()
    pin.forwardKinematics(solution.model, data, geodesic_configurations(solution, t))
    return [data.oMi[joint].copy() for joint in range(1, solution.model.njoints)]


def phase_at(solution: Solution, t: float) -> str:
    rows = max(rows.start for rows in solution.phases if solution.t[rows.start] <= t)
    return solution.description.phase_names[solution.phase[rows]]


@pytest.mark.parametrize("name", ["jump", "arm", "both"])
def test_every_joint_is_where_numeric_kinematics_puts_it(browser, pages, jump, arm, name):
    runs = {"jump": {"": jump}, "arm": {"": arm}, "both": {"run0": jump, "run1": arm}}[name]
    with browser.opened(pages[name].html, SIZE) as view:
        for t in TIMES:
            view.seek(t)
            assert view.state()["time"] == pytest.approx(min(t, view.start + view.duration))
            for root, solution in runs.items():
                names = [joint_path(solution.model, joint) for joint in range(1, solution.model.njoints)]
                paths = [f"{root}/{path}" if root else path for path in names]
                expected = kinematics(solution, t)
                for path, found, place in zip(paths, placements(view, paths, root), expected, strict=True):
                    size = pages[name].facts["size"]
                    assert_allclose(found[:3, 3], place.translation, atol=PLACE * size, err_msg=path)
                    assert np.linalg.norm(pin.log3(place.rotation.T @ found[:3, :3])) < TURN, path
        assert view.errors == []


def test_runs_beside_each_other_do_not_touch(browser, pages):
    with browser.opened(pages["both"].html, SIZE) as view:
        first, second = boxes(view, ["run0/robot", "run1/robot"])
        assert ((first[1] < second[0]) | (second[1] < first[0])).any()


def test_clock_tells_time_and_phase(browser, pages, jump):
    with browser.opened(pages["jump"].html, SIZE) as view:
        for t in TIMES:
            view.seek(t)
            text = view.evaluate("document.getElementById('clock').textContent")
            told = re.match(r"t = ([0-9.]+) s\s+(\w+)", text)
            assert float(told[1]) == pytest.approx(t, abs=0.005)  # two decimals
            assert told[2] == view.state()["phase"] == phase_at(jump, t)


def test_pixels_of_the_robot_move_as_its_joints_do(browser, pages, jump):
    middles, projected = [], []
    with browser.opened(pages["jump"].html, SIZE, "t=0&camera=overview&bare") as view:
        for t in TIMES:
            view.seek(t)
            centres = np.array([place.translation for place in kinematics(jump, t)])
            pixels = pixels_of(view, centres, SIZE)
            left_top, right_bottom = extent(drawn_by(view, "robot"))
            assert (pixels > left_top).all()
            assert (pixels < right_bottom).all()
            middles.append((left_top + right_bottom) / 2)
            projected.append(pixels.mean(axis=0))
            height = right_bottom[1] - left_top[1]
    moved, expected = np.diff(middles, axis=0), np.diff(projected, axis=0)
    assert np.linalg.norm(expected, axis=1).min() > height / 8
    assert_allclose(moved, expected, atol=MIDDLE * height)


def test_arrows_are_drawn_from_feet_to_the_ends_of_their_forces_and_in_stance_only(browser, pages, jump):
    with browser.opened(pages["jump"].html, SIZE, "t=0&camera=overview&panel=off") as view:
        scale, weight = map(float, re.search(ARROW_SCALE, view.evaluate(ABOUT)).groups())
        view.evaluate("location.hash = 't=0&camera=overview&bare'")
        for t in TIMES:
            view.seek(t)
            drawn = drawn_by(view, "forces")
            row = int(np.searchsorted(jump.t, t, side="right")) - 1
            if not jump.active[row].any():
                assert phase_at(jump, t) == "flight"
                assert not drawn.any()
                continue
            data = jump.model.createData()
            pin.framesForwardKinematics(jump.model, data, geodesic_configurations(jump, t))
            feet = np.array(
                [data.oMf[jump.model.getFrameId(name)].translation for name in jump.contact_frames]
            )
            feet[:, 2] -= jump.meta["contact_radius"]  # where they touch
            part = (t - jump.t[row]) / (jump.t[row + 1] - jump.t[row])
            force = (1 - part) * jump.f[row, :, :3] + part * jump.f[row + 1, :, :3]
            ends = pixels_of(view, np.vstack([feet, feet + force / weight * scale]), SIZE)
            expected = np.array([ends.min(axis=0), ends.max(axis=0)])
            assert_allclose(extent(drawn), expected, atol=ARROW)


def test_page_plays_pauses_and_seeks(browser, pages):
    with browser.opened(pages["jump"].html, SIZE, "") as view:  # without a time it plays
        until(view, f"trajopt.state().time > {view.start + 0.05}")  # it may have come to its end by now
        assert view.state()["drawn"] > 1
        view.evaluate("trajopt.pause()")
        still = view.state()
        until(view, "true")
        view.evaluate("new Promise(done => requestAnimationFrame(() => requestAnimationFrame(done)))")
        assert view.state()["time"] == still["time"]
        assert not view.state()["playing"]
        view.seek(0.5)
        assert view.state()["time"] == 0.5
        view.seek(99.0)
        assert view.state()["time"] == pytest.approx(view.start + view.duration)
        view.evaluate("trajopt.play()")  # from the end it starts anew
        until(view, "trajopt.state().time < 1.0")
        assert view.errors == []


def test_pictures_do_not_depend_on_how_a_time_was_reached(browser, pages):
    with browser.opened(pages["jump"].html, SIZE, "t=0&camera=follow&panel=off") as view:
        view.seek(0.5)
        first = view.picture()
        for t in (1.1, 0.2, 0.5):
            view.seek(t)
        assert np.array_equal(view.picture(), first)
        assert first.std() > 10
        view.seek(0.6)
        assert not np.array_equal(view.picture(), first)


def test_every_camera_shows_the_robot_and_no_two_the_same(browser, pages):
    with browser.opened(pages["jump"].html, SIZE, "t=0.5&bare") as view:
        seen = []
        for name in view.cameras:
            view.camera(name)
            assert view.state()["camera"] == name
            seen.append(view.picture())
        named = [picture for picture, name in zip(seen, view.cameras, strict=True) if name != "free"]
        for number, picture in enumerate(named):
            assert not any(np.array_equal(picture, other) for other in named[:number])
        with refused("camera 'nowhere' is unknown; allowed: overview, "):
            view.camera("nowhere")
        with refused("layer 'nothing' is unknown; allowed: robot, "):
            view.layer("nothing", False)


@pytest.mark.parametrize("name", ["jump", "arm", "both"])
def test_page_asks_for_nothing_but_itself(browser, pages, name):
    with browser.opened(pages[name].html, SIZE) as view:
        view.seek(0.3)
        own = pages[name].html.as_uri()
        assert [address for address in view.requests if not address.startswith((own, "blob:"))] == []
        assert view.evaluate("navigator.onLine") is False


def test_missing_chromium_is_one_line_that_tells_how_to_install_it(monkeypatch):
    monkeypatch.setenv(EXECUTABLE_VARIABLE, "/nowhere/chromium")
    with refused(r"TRAJOPT_CHROMIUM is /nowhere/chromium, .*apt install chromium"):
        find_chromium()
    monkeypatch.delenv(EXECUTABLE_VARIABLE)
    monkeypatch.setenv("PATH", "/nowhere")
    with refused(r"Chromium, which is not installed; on Debian: apt install chromium"):
        find_chromium()


def test_program_that_is_no_chromium_is_one_line(monkeypatch):
    monkeypatch.setenv(EXECUTABLE_VARIABLE, "/bin/true")
    before = descendants()
    with pytest.raises(TrajoptError) as raised, chromium():
        pass
    assert "\n" not in str(raised.value)
    assert "/bin/true" in str(raised.value)
    assert descendants().keys() <= before.keys()


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("<script>window.trajopt = {ready: new Promise(() => {})}</script>", "is not ready after 1 s"),
        ("<script>throw new Error('no mesh')</script>", "does not start: exception: no mesh"),
        (
            "<script>window.trajopt = {ready: Promise.reject(new Error('no scene'))}</script>",
            "Error: no scene",
        ),
        ("<p>hello</p>", "does not start: it is not of trajopt replay"),
    ],
)
def test_page_that_never_gets_ready_is_one_line(browser, tmp_path, text, told):
    page = tmp_path / "page.html"
    page.write_text(f"<!DOCTYPE html><title>x</title>{text}")
    with pytest.raises(TrajoptError, match=told) as raised, browser.opened(page, SIZE, limit=1.0):
        pass
    assert "\n" not in str(raised.value)


def test_page_that_does_not_exist_is_refused(browser, tmp_path):
    with refused("does not exist"), browser.opened(tmp_path / "none.html"):
        pass


def kill_chromium(others: set[int]) -> None:
    for number, name in descendants().items():
        if number not in others and "chrom" in name:
            with contextlib.suppress(ProcessLookupError):
                os.kill(number, signal.SIGKILL)


def test_crashed_browser_is_one_line_and_leaves_no_process(pages):
    before = set(descendants())
    with open_page(pages["jump"].html, SIZE) as view:
        kill_chromium(before)
        with pytest.raises(TrajoptError) as raised:
            view.png()
    assert "\n" not in str(raised.value)
    assert set(descendants()) <= before


def test_browser_ends_with_the_exception_that_leaves_it(pages):
    before = descendants()
    with pytest.raises(KeyboardInterrupt), open_page(pages["jump"].html, SIZE):
        raise KeyboardInterrupt
    assert descendants().keys() <= before.keys()
