"""What the command line says about a scene, and what it writes."""

import json
from pathlib import Path

import pytest
from click.testing import Result

from tests.support.command_lines import assert_refused, invoke
from trajopt import Solution

pytestmark = pytest.mark.long

# Of 12 intervals 4, 3 and 5 in stance, flight and landing; a whole node has 37 entries, a half 18, a point 18
# or 9 accelerations and on four or two feet 12 or 6 forces.
WHOLE = 13 * 37 + 9 * 2 * (18 + 12) + 3 * 2 * 18
HALF = 13 * 18 + 9 * 2 * (9 + 6) + 3 * 2 * 9
JUMP = ("solve", "solo12-jump", "--set", "distance=10cm", "--intervals", "12")


@pytest.fixture(scope="module")
def explained(tmp_path_factory: pytest.TempPathFactory) -> tuple[Result, Path]:
    file = tmp_path_factory.mktemp("scene") / "jump.npz"
    return invoke(*JUMP, "--smallest", "--explain", "--output", file), file


def test_explain_says_what_is_modelled_what_is_not_and_why_before_it_solves(
    explained: tuple[Result, Path],
) -> None:
    result, _ = explained
    assert result.exit_code == 1, result.output  # its feet drift on so coarse a mesh
    text = result.stdout
    order = [
        "modelled",
        "left out, exactly",
        "left out, a choice",
        "kept:",
        "size ",
        "solved at",
        "objective",
    ]
    places = [text.index(words) for words in order]
    assert places == sorted(places)
    assert f"{WHOLE} -> {HALF} variables" in text
    assert "beyond 30 m g l" in text


def test_the_file_of_a_scene_is_the_whole_robots(explained: tuple[Result, Path]) -> None:
    solution = Solution.load(explained[1])
    assert solution.model.nv == 18
    assert solution.f.shape[1] == 4
    assert solution.statistics.variables == HALF


def test_smallest_solves_the_same_silently_and_json_has_the_scene(tmp_path: Path) -> None:
    result = invoke(*JUMP, "--smallest", "--json", "--output", tmp_path / "jump.npz")
    report = json.loads(result.stdout)
    assert report["variables"] == report["scene"]["after"]["variables"] == HALF
    assert report["scene"]["before"]["variables"] == WHOLE
    assert report["scene"]["exact"] is False
    kinds = {decision["kind"] for decision in report["scene"]["decisions"]}
    assert kinds <= {"exact", "choice", "kept", "offer"}


@pytest.mark.slow
def test_a_lifted_motion_that_misses_the_check_is_solved_for_the_whole_robot(tmp_path: Path) -> None:
    file = tmp_path / "jump.npz"
    result = invoke("solve", "solo12-jump", "--smallest", "--output", file)
    assert result.exit_code == 0, result.output
    assert "whole robot: solved from the reduced motion" in result.stdout
    assert invoke("check", file).exit_code == 0


def test_without_these_options_the_problem_is_solved_as_it_is_built(tmp_path: Path) -> None:
    report = json.loads(invoke(*JUMP, "--json", "--output", tmp_path / "jump.npz").stdout)
    assert report["variables"] == WHOLE
    assert "scene" not in report


def test_an_explanation_alone_changes_nothing(tmp_path: Path) -> None:
    report = json.loads(invoke(*JUMP, "--explain", "--json", "--output", tmp_path / "jump.npz").stdout)
    assert report["variables"] == WHOLE
    assert report["scene"]["after"]["variables"] == HALF
    assert Solution.load(tmp_path / "jump.npz").statistics.variables == WHOLE


def test_a_joint_to_keep_must_exist(tmp_path: Path) -> None:
    result = invoke(*JUMP, "--keep", "FL_HIP", "--output", tmp_path / "jump.npz")
    assert_refused(result, "joint 'FL_HIP' to keep is unknown; one of root_joint, FL_HAA")
