"""The live replay: a server that answers with the player's page, and ends with us."""

import os
import socket
import sys
import urllib.error
import urllib.request
import webbrowser

import meshcat
import meshcat.geometry as shapes
import pytest

from tests.support.browser import require_chromium
from tests.support.processes import LIMIT, Running, until
from trajopt import TrajoptError
from trajopt.view.replay import show
from trajopt.view.replay.browser import FLAGS, find_chromium
from trajopt.view.replay.show import replay

SPHERE = "trajopt.viewer.scene_tree.find(['meshcat', 'added']).object.children.length"
KILLED = """
import sys, time
from trajopt.view.replay.show import replay
from trajopt.motion import Solution
shown = replay(Solution.load(sys.argv[1]), open_browser=False)
print(shown.window.server_proc.pid, flush=True)
time.sleep(600)
"""


@pytest.fixture(scope="module")
def shown(hop):
    entry = replay(hop, open_browser=False)
    yield entry
    entry.close()


def fetched(address: str) -> tuple[int, str]:
    with urllib.request.urlopen(address, timeout=LIMIT) as answer:
        return answer.status, answer.read().decode()


def test_a_window_whose_server_has_ended_sends_nothing() -> None:
    """Another server may listen at its port by now."""
    window = show.LiveWindow()
    try:
        window.server_proc.kill()
        window.server_proc.wait(LIMIT)
        with pytest.raises(TrajoptError, match="the Meshcat server has ended"):
            window.tell("drawn", True)
    finally:
        window.close()


def test_server_answers_with_the_page_and_keeps_that_of_meshcat(shown):
    status, text = fetched(shown.url)
    assert status == 200
    assert "<title>hop – solo12</title>" in text
    assert "connect-src data: blob: 'self' ws://127.0.0.1:*" in text
    assert fetched(f"{shown.url}favicon.ico") == (204, "")
    assert "MeshCat" in fetched(f"{shown.url}static/")[1]


def test_server_answers_on_this_machine_only(shown):
    port = int(shown.url.rstrip("/").rpartition(":")[2])
    with socket.socket() as other:
        other.bind(("127.0.0.2", port))  # free: the server has not taken the port of every address
        assert other.getsockname() == ("127.0.0.2", port)


def test_second_replay_takes_the_next_port(hop, shown):
    second = replay(hop, open_browser=False)
    try:
        assert second.url != shown.url
        assert fetched(second.url)[0] == fetched(shown.url)[0] == 200
    finally:
        second.close()
    with pytest.raises(urllib.error.URLError):
        fetched(second.url)


def test_closing_twice_is_no_error(hop):
    second = replay(hop, open_browser=False)
    second.close()
    second.close()
    assert second.window.server_proc.poll() is not None


@pytest.mark.long
def test_server_ends_when_its_owner_is_killed(hop, tmp_path):
    file = hop.save(tmp_path / "hop.npz")
    with Running(sys.executable, "-c", KILLED, file) as owner:
        lines = [owner.popen.stdout.readline() for _ in range(2)]
        assert lines[0].startswith("replay at http://127.0.0.1:")
        owner.kill()
    assert until(lambda: not runs(int(lines[1])))


def runs(pid: int) -> bool:
    try:
        with open(f"/proc/{pid}/stat", encoding="utf-8") as stat:
            return stat.read().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


def test_browser_is_opened_only_where_there_is_a_screen(shown, monkeypatch):
    opened = []
    monkeypatch.setattr(webbrowser, "open", lambda address, new=0: opened.append(address))
    monkeypatch.setattr(sys, "platform", "linux")
    for name in show.DISPLAYS:
        monkeypatch.delenv(name, raising=False)
    shown.window.open()
    assert opened == []
    monkeypatch.setenv("DISPLAY", ":0")
    shown.window.open()
    assert opened == [shown.url]


def test_over_ssh_it_is_said_how_to_reach_the_server(monkeypatch):
    monkeypatch.delenv("SSH_CONNECTION", raising=False)
    assert show.server_address_text("http://127.0.0.1:7001/") == "replay at http://127.0.0.1:7001/"
    monkeypatch.setenv("SSH_CONNECTION", "1 2 3 4")
    assert "ssh -L 7001:127.0.0.1:7001" in show.server_address_text("http://127.0.0.1:7001/")


@pytest.mark.long
def test_page_shows_the_scene_and_what_a_script_adds_and_says_when_the_server_ends(hop):
    require_chromium()
    from playwright.sync_api import sync_playwright

    window = replay(hop, open_browser=False)
    try:
        with sync_playwright() as driver:
            browser = driver.chromium.launch(executable_path=find_chromium(), args=list(FLAGS))
            view, errors = browser.new_page(), []
            view.on("console", lambda message: message.type == "error" and errors.append(message.text))
            view.on("pageerror", lambda error: errors.append(str(error)))
            view.goto(f"{window.url}#t=0.25&camera=top")
            view.evaluate("trajopt.ready")
            state = view.evaluate("trajopt.state()")
            assert (state["time"], state["phase"], state["camera"]) == (0.25, "phase 1", "top")
            assert view.evaluate(SPHERE) == 0
            meshcat.Visualizer(window=window.window)["added"].set_object(shapes.Sphere(0.1))
            view.wait_for_function(f"{SPHERE} === 1", timeout=1e3 * LIMIT)
            window.window.show([], {**window.facts, "title": "another"})
            view.wait_for_function("document.title === 'another'", timeout=1e3 * LIMIT)
            assert errors == []
            window.close()
            view.wait_for_selector("#message:has-text('the server has stopped')", timeout=1e3 * LIMIT)
            browser.close()
    finally:
        window.close()


def test_server_that_cannot_start_says_why_in_one_line(monkeypatch, tmp_path):
    broken = tmp_path / "server.py"
    broken.write_text("raise OSError('no port is free')")
    monkeypatch.setattr(show.server, "__file__", str(broken))
    with pytest.raises(show.TrajoptError, match="does not start: OSError: no port is free"):
        show.LiveWindow()
    assert os.path.exists(broken)
