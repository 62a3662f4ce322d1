"""``trajopt diagnose``, ``trajopt solve --diagnose``, and the line that points to them."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from tests.support.synthetic_motions import with_meta
from trajopt.cli.commands import main

GRID = ("--intervals", "6")


def run(capsys: pytest.CaptureFixture[str], *words: str) -> tuple[int, str, str]:
    with pytest.raises(SystemExit) as leaving:
        main(list(words))
    said = capsys.readouterr()
    return int(leaving.value.code or 0), said.out, said.err


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("diagnose")


def test_a_failed_solve_points_to_its_diagnosis_and_its_file_is_diagnosed(capsys, folder):
    file = str(folder / "short.npz")
    short = ("solve", "ur5-reach", "--set", "duration=0.1", "--max-iterations", "40", *GRID)
    status, out, _ = run(capsys, *short, "--output", file)
    assert status == 1
    assert out.splitlines()[-1] == f"  next       trajopt diagnose {file}"
    status, out, _ = run(capsys, "diagnose", file)
    assert status == 0
    assert "goal out of reach" in out or "early" in out
    assert "conflict" in out
    status, out, _ = run(capsys, "diagnose", file, "--json")
    found = json.loads(out)
    assert status == 0
    assert found["problem"] == "ur5-reach"
    assert found["clean"] is False
    assert found["advice"]
    assert found["conflict"]["giving"][0]["amount"] > 0


def test_diagnose_of_a_solve_is_printed_and_leaves_the_exit_status_alone(capsys, folder):
    grid = (*GRID, "--transcription", "legendre:4")
    words = ("solve", "ur5-reach", *grid, "--output", str(folder / "reach.npz"), "--diagnose")
    status, out, _ = run(capsys, *words)
    assert status == 0
    assert "the second-order condition holds" in out
    assert "trajopt diagnose" not in out
    status, out, _ = run(capsys, *words, "--json")
    assert status == 0
    assert json.loads(out)["diagnosis"]["feasible"] is True


def test_the_problem_of_a_file_may_be_named(capsys, folder):
    file = str(folder / "reach.npz")
    run(capsys, "solve", "ur5-reach", *GRID, "--output", file)
    status, out, _ = run(capsys, "diagnose", file, "--problem", "ur5-reach", "--set", "duration=2")
    assert status == 0
    assert "they differ" in out


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("nowhere.npz",), "nowhere.npz does not exist"),
        (("FILE", "--problem", "ur5-rech"), "did you mean ur5-reach"),
        (("FILE", "--set", "x=1"), "allowed: with --problem NAME"),
        (("FILE", "--problem", "double-pendulum"), "problem 'double-pendulum' is on robot 'double_pendulum'"),
    ],
)
def test_bad_input_is_one_line_and_status_2(capsys, folder, words, message):
    file = folder / "small.npz"
    if not file.exists():
        run(capsys, "solve", "ur5-reach", "--intervals", "2", "--output", str(file))
    status, out, err = run(capsys, "diagnose", *(str(file) if word == "FILE" else word for word in words))
    assert (status, out) == (2, "")
    assert message in err
    assert err.count("\n") == 1


def test_a_file_of_a_problem_that_nobody_knows_is_refused(capsys, folder):

    from trajopt.solution.solution import Solution

    file = folder / "known.npz"
    run(capsys, "solve", "ur5-reach", "--intervals", "2", "--output", str(file))
    known = Solution.load(file)
    foreign = with_meta(known, problem="my-own").save(folder / "foreign.npz")
    status, _, err = run(capsys, "diagnose", str(foreign))
    assert status == 2
    assert "problem 'my-own' is not in the catalogue" in err
