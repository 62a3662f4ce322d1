"""Driving from the browser: commands of the page, the session behind it, its server, and the page itself."""

import json
import math
import signal
import socket
import urllib.error
import urllib.request
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

from tests.support.browser import require_chromium
from tests.support.command_lines import assert_refused, invoke
from tests.support.processes import LIMIT, TRAJOPT, Running, until
from trajopt.control.mpc.controller import Controller
from trajopt.errors import InputError
from trajopt.motion.solution import Solution
from trajopt.robot.catalogue import robot
from trajopt.robot.kinematics import frame_pose
from trajopt.simulation.clock import CATCH, STRETCH, WallClock
from trajopt.simulation.driven_scene import DrivenScene
from trajopt.terrain import PiecewiseTerrain
from trajopt.view.driving.drawing import Painter
from trajopt.view.driving.drivers import SLOW, ArmDriver, LegsDriver
from trajopt.view.driving.live import LiveDrive
from trajopt.view.driving.server import DriveServer
from trajopt.view.driving.session import SILENCE, DriveSession
from trajopt.view.replay.browser import FLAGS, find_chromium

pytestmark = pytest.mark.long

# Of a trot at 0.4 m/s after a second: it has begun to move.
MOVED = 0.1
# Of the tool from a target that stood still for half a second, m.
REACHED = 0.02
# Horizons, which controllers of one driver share, keep something of their last use: m and rad after 0.4 s.
AS_NEW = 2e-3
# Turns of a second.
SECOND = round(1 / STRETCH)


def instant(slow: float = 0.0) -> WallClock:
    """A clock whose time goes on where it is waited for, and by ``slow`` s at each look."""
    time = 0.0

    def passing(seconds: float) -> float:
        nonlocal time
        time += seconds
        return time

    return WallClock(lambda: passing(slow), passing)


@pytest.fixture(scope="module")
def driver() -> LegsDriver:
    return LegsDriver(robot("go2"), ("trot",))


@pytest.fixture
def session(driver: LegsDriver) -> DriveSession:
    return DriveSession(driver, clock=instant(), keep=2.0)


@pytest.fixture(scope="module")
def live() -> Iterator[LiveDrive]:
    with LiveDrive(robot("go2"), gaits=("trot",), open_browser=False, clock=instant()) as live:
        yield live


def turns(session: DriveSession, count: int) -> None:
    """Drive for some stretches, and wait for real time after the last."""
    left = iter(range(count, -1, -1))

    def ticks(driven: DrivenScene) -> int:
        allowed = session.ticks(driven)
        return allowed if next(left) else 0

    session.driven.simulate(ticks)


def base(session: DriveSession) -> np.ndarray:
    return session.driven.run.data.qpos[:3].copy()


def test_a_robot_follows_what_is_set_and_the_clock_is_kept(session: DriveSession):
    session.obey({"gait": "trot", "speed": 0.4})
    for _ in range(SECOND):
        session.obey({})  # the page is there
        turns(session, 1)
    assert session.driven.passed == pytest.approx(1.0)
    assert session.clock.now() == pytest.approx(1.0)
    assert session.clock.behind == 0
    assert session.driven.fall is None
    assert base(session)[0] > MOVED
    state = json.loads(json.dumps(Painter(session).state(), allow_nan=False))
    assert len(state["joints"]) == session.stand.model.njoints - 1
    assert len(state["lines"]) == 5
    assert np.array(state["forces"])[:, 5].sum() > 0
    assert state["gait"] == "trot"


@pytest.mark.parametrize(
    ("message", "said"),
    [
        ({"speed": math.nan}, "speed is nan; allowed"),
        ({"speed": 100.0}, "speed is 100"),
        ({"speed": True}, "speed is True"),
        ({"speed": "1"}, "speed is '1'"),
        ({"turn_rate": [1]}, "turn_rate is"),
        ({"gait": "fly"}, "gait is 'fly'; allowed: stand, trot"),
        ({"gait": None}, "gait is None"),
        ({"leap": 1.0}, "'leap' is no command"),
        ({"action": "dance"}, "action is 'dance'; allowed: reset, push"),
        ([1], "a command is"),
    ],
)
def test_what_is_not_allowed_is_refused_and_changes_nothing(session: DriveSession, message: Any, said: str):
    before = session.driver.values, session.driver.gait
    with pytest.raises(InputError) as refused:
        session.obey({"height": 0.01, **message} if isinstance(message, dict) else message)
    assert said in str(refused.value)
    assert "\n" not in str(refused.value)
    assert (session.driver.values, session.driver.gait) == before


def test_a_push_has_its_size_and_direction(session: DriveSession):
    turns(session, 5)
    weight, before = session.driven.scene.units.weight, session.driven.run.data.qvel[:3].copy()
    session.obey({"push": 6.0, "direction": 90.0, "action": "push"})
    turns(session, 1)
    gained = session.driven.run.data.qvel[:3] - before
    free = 6.0 / (weight / 9.81)  # without feet, which hold the robot back
    assert 0.3 * free < gained[1] < free
    assert abs(gained[0]) < 0.2 * gained[1]


def test_reset_puts_a_fallen_robot_back_with_a_controller_as_new(session: DriveSession):
    start, first = base(session), session.driver.steering.controller
    session.obey({"push": 13.0, "direction": 0.0})
    for _ in range(40):
        session.obey({"action": "push"})
    while session.driven.fall is None and session.driven.passed < 2:
        session.obey({"action": "push"})
        turns(session, 1)
    assert session.driven.fall is not None
    stopped = session.driven.passed
    turns(session, 3)
    assert session.driven.passed == stopped
    session.obey({"action": "reset"})
    turns(session, 10)
    assert session.driven.fall is None
    assert np.abs(base(session) - start).max() < 1e-3
    assert session.driver.steering.controller is not first
    assert session.driver.gait == "stand"


def test_without_messages_of_its_page_the_robot_is_asked_to_stand(session: DriveSession):
    session.obey({"gait": "trot"})
    turns(session, round((SILENCE + 2 * STRETCH) / STRETCH))
    assert session.silent
    assert session.driver.gait == "stand"
    session.obey({})
    assert not session.silent


def test_what_is_too_slow_falls_behind_and_says_so(driver: LegsDriver):
    session = DriveSession(driver, clock=instant(slow=2 * STRETCH), keep=2.0)
    turns(session, SECOND)
    assert session.clock.behind > 1 - CATCH
    assert session.clock.pace < 0.6


def test_the_last_seconds_are_saved_as_a_drive(session: DriveSession, tmp_path):
    session.obey({"gait": "trot", "speed": 0.4})
    for _ in range(round(2.5 * SECOND)):
        session.obey({})
        turns(session, 1)
    assert session.driven.offset == pytest.approx(1.0)
    drive = session.as_drive()
    assert drive.script.times == (0.0,)
    assert drive.commanded[-1, 0] == 0.4
    assert drive.report.simulated == pytest.approx(1.5)
    file = drive.as_solution().save(tmp_path / "run.npz")
    motion = Solution.load(file)
    assert motion.statistics.simulated
    assert motion.q[-1, 0] == pytest.approx(base(session)[0], abs=1e-6)


def test_a_controller_as_new_goes_on_like_another(driver: LegsDriver):
    def driven() -> np.ndarray:
        session = DriveSession(driver, clock=instant(), keep=2.0)
        session.obey({"gait": "trot", "speed": 0.4})
        turns(session, 20)
        return session.driven.run.data.qpos.copy()

    assert isinstance(driver.steering.controller, Controller)
    np.testing.assert_allclose(driven(), driven(), atol=AS_NEW)


def test_known_terrain_is_below_the_robot_and_in_its_controller_after_a_reset_too():
    terrain = PiecewiseTerrain.stairs(0.05, 0.3, 2, at=(0.5, 0.0))
    session = DriveSession(LegsDriver(robot("go2"), ("trot",), terrain=terrain), clock=instant())
    assert session.stand.description.terrain == terrain
    session.reset()
    assert session.driver.steering.controller.ground.terrain is terrain


def test_a_robot_that_lies_stands_up_and_lies_again_after_a_reset(driver: LegsDriver):
    session = DriveSession(driver, clock=instant(), keep=2.0, lying=True)
    low, standing = base(session)[2], driver.robot.reference[2]
    turns(session, round(session.driven.rises / STRETCH) + 5)
    assert low < 0.35 * standing
    assert base(session)[2] == pytest.approx(standing, rel=0.03)
    assert session.driven.fall is None
    # A command begins with a tick.
    assert session.as_drive().script.times == pytest.approx((0.0, session.driven.rises), abs=1e-3)
    session.reset()
    assert base(session)[2] == low


def test_a_slow_gait_gets_low_speeds():
    driver = LegsDriver(robot("go2"), ("walk",))
    driver.obey({"gait": "walk", "speed": driver.sliders[0].high, "lateral": 0.01})
    assert driver.command.speed == pytest.approx(SLOW["walk"] * driver.sliders[0].high)
    assert driver.command.lateral == 0.01


def test_the_tool_of_an_arm_follows_its_target():
    driver = ArmDriver(robot("panda"))
    session = DriveSession(driver, clock=instant(), keep=2.0)
    session.obey({"z": driver.values["z"] + 0.1})
    turns(session, SECOND)
    wanted = np.array([driver.values[axis] for axis in "xyz"])
    np.testing.assert_allclose(driver.target, wanted, atol=1e-9)
    state = Painter(session).state()
    assert np.linalg.norm(np.array(state["lines"][0][0]) - wanted) < REACHED
    with pytest.raises(InputError, match="action is 'push'"):
        session.obey({"action": "push"})


def test_the_drive_of_an_arm_is_saved_with_its_figures(tmp_path):
    session = DriveSession(ArmDriver(robot("panda")), clock=instant(), keep=1.0)
    with pytest.raises(InputError, match="nothing was simulated"):
        session.as_drive()
    driver, start = session.driver, session.driver.target.copy()
    session.obey({"z": start[2] + 0.1})
    turns(session, SECOND + 5)
    assert session.driven.offset == pytest.approx(0.5)
    session.obey({"y": start[1] + 0.1})
    turns(session, 5)
    drive = session.as_drive()
    np.testing.assert_allclose(
        drive.target[-1], driver.target, atol=driver.steering.path.at(1.2)[1][1] * STRETCH
    )
    np.testing.assert_allclose(drive.target[0], start + np.array([0, 0, 0.1]), atol=1e-9)
    report = drive.report
    assert report.simulated == pytest.approx(0.7)
    assert [time for time, _ in report.targets] == pytest.approx([0.0, 0.6])
    assert 0 < report.error_mean < report.error_95 < report.error_max < 2 * REACHED
    assert report.nearest > driver.steering.controller.settings.margin
    assert report.beyond == 0
    assert 0 < report.rate < 1
    assert "tool from target" in report.table()
    motion = Solution.load(drive.as_solution().save(tmp_path / "run.npz"))
    assert motion.statistics.simulated
    assert motion.statistics.success
    np.testing.assert_allclose(motion.q[-1], session.driven.run.data.qpos, atol=1e-9)


def test_a_simulation_that_diverges_is_saved_up_to_there(tmp_path):
    session = DriveSession(ArmDriver(robot("panda")), clock=instant(), keep=1.0)
    turns(session, 5)
    session.driven.run.data.qvel[:] = np.nan
    turns(session, 5)
    drive = session.as_drive()
    assert drive.report.fell
    assert drive.report.table().endswith("it failed at 0.100 s: the simulation diverged")
    motion = drive.as_solution()
    assert not motion.statistics.success
    assert np.isfinite(Solution.load(motion.save(tmp_path / "run.npz")).q).all()


def posted(live: LiveDrive, body: bytes, kind: str = "application/json") -> tuple[int, str]:
    request = urllib.request.Request(f"{live.url}command", body, {"Content-Type": kind})
    try:
        with urllib.request.urlopen(request, timeout=LIMIT) as answer:
            return answer.status, answer.read().decode()
    except urllib.error.HTTPError as error:
        return error.code, error.read().decode()


def test_commands_by_post(live: LiveDrive):
    driver = live.session.driver
    assert posted(live, b'{"gait": "trot", "speed": 0.3}') == (204, "")
    assert (driver.gait, driver.values["speed"]) == ("trot", 0.3)
    for body in (b'{"speed": NaN}', b'{"speed": 1e9}', b'{"gait": "fly"}', b"[]", b"{", b"\xff", b""):
        status, said = posted(live, body)
        assert (status, said.count("\n")) == (400, 1)
    assert (driver.gait, driver.values["speed"]) == ("trot", 0.3)


def test_pages_of_others_cannot_steer(live: LiveDrive):
    assert posted(live, b'{"gait": "stand"}', "text/plain")[0] == 400
    request = urllib.request.Request(live.url, headers={"Host": "evil.example"})
    with pytest.raises(urllib.error.HTTPError, match="404"):
        urllib.request.urlopen(request, timeout=LIMIT)


def test_a_second_drive_takes_another_port_and_a_port_that_is_taken_is_told(live: LiveDrive):
    port = int(live.url.rstrip("/").rpartition(":")[2])
    with LiveDrive(robot("panda"), target=True, open_browser=False, clock=instant()) as second:
        assert second.url != live.url
    with pytest.raises(InputError, match=f"port {port} is taken"):
        LiveDrive(robot("panda"), target=True, open_browser=False, port=port)


def test_it_ends_after_its_time(live: LiveDrive):
    live.session.reset()
    live.run(seconds=0.1)
    assert live.session.driven.passed == pytest.approx(0.1)


def test_what_does_not_fit_is_one_line():
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        assert_refused(invoke("drive", "panda", "--target", "--port", port), f"port {port} is taken")
    assert_refused(invoke("drive", "panda", "--no-open"), "panda")
    assert_refused(invoke("drive", "go2", "--target", "--no-open"), "go2")
    assert_refused(invoke("drive", "go2", "--slope", 5), "--slope without --script")
    assert_refused(invoke("drive", "go2", "--json"), "--json without --script")
    assert_refused(invoke("drive", "go2", "--seed", 3), "--seed has no effect")


def test_ctrl_c_ends_in_one_line():
    with Running(*TRAJOPT, "drive", "panda", "--target", "--no-open") as running:
        assert running.popen.stdout.readline().startswith("drive at http://127.0.0.1:")
        assert "Ctrl-C" in running.line()
        running.press(signal.SIGINT)
        status, said, errors = running.finish()
    assert status == 0
    assert said.count("\n") == 1
    assert "s simulated" in said
    assert errors == ""


def test_page_shows_the_robot_and_its_keys_steer():
    require_chromium()
    from playwright.sync_api import sync_playwright

    with LiveDrive(robot("go2"), gaits=("trot",), open_browser=False) as live, sync_playwright() as playing:
        browser = playing.chromium.launch(executable_path=find_chromium(), args=list(FLAGS))
        page, errors = browser.new_page(), []
        page.on("console", lambda message: message.type == "error" and errors.append(message.text))
        page.on("pageerror", lambda error: errors.append(str(error)))
        page.goto(live.url)
        page.evaluate("trajopt.ready.then(() => true)")
        assert page.title() == "drive – go2"
        page.keyboard.press("w")
        page.keyboard.press("w")
        driver = live.session.driver
        until(lambda: driver.values["speed"] == pytest.approx(0.2 * driver.sliders[0].high))
        assert driver.gait == "trot"
        assert driver.values["speed"] == pytest.approx(0.2 * driver.sliders[0].high)
        page.keyboard.press(" ")
        until(lambda: driver.gait == "stand")
        assert (driver.gait, driver.values["speed"]) == ("stand", 0.0)
        live.run(seconds=0.2)
        page.wait_for_function("trajopt.state().figures[0].value === '0.2 s'", timeout=1e3 * LIMIT)
        assert errors == []
        live.close()
        page.wait_for_selector("#message:has-text('the server has stopped')", timeout=1e3 * LIMIT)
        browser.close()


# Where the target is in the page: pixels to the right and down, and its depth, m; and the camera.
IN_PAGE = """() => {
    const {view, viewer} = trajopt, at = view.target.getWorldPosition(new view.three.Vector3());
    const depth = -at.clone().applyMatrix4(viewer.camera.matrixWorldInverse).z;
    at.project(viewer.camera);
    return [(1 + at.x) / 2 * innerWidth, (1 - at.y) / 2 * innerHeight, depth];
}"""
CAMERA = "trajopt.viewer.camera.position.toArray()"
# The camera that `ready` has placed is drawn in the next picture.
DRAWN = "new Promise(drawn => requestAnimationFrame(() => requestAnimationFrame(drawn)))"
SHOWN = "['x', 'y', 'z'].map(axis => trajopt.steering.shown.get(axis))"
CURSOR = "document.getElementById('meshcat-pane').style.cursor"


def test_the_target_is_dragged_in_the_picture_and_the_arm_follows():
    require_chromium()
    from playwright.sync_api import sync_playwright

    playing = sync_playwright()
    with LiveDrive(robot("panda"), target=True, open_browser=False, clock=instant()) as live, playing as on:
        browser = on.chromium.launch(executable_path=find_chromium(), args=list(FLAGS))
        page, errors = browser.new_page(has_touch=True), []
        page.on("pageerror", lambda error: errors.append(str(error)))
        page.goto(live.url)
        page.evaluate("trajopt.ready.then(() => true)")
        page.evaluate(DRAWN)
        driver, camera = live.session.driver, page.evaluate(CAMERA)

        def arrived(x: float, y: float, depth: float) -> None:
            """The target is where the pointer is, as far from the camera as before, and sent."""
            until(lambda: page.evaluate(SHOWN) == pytest.approx([driver.values[axis] for axis in "xyz"]))
            np.testing.assert_allclose(page.evaluate(IN_PAGE), [x, y, depth], atol=1e-3)
            shown = page.evaluate(SHOWN)
            assert shown == pytest.approx([driver.values[axis] for axis in "xyz"])
            outputs = page.locator("#sliders output").all_text_contents()
            assert outputs == [f"{value:.2f} m" for value in shown]

        x, y, depth = page.evaluate(IN_PAGE)
        page.mouse.move(x + 4, y - 3)
        assert page.evaluate(CURSOR) == "grab"
        page.mouse.down()
        page.mouse.move(x - 56, y - 43, steps=3)
        assert page.evaluate(CURSOR) == "grabbing"
        arrived(x - 60, y - 40, depth)
        page.mouse.move(x + 5000, y, steps=3)
        assert until(
            lambda: any(driver.values[each.name] in (each.low, each.high) for each in driver.sliders)
        )
        page.mouse.move(x + 44, y - 33, steps=3)
        page.mouse.up()
        arrived(x + 40, y - 30, depth)
        finger = page.context.new_cdp_session(page)
        for kind, points in (("Start", [0]), ("Move", [10]), ("Move", [20]), ("End", [])):
            touches = [{"x": x + 40 - each, "y": y - 30} for each in points]
            finger.send("Input.dispatchTouchEvent", {"type": f"touch{kind}", "touchPoints": touches})
        arrived(x + 20, y - 30, depth)
        assert page.evaluate(CAMERA) == pytest.approx(camera)
        live.run(seconds=1.0)
        drive = live.session.as_drive()
        np.testing.assert_allclose(drive.target[-1], [driver.values[axis] for axis in "xyz"], atol=1e-9)
        tool = frame_pose(driver.robot, drive.as_solution().q[-1], driver.tool).translation
        assert np.linalg.norm(tool - drive.target[-1]) < REACHED
        page.mouse.move(300, 500)  # beside the target the mouse turns the camera, as before
        assert page.evaluate(CURSOR) == ""
        page.mouse.down()
        page.mouse.move(360, 500, steps=3)
        page.mouse.up()
        assert until(lambda: page.evaluate(CAMERA) != pytest.approx(camera))
        assert errors == []
        browser.close()


def test_a_page_says_what_is_prepared_until_it_is_shown() -> None:
    server = DriveServer(prepared="go2 <quick>")
    try:
        with urllib.request.urlopen(server.url, timeout=LIMIT) as answer:
            waiting = answer.read().decode()
        server.show("<p>ready</p>", [], lambda wanted: None)
        with urllib.request.urlopen(server.url, timeout=LIMIT) as answer:
            ready = answer.read().decode()
    finally:
        server.close()
    assert "Preparing go2 &lt;quick&gt;." in waiting
    assert '<meta http-equiv="refresh" content="1">' in waiting
    assert ready == "<p>ready</p>"
