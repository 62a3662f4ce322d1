"""``trajopt diagnose``, ``trajopt solve --diagnose``, and the line that points to them."""

import json
from pathlib import Path

import pytest

from tests.support.command_lines import assert_refused, invoke
from tests.support.synthetic_motions import with_meta
from trajopt.solution.solution import Solution

GRID = ("--intervals", "6")
COARSE = ("solve", "ur5-reach", "--intervals", "2")


def said(*words: object, status: int = 0) -> str:
    """What a command prints that ends with that status."""
    result = invoke(*words)
    assert result.exit_code == status, result.output
    return result.stdout


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("diagnose")


def test_a_failed_solve_points_to_its_diagnosis_and_its_file_is_diagnosed(folder):
    file = folder / "short.npz"
    short = ("solve", "ur5-reach", "--set", "duration=0.1", "--max-iterations", "40", *GRID)
    assert said(*short, "--output", file, status=1).splitlines()[-1].endswith(f" trajopt diagnose {file}")
    text = said("diagnose", file)
    assert "goal out of reach" in text or "early" in text
    assert "conflict" in text
    diagnosis = json.loads(said("diagnose", file, "--json"))
    assert (diagnosis["problem"], diagnosis["clean"]) == ("ur5-reach", False)
    assert diagnosis["advice"]
    assert diagnosis["conflict"]["giving"][0]["amount"] > 0


def test_diagnose_of_a_solve_is_printed_and_leaves_the_exit_status_alone(folder):
    grid = (*GRID, "--transcription", "legendre:4")
    words = ("solve", "ur5-reach", *grid, "--output", folder / "reach.npz", "--diagnose")
    text = said(*words)
    assert "the second-order condition holds" in text
    assert "trajopt diagnose" not in text
    assert json.loads(said(*words, "--json"))["diagnosis"]["feasible"] is True


def test_the_problem_of_a_file_may_be_named(folder):
    file = folder / "reach.npz"
    invoke("solve", "ur5-reach", *GRID, "--output", file)
    assert "they differ" in said("diagnose", file, "--problem", "ur5-reach", "--set", "duration=2")


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("nowhere.npz",), "nowhere.npz does not exist"),
        (("FILE", "--problem", "ur5-rech"), "did you mean ur5-reach"),
        (("FILE", "--set", "x=1"), "allowed: with --problem NAME"),
        (("FILE", "--problem", "double-pendulum"), "problem 'double-pendulum' is on robot 'double_pendulum'"),
    ],
)
def test_bad_input_is_one_line_and_status_2(folder, words, message):
    file = folder / "small.npz"
    if not file.exists():
        invoke(*COARSE, "--output", file)
    assert_refused(invoke("diagnose", *(file if word == "FILE" else word for word in words)), message)


def test_a_file_of_a_problem_that_nobody_knows_is_refused(folder):
    file = folder / "known.npz"
    invoke(*COARSE, "--output", file)
    foreign = with_meta(Solution.load(file), problem="my-own").save(folder / "foreign.npz")
    assert_refused(invoke("diagnose", foreign), "problem 'my-own' is not in the catalogue")
