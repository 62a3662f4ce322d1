"""The page of a replay as text: its policy, its facts, its size, and what is refused."""

import base64
import hashlib
import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.support.command_lines import invoke
from tests.support.replay_pages import scene_of
from tests.support.repository import ROOT
from tests.support.synthetic_motions import with_meta
from trajopt.errors import InputError
from trajopt.motion.solution import Solution
from trajopt.view.replay.contacts import COLOURS
from trajopt.view.replay.show import replay

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
