"""The player in Chromium: mouse, keys, cameras, layers, small windows; no complaint of the browser."""

from collections.abc import Awaitable, Callable, Iterator
from dataclasses import replace

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter1d

from tests.support.browser import until
from tests.support.replay_pages import hopping
from trajopt import Solution, replay
from trajopt.motion.configurations import geodesic_configurations
from trajopt.view.replay.browser import OpenedPage

pytestmark = pytest.mark.long

WIDE, SMALL = (1000, 650), (600, 400)
LIMIT = 30.0  # s for one act of the mouse on a busy machine
START, END, STEP = 0.0, 0.5, 0.5 / 30  # s of the hop, which has 30 steps
FLIGHT = 0.25  # s, a time in flight
AHEAD, FAR = 0.2, 5.0  # m
ROW = 4.0  # pixels by which parts of one row may be apart
PATH_ERROR = 2e-3  # over the robot's extent: tracks are thinned, and the path is sampled
TARGET = "trajopt.viewer.controls.target.toArray()"
PLACE = "trajopt.viewer.camera.position.toArray()"
CONTROLS = "[...document.querySelectorAll('#bar button, #bar select, #layers input, [role=slider]')]"
CORNERS = """() => {
    const {camera} = trajopt.viewer;
    trajopt.render();
    return trajopt.view.corners.map(corner => corner.clone().project(camera).toArray());
}"""
RESET = """() => {
    trajopt.pause();
    trajopt.seek(0);
    trajopt.clock.loop = true;
    trajopt.clock.setRate(1);
    trajopt.camera("overview");
}"""


@pytest.fixture(scope="module")
def hop() -> Solution:
    """It hops ahead by a part of its length."""
    still = hopping()
    moved = still.q.copy()
    moved[:, 0] += AHEAD * still.t / still.t[-1]
    return replace(still, q=moved)


@pytest.fixture(scope="module")
def page(hop, tmp_path_factory):
    return replay(hop, html=tmp_path_factory.mktemp("page") / "hop.html").html


@pytest.fixture(scope="module")
def opened(browser, page) -> Iterator[OpenedPage]:
    with browser.opened(page, WIDE) as view:
        yield view


@pytest.fixture
def view(opened) -> Iterator[OpenedPage]:
    """The page at its start; it must have nothing to complain of."""
    opened.evaluate(RESET)
    yield opened
    assert opened.errors == []


def act(view: OpenedPage, work: Awaitable[object]) -> None:
    """One act of mouse or keyboard."""
    view._calls(work, LIMIT, "mouse or keyboard")


def press(view: OpenedPage, key: str) -> dict:
    act(view, view._page.keyboard.press(key))
    return view.state()


def box_of(view: OpenedPage, selector: str) -> tuple[float, float, float, float]:
    """Left, top, width and height of an element, pixels."""
    script = "name => {const b = document.querySelector(name).getBoundingClientRect();"
    return tuple(view.evaluate(script + "return [b.x, b.y, b.width, b.height];}", selector))


def text_of(view: OpenedPage, selector: str) -> str:
    return view.evaluate("name => document.querySelector(name).textContent", selector)


def test_clock_and_phase_bar_show_the_time_that_is_drawn(view):
    for time, phase in ((0.05, "phase 0"), (FLIGHT, "phase 1"), (END, "phase 2")):
        view.seek(time)
        assert view.state()["phase"] == text_of(view, "#phase") == text_of(view, "#segments .now") == phase
        assert text_of(view, "#time") == f"t = {time:.2f} s"
        left, _, width, _ = box_of(view, "#phases")
        cursor, _, thickness, _ = box_of(view, "#cursor")
        assert cursor + thickness / 2 - left == pytest.approx(width * time / END, abs=1.0)


def test_meshcats_panel_shows_and_sets_the_time_of_the_solution(view):
    view.seek(FLIGHT)
    assert view.evaluate("trajopt.viewer.animator.time") == FLIGHT
    view.evaluate("trajopt.viewer.animator.time_scrubber.setValue(0.4)")
    assert view.state()["time"] == pytest.approx(0.4)


def test_keys_play_step_and_go_to_the_ends(view):
    assert press(view, "Space")["playing"]
    assert not press(view, "Space")["playing"]
    assert press(view, "Home")["time"] == START
    assert press(view, "ArrowRight")["time"] == pytest.approx(STEP)
    assert press(view, "ArrowRight")["time"] == pytest.approx(2 * STEP)
    assert press(view, "ArrowLeft")["time"] == pytest.approx(STEP)
    assert press(view, "PageDown")["time"] == pytest.approx(11 * STEP)
    assert press(view, "End")["time"] == pytest.approx(END)


def test_keys_choose_cameras_and_speeds(view):
    assert view.cameras == ("overview", "follow", "side", "front", "top", "free")
    assert [press(view, str(1 + number))["camera"] for number in range(6)] == list(view.cameras)
    press(view, "]")
    assert view.evaluate("[trajopt.speed, Number(document.getElementById('rate').value)]") == [2, 2]
    for _ in range(9):
        press(view, "[")
    assert view.evaluate("trajopt.speed") == 0.1


def test_mouse_drags_the_phase_bar_and_the_motion_goes_on_afterwards(view):
    left, top, width, height = box_of(view, "#phases")
    mouse, middle = view._page.mouse, top + height / 2
    view.evaluate("trajopt.play()")
    act(view, mouse.move(left + 0.25 * width, middle))
    act(view, mouse.down())
    assert view.state()["time"] == pytest.approx(0.25 * END, abs=END / width)
    assert not view.state()["playing"]
    act(view, mouse.move(left + 0.75 * width, middle + 60))
    assert view.state()["time"] == pytest.approx(0.75 * END, abs=END / width)
    act(view, mouse.move(left + 2 * width, middle))
    assert view.state()["time"] == pytest.approx(END)
    act(view, mouse.up())
    assert view.state()["playing"]


def test_time_that_the_page_was_hidden_for_does_not_pass(view):
    # As after a minute behind another page: the last picture was drawn long ago.
    times = view.evaluate("""() => {
        const {clock} = trajopt, found = [];
        for (const heard of [true, false]) {
            clock.seek(0.1);
            clock.play();
            clock.last = performance.now() - 60000;
            if (heard) document.dispatchEvent(new Event("visibilitychange"));
            clock.tick();
            found.push(clock.time);
        }
        return found;
    }""")
    assert times == pytest.approx([0.1, END])


def test_picture_has_the_pixels_of_the_screen_it_is_moved_to(view):
    ratio = """value => {
        Object.defineProperty(window, "devicePixelRatio", {value, configurable: true});
        trajopt.view.resized();
        const canvas = trajopt.viewer.renderer.domElement;
        return [trajopt.viewer.renderer.getPixelRatio(), canvas.width / canvas.clientWidth];
    }"""
    for value in (2, 1):
        assert view.evaluate(ratio, value) == [value, value]


def test_button_that_was_clicked_leaves_the_space_bar_to_playing(view):
    act(view, view._page.click("#loop"))
    assert view.evaluate("trajopt.clock.loop") is False
    assert press(view, "Space")["playing"]
    assert view.evaluate("trajopt.clock.loop") is False


def test_layer_is_hidden_and_shown_by_its_box_and_by_name(view):
    visible = "trajopt.viewer.scene_tree.find(['meshcat', 'trails']).object.visible"
    act(view, view._page.click("#layers label:has-text('trails')"))
    assert view.evaluate(visible) is False
    view.layer("trails", True)
    assert view.evaluate(visible) is True
    assert view.evaluate(
        "[...document.querySelectorAll('#layers label')].pop().querySelector('input').checked"
    )


def test_caption_tells_the_scale_of_forces_while_they_are_shown(view):
    height = "document.querySelector('#lines [data-layer=forces]').offsetHeight"
    assert view.evaluate(height) > 0
    view.layer("forces", False)
    assert view.evaluate(height) == 0
    view.layer("forces", True)
    assert view.evaluate(height) > 0


def test_drag_of_the_picture_makes_a_free_view_that_still_follows(view):
    view.camera("side")
    before = np.array(view.evaluate(PLACE))
    act(view, view._page.mouse.move(400, 300))
    act(view, view._page.mouse.down())
    act(view, view._page.mouse.move(520, 320, steps=4))
    act(view, view._page.mouse.up())
    view.evaluate("trajopt.render()")
    assert view.state()["camera"] == "free"
    assert np.linalg.norm(np.array(view.evaluate(PLACE)) - before) > 0.05
    assert view.evaluate("trajopt.view.following") is True


def test_every_control_has_a_name_for_those_who_do_not_see_it(view):
    nameless = "part => !(part.ariaLabel || part.textContent.trim() || part.labels && part.labels.length)"
    assert view.evaluate(f"{CONTROLS}.filter({nameless}).length") == 0
    assert view.evaluate(f"{CONTROLS}.length") > 15
    view.seek(FLIGHT)
    assert view.evaluate("document.getElementById('phases').ariaValueText") == "0.25 seconds, phase 1"


@pytest.fixture
def resized(view) -> Iterator[Callable[[tuple[int, int]], None]]:
    """Sets the window's size, which is as it was afterwards."""

    def resize(size: tuple[int, int]) -> None:
        act(view, view._page.set_viewport_size({"width": size[0], "height": size[1]}))
        settled = f"window.innerWidth === {size[0]} && trajopt.viewer.renderer.domElement.width === {size[0]}"
        until(view, f"{settled} && trajopt.viewer.camera.view.fullWidth === {size[0]}")

    yield resize
    resize(WIDE)


@pytest.mark.parametrize("size", [WIDE, SMALL, (360, 640)])
def test_overview_shows_the_whole_motion_above_the_bar(view, resized, size):
    resized(size)
    corners = np.array(view.evaluate(CORNERS))
    bar = box_of(view, "#bar")[3] / size[1]
    assert np.abs(corners[:, 0]).max() < 1
    assert corners[:, 1].max() < 1
    assert corners[:, 1].min() > -1 + 2 * bar


def test_controls_fit_in_a_small_window(view, resized):
    resized(SMALL)
    script = "part => {const b = part.getBoundingClientRect(); return [b.left, b.top, b.right, b.bottom];}"
    seen = "[...document.querySelectorAll('#bar button, #bar select')].filter(part => part.offsetParent)"
    boxes = np.array(view.evaluate(f"{seen}.map({script})"))
    assert boxes.min() >= 0
    assert (boxes[:, 2] <= SMALL[0]).all()
    assert (boxes[:, 3] <= SMALL[1]).all()
    assert np.ptp(boxes[:, 1]) < ROW
    assert view.evaluate("document.documentElement.scrollHeight") == SMALL[1]
    assert box_of(view, "#side")[2] == 0


def test_address_sets_time_camera_and_what_is_written_over_the_picture(browser, page):
    with browser.opened(page, SMALL, "t=0.25&camera=side&panel=off") as shown:
        state = shown.state()
        assert (state["time"], state["camera"], state["playing"]) == (0.25, "side", False)
        hidden = [box_of(shown, name)[2] == 0 for name in ("#bar", "#side", "#caption")]
        assert hidden == [True, True, False]
        shown.evaluate("location.hash = 't=0.1&bare'")
        assert shown.evaluate("new Promise(done => setTimeout(() => done(trajopt.state().time), 100))") == 0.1
        assert box_of(shown, "#caption")[2] == 0


def test_camera_follows_the_smoothed_path_of_the_base_whatever_was_shown_before(hop, browser, tmp_path):
    walk = hop.q.copy()
    walk[:, 0] += FAR * hop.t / hop.t[-1]
    walk[:, 2] += 0.05 * np.sin(40 * hop.t)  # it trots up and down, which the camera must not
    walking = replace(hop, q=walk)
    shown = replay(walking, html=tmp_path / "walk.html")
    size = shown.facts["size"]
    times = np.linspace(START, END, shown.frames)
    base = geodesic_configurations(walking, times)[:, :3]
    expected = smoothed_path(base, times[1], size)
    rows = np.arange(0, shown.frames, 6)
    with browser.opened(shown.html, SMALL) as view:
        assert view.state()["camera"] == "follow"
        targets = []
        for row in rows[::-1]:
            view.evaluate("t => trajopt.seek(t)", float(times[row]))
            targets.append(view.evaluate(TARGET))
        targets = np.array(targets[::-1])[:, [0, 2, 1]] * [1, -1, 1]  # y is up there
        assert view.errors == []
    travel = targets - targets[0]
    np.testing.assert_allclose(travel, expected[rows] - expected[0], atol=PATH_ERROR * size)
    assert np.ptp(travel[:, 2]) < 0.3 * np.ptp(base[:, 2])


def smoothed_path(base: np.ndarray, step: float, size: float) -> np.ndarray:
    """Gaussian means of the base (n, 3), mirrored at its ends: height over more time."""
    time = np.sqrt(size / 9.81) / step
    columns = []
    for values, width, turn in zip(base.T, (0.6, 0.6, 1.5), (-1, -1, 1), strict=True):
        reach = min(len(values) - 1, int(np.ceil(3 * width * time)))
        before, after = values[reach:0:-1], values[-2 : -reach - 2 : -1]
        padded = [values[0] + turn * (before - values[0]), values, values[-1] + turn * (after - values[-1])]
        filtered = gaussian_filter1d(np.concatenate(padded), width * time, radius=reach)
        columns.append(filtered[reach : reach + len(values)])
    return np.column_stack(columns)


def test_page_plays_when_it_is_opened_and_stops_for_who_says_so_at_once(browser, page):
    with browser.opened(page, SMALL, "") as shown:
        assert shown.state()["playing"]
        until(shown, "trajopt.state().time > 0.02")
        act(shown, shown._page.reload())
        shown.evaluate("trajopt.ready.then(() => trajopt.pause())")
        shown.evaluate("new Promise(done => setTimeout(done, 300))")
        assert not shown.state()["playing"]
        assert shown.errors == []


def test_parts_of_one_mesh_file_share_what_the_graphics_card_holds(view):
    script = """() => {
        const parts = [], robot = trajopt.viewer.scene_tree.find(["meshcat", "robot"]).object;
        robot.traverse(part => part.isMesh && parts.push(part));
        return [parts.length, new Set(parts.map(part => part.geometry)).size];
    }"""
    assert view.evaluate(script) == [17, 10]
