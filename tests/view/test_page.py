"""The page of a replay as text, served live, and its tracks within the stated errors."""

import base64
import hashlib
import json
import os
import re
import socket
import sys
import urllib.error
import urllib.request
import webbrowser
from dataclasses import replace
from pathlib import Path

import meshcat
import meshcat.geometry as shapes
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.spatial.transform import Rotation, Slerp

from tests.support.browser import require_chromium
from tests.support.command_lines import invoke
from tests.support.processes import LIMIT, Running, until
from tests.support.replay_pages import hopping, key_frames_of, scene_of, shown
from tests.support.repository import ROOT
from tests.support.synthetic_motions import with_meta
from trajopt import InputError, Solution, TrajoptError, replay
from trajopt.view.replay import show
from trajopt.view.replay.browser import FLAGS, find_chromium
from trajopt.view.replay.commands import (
    ANGLE_ERROR,
    FINER,
    POSITION_ERROR,
    Animation,
    Recorder,
    hold_while_hidden,
    quaternions,
    rounded,
    thin_key_frames,
    turns_to,
)
from trajopt.view.replay.contacts import COLOURS

WEB = ROOT / "trajopt" / "view" / "replay" / "web"
# Bytes: Meshcat's viewer takes 0.29 MB, solo12's meshes 0.15 MB; a second run of it adds tracks.
SMALL_PAGE, SECOND_RUN = 0.7e6, 0.05e6
CONTRAST = 4.5  # of text to its ground, WCAG 2.1 AA


@pytest.fixture(scope="module")
def page(hop, tmp_path_factory) -> tuple[str, dict]:
    return page_of(hop, tmp_path_factory.mktemp("page"))


def page_of(solutions: Solution | list[Solution], folder: Path, **options: object) -> tuple[str, dict]:
    """The page's text, and the facts in it."""
    replay(solutions, html=folder / "page.html", **options)
    text = (folder / "page.html").read_text()
    return text, facts_of(text)


def facts_of(text: str) -> dict:
    return json.loads(re.search(r'<script id="facts"[^>]*>(.*?)</script>', text, re.S).group(1))


def policy_of(text: str) -> dict[str, list[str]]:
    rules = re.search(r'Content-Security-Policy" content="([^"]*)"', text).group(1).split(";")
    return {words[0]: words[1:] for words in (rule.split() for rule in rules)}


def said(facts: dict) -> list[str]:
    return [line["text"] for line in facts["lines"]]


def test_policy_allows_the_player_by_its_hash_and_no_other_script_of_the_page(page):
    text, _ = page
    player = re.findall(r"<script>(.*?)</script>", text, re.S)
    digest = base64.b64encode(hashlib.sha256(player[-1].encode()).digest()).decode()
    assert len(player) == 1
    assert policy_of(text)["script-src"] == [f"'sha256-{digest}'", "blob:"]


def test_policy_allows_no_connection(page):
    policy = policy_of(page[0])
    assert policy["default-src"] == ["'none'"]
    assert set(policy["connect-src"] + policy["img-src"]) == {"data:", "blob:"}


def test_facts_hold_phases_times_and_layers(hop, tmp_path):
    shown = replay(hop, html=tmp_path / "page.html", speed=0.5)
    facts = facts_of((tmp_path / "page.html").read_text())
    assert facts == json.loads(json.dumps({**shown.facts, "live": False}))
    assert [phase["start"] for phase in facts["phases"]] == pytest.approx([0.0, 0.2, 0.3])
    assert facts["duration"] * facts["speed"] == pytest.approx(0.5)
    assert facts["picture"] == pytest.approx(0.5 / (shown.frames - 1))
    assert {"robot", "forces", "terrain"} <= {layer["name"] for layer in facts["layers"]}


def test_caption_tells_problem_grid_objective_and_measured_error(hop, tmp_path):
    graded = {"reached": True, "why": "", "spent_s": 0.1, "examined_s": 0.1, "rounds": [], "error_m": 2e-4}
    solution = with_meta(hop, transcription="legendre:2", objective=0.25, graded=graded, success=True)
    text, facts = page_of(solution, tmp_path)
    assert facts["title"] == "hop – solo12"
    assert "<title>hop – solo12</title>" in text
    assert said(facts)[0].startswith("0.50 s; legendre:2, ")
    assert said(facts)[0].endswith("objective 0.25; open-loop error 0.2 mm")


def test_caption_speaks_of_layers_that_the_scene_has(hop, tmp_path):
    still = replace(hop, f=np.zeros_like(hop.f), active=np.zeros_like(hop.active))
    for solution, expected in ((hop, {"forces", "cones"}), (still, set())):
        _, facts = page_of(solution, tmp_path)
        named = {line["layer"] for line in facts["lines"]} - {""}
        assert named == expected
        assert named <= {layer["name"] for layer in facts["layers"]}
        assert any("weight" in text for text in said(facts)) == bool(expected)


def test_caption_has_a_legend_of_the_cones_colours(page):
    _, facts = page
    line = next(line for line in facts["lines"] if line["layer"] == "cones")
    assert line["text"] == "cones: share of friction used, 0 to 100 %"
    assert all(f"#{colour:06x}" in line["colour"] for colour in COLOURS)


def test_text_of_a_solution_cannot_end_a_script_of_the_page(hop, page, tmp_path):
    harmless, _ = page
    text, facts = page_of(with_meta(hop, problem="</script><script>alert(1)"), tmp_path)
    assert facts["title"] == "</script><script>alert(1) – solo12"
    assert text.count("</script") == harmless.count("</script")
    assert "<script>alert" not in text


def test_number_that_is_not_finite_is_left_out_of_the_caption(hop, tmp_path):
    _, facts = page_of(with_meta(hop, objective=float("nan")), tmp_path)
    assert "objective" not in said(facts)[0]


def test_several_solutions_have_a_line_each_in_their_colour(hop, tmp_path):
    failed = with_meta(hop, success=False, status="iteration_limit")
    _, facts = page_of([hop, failed], tmp_path, labels=["plan", "other"], layout="side-by-side")
    runs = [(line["text"], line["colour"]) for line in facts["lines"] if line["kind"] == "run"]
    assert runs == [(run["label"], run["colour"]) for run in facts["runs"]]
    assert [text for text, _ in runs] == ["plan", "other"]
    assert [line["text"] for line in facts["lines"] if line["kind"] == "failed"] == [
        "not solved: iteration limit"
    ]


def test_page_is_small_and_a_second_run_of_the_same_robot_adds_its_motion_only(hop, tmp_path):
    one, two = (replay(several, html=tmp_path / "page.html").size for several in (hop, [hop, hop]))
    assert one < SMALL_PAGE
    assert two - one < SECOND_RUN
    scene = scene_of((tmp_path / "page.html").read_text())
    assert len([command for command in scene["commands"] if "/run1/robot/" in command["path"]]) >= 17


def test_same_solution_gives_the_same_page_byte_by_byte(hop, tmp_path):
    assert page_of([hop, hop], tmp_path)[0] == page_of([hop, hop], tmp_path)[0]


def test_motion_that_flies_off_has_a_small_page(hop, page, tmp_path):
    q = hop.q.copy()
    q[:, 0] += 1e6 * hop.t
    away, _ = page_of(replace(hop, q=q), tmp_path)
    assert len(away) < 1.5 * len(page[0])


@pytest.mark.parametrize("target", ["nowhere/page.html", ".", "/proc/page.html", "x" * 300 + ".html"])
def test_page_that_cannot_be_written_is_refused_and_leaves_nothing(hop, tmp_path, target):
    with pytest.raises(InputError, match="cannot write"):
        replay(hop, html=tmp_path / target)
    assert list(tmp_path.iterdir()) == []


def test_page_takes_the_place_of_an_older_one_with_the_rights_of_a_new_file(hop, tmp_path):
    (tmp_path / "page.html").write_text("old")
    fresh = tmp_path / "fresh"
    fresh.touch()
    page_of(hop, tmp_path)
    assert (tmp_path / "page.html").stat().st_mode == fresh.stat().st_mode
    assert {path.name for path in tmp_path.iterdir()} == {"page.html", "fresh"}


@pytest.mark.parametrize(
    ("options", "refusal"),
    [
        ({"labels": ["one", "two"]}, "2 labels for 3 solutions"),
        ({"layout": "stacked"}, "unknown layout 'stacked'"),
        ({"speed": 0.0}, "speed is 0"),
    ],
)
def test_options_that_do_not_fit_are_refused_before_anything_is_written(hop, tmp_path, options, refusal):
    with pytest.raises(InputError, match=refusal):
        replay([hop, hop, hop], html=tmp_path / "page.html", **options)
    assert list(tmp_path.iterdir()) == []


def test_nothing_to_replay_is_refused(tmp_path):
    with pytest.raises(InputError, match="nothing to replay"):
        replay([], html=tmp_path / "page.html")


def test_command_writes_several_files_to_one_page_and_tells_its_size(hop, tmp_path):
    files = [str(replace(hop).save(tmp_path / f"{name}.npz")) for name in ("a", "b")]
    target = tmp_path / "both.html"
    call = ["replay", *files, "--html", str(target), "--side-by-side", "--label", "a", "--label", "b"]
    done = invoke(*call, "--speed", "0.25")
    assert done.exit_code == 0
    assert done.stdout == f"{target}: 2.00 s, {target.stat().st_size / 1e6:.1f} MB\n"
    refused = invoke(*call[:-2])
    assert (refused.exit_code, refused.stderr.count("\n")) == (2, 1)
    assert "1 labels for 2 solutions" in refused.stderr


def test_text_has_the_contrast_that_wcag_asks_for():
    style, panel = (WEB / "page.css").read_text(), (WEB / "panel.js").read_text()
    inks = dict(re.findall(r"--(ink|quiet|failed|warned|accent): (#[0-9a-f]{6})", style))
    grounds = re.findall(r'"(#[0-9a-f]{6})"', panel.partition("const TINTS")[2].partition("]")[0])
    assert len(inks) == 5
    assert len(grounds) == 7
    assert min(contrast(inks["ink"], ground) for ground in grounds) > CONTRAST
    # cards are white over the picture, at their least opaque over black
    card = 255 * float(re.search(r"--card: rgba\(255, 255, 255, ([0-9.]+)\)", style).group(1))
    darkest = f"#{round(card):02x}{round(card):02x}{round(card):02x}"
    assert min(contrast(ink, darkest) for ink in inks.values()) > CONTRAST


def contrast(first: str, second: str) -> float:
    """Contrast ratio of two colours by WCAG 2.1."""

    def luminance(colour: str) -> float:
        levels = [int(colour[k : k + 2], 16) / 255 for k in (1, 3, 5)]
        linear = [level / 12.92 if level <= 0.04045 else ((level + 0.055) / 1.055) ** 2.4 for level in levels]
        return 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2]

    dark, light = sorted([luminance(first), luminance(second)])
    return (light + 0.05) / (dark + 0.05)


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
def served(hop):
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


def test_server_answers_with_the_page_and_keeps_that_of_meshcat(served):
    status, text = fetched(served.url)
    assert status == 200
    assert "<title>hop – solo12</title>" in text
    assert "connect-src data: blob: 'self' ws://127.0.0.1:*" in text
    assert fetched(f"{served.url}favicon.ico") == (204, "")
    assert "MeshCat" in fetched(f"{served.url}static/")[1]


def test_server_answers_on_this_machine_only(served):
    port = int(served.url.rstrip("/").rpartition(":")[2])
    with socket.socket() as other:
        other.bind(("127.0.0.2", port))  # free: the server has not taken the port of every address
        assert other.getsockname() == ("127.0.0.2", port)


def test_second_replay_takes_the_next_port(hop, served):
    second = replay(hop, open_browser=False)
    try:
        assert second.url != served.url
        assert fetched(second.url)[0] == fetched(served.url)[0] == 200
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


def test_browser_is_opened_only_where_there_is_a_screen(served, monkeypatch):
    opened = []
    monkeypatch.setattr(webbrowser, "open", lambda address, new=0: opened.append(address))
    monkeypatch.setattr(sys, "platform", "linux")
    for name in show.DISPLAYS:
        monkeypatch.delenv(name, raising=False)
    served.window.open()
    assert opened == []
    monkeypatch.setenv("DISPLAY", ":0")
    served.window.open()
    assert opened == [served.url]


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


ERROR = 1e-3
ROUNDING = 1e-9


def smooth(n: int, columns: int) -> np.ndarray:
    t = np.linspace(0, 1, n)
    return np.column_stack([np.sin((3 + 2 * k) * t + k) for k in range(columns)])


@pytest.mark.parametrize("n", [2, 3, 17, 100, 1000])
def test_linear_track_stays_within_its_error_with_fewer_frames(n):
    values = smooth(n, 3)
    kept = thin_key_frames(values, "vector3", ERROR)
    between = np.column_stack([np.interp(np.arange(n), kept, column[kept]) for column in values.T])
    assert np.linalg.norm(between - values, axis=1).max() <= ERROR + ROUNDING
    assert kept[0] == 0
    assert kept[-1] == n - 1
    if n == 1000:
        assert len(kept) < 0.2 * n


def test_turning_track_stays_within_its_angle():
    vectors = smooth(400, 3)
    values = Rotation.from_rotvec(vectors).as_quat()
    values[::3] *= -1  # the same rotations
    kept = thin_key_frames(values, "quaternion", ANGLE_ERROR)
    between = Slerp(kept, Rotation.from_quat(values[kept]))(np.arange(400))
    error = (between.inv() * Rotation.from_rotvec(vectors)).magnitude()
    assert error.max() <= ANGLE_ERROR + ROUNDING
    assert len(kept) < 0.5 * 400


def test_tracks_as_written_stay_within_their_stated_errors():
    rotation = Rotation.from_rotvec(smooth(400, 3))
    tracks, node = Animation(400, 60.0, 1.0), meshcat.Visualizer(window=Recorder())["robot"]
    tracks.add(node, "position", smooth(400, 3))
    tracks.add(node, "quaternion", rotation.as_quat())
    position, turn = tracks.command().message["animations"][0]["clip"]["tracks"]
    times, values = (np.frombuffer(position[name].data, np.float32) for name in ("times", "values"))
    written = np.column_stack([np.interp(np.arange(400), times, row) for row in values.reshape(-1, 3).T])
    assert np.linalg.norm(written - smooth(400, 3), axis=1).max() <= POSITION_ERROR
    times, values = (np.frombuffer(turn[name].data, np.float32) for name in ("times", "values"))
    error = Slerp(times, Rotation.from_quat(values.reshape(-1, 4)))(np.arange(400)).inv() * rotation
    assert error.magnitude().max() <= ANGLE_ERROR


def test_still_track_keeps_its_ends_and_a_jump_both_its_sides():
    still = np.ones((50, 3))
    assert_array_equal(thin_key_frames(still, "vector3", ERROR), [0, 49])
    still[20:] += 1.0
    kept = thin_key_frames(still, "vector3", ERROR)
    assert {0, 19, 20, 49} <= set(kept.tolist())


def test_boolean_track_keeps_its_changes():
    shown_at = np.array([[True]] * 5 + [[False]] * 3 + [[True]] * 4)
    assert_array_equal(thin_key_frames(shown_at, "boolean", 0.0), [0, 5, 8, 11])


def test_rounding_is_far_below_the_error_and_to_few_bits():
    values = smooth(100, 3)
    near = rounded(values, ERROR)
    assert np.abs(near - values).max() <= ERROR / FINER / 2
    step = 2.0 ** np.floor(np.log2(ERROR / FINER))
    assert_array_equal(near / step, np.round(near / step))


def test_hidden_frames_hold_what_was_last_seen():
    values = np.arange(6.0)[:, None]
    seen = np.array([False, True, True, False, False, True])
    assert_array_equal(hold_while_hidden(values, seen)[:, 0], [1, 1, 2, 2, 2, 5])
    assert_array_equal(hold_while_hidden(values, np.zeros(6, dtype=bool))[:, 0], np.zeros(6))


def test_turns_take_the_vertical_to_any_direction():
    ways = np.array([[0, 0, 2.0], [0, 0, -3.0], [1.0, 2.0, -0.5], [1e-9, 0, -1.0], [0.0, 0.0, 0.0]])
    axes = Rotation.from_quat(turns_to(ways)).apply([0.0, 0.0, 1.0])
    expected = ways / np.maximum(np.linalg.norm(ways, axis=1, keepdims=True), 1e-300)
    expected[4] = [0.0, 0.0, 1.0]
    np.testing.assert_allclose(axes, expected, atol=1e-8)


def test_standing_robot_needs_two_key_frames_a_track(tmp_path):
    frames = key_frames_of(shown(hopping(), tmp_path))
    assert max(count for (path, _), count in frames.items() if path.startswith("robot/")) == 2


def test_quaternions_of_matrices_are_scipys():
    turned = Rotation.random(100, random_state=0).as_matrix()
    half = Rotation.from_rotvec(np.pi * np.eye(3)).as_matrix()
    for rotations in (turned, half):
        assert_allclose(quaternions(rotations), Rotation.from_matrix(rotations).as_quat(), atol=ROUNDING)
