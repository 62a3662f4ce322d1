"""Files of the user's own are not written over, and paths that lead nowhere are one line."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.support.command_lines import assert_refused, invoke

OWN = "mine, and no output of trajopt\n"


@pytest.fixture
def notes(tmp_path: Path) -> Path:
    file = tmp_path / "notes.txt"
    file.write_text(OWN, encoding="utf-8")
    return file


def test_a_log_does_not_replace_another_file(notes: Path) -> None:
    done = invoke("solve", "ur5-reach", "--log", notes, "--output", notes.parent / "reach.npz")
    assert_refused(done, "it is there and is no table of iterations", "allowed: another name")
    assert notes.read_text(encoding="utf-8") == OWN


def test_a_log_of_a_continuation_does_not_replace_its_start(notes: Path) -> None:
    vary = ("--vary", "x=0.2:0.4:2", "--start", notes, "--log", notes)
    assert_refused(invoke("continue", "ur5-reach", *vary), "notes.txt is an input file")
    assert notes.read_text(encoding="utf-8") == OWN


def test_a_page_of_a_robot_is_a_page(notes: Path) -> None:
    assert_refused(invoke("robot", "ur5", "--html", notes), "does not end with .html")
    assert notes.read_text(encoding="utf-8") == OWN


def test_results_replace_nothing_else(notes: Path) -> None:
    results = notes.rename(notes.parent / "results.jsonl")
    done = invoke("bench", "suite", "--problems", "ur5-reach", "--output-dir", results.parent)
    assert_refused(done, "it is there and holds no results", "allowed: another folder")
    assert results.read_text(encoding="utf-8") == OWN


def test_a_sweep_deletes_no_solutions_that_are_not_its_own(tmp_path: Path) -> None:
    own = tmp_path / "solutions" / "mine.npz"
    own.parent.mkdir()
    own.write_text(OWN, encoding="utf-8")
    done = invoke("bench", "sweep", "ur5-reach", "--output-dir", tmp_path)
    assert_refused(done, "mine.npz is there, without a sweep", "allowed: another --output-dir")
    assert own.read_text(encoding="utf-8") == OWN


@pytest.mark.parametrize(
    "words",
    [
        ("check", "~nobody-of-that-name/a.npz"),
        ("solve", "ur5-reach", "--output", "~nobody-of-that-name/a.npz"),
        ("solve", "ur5-reach", "--log", "~nobody-of-that-name/a.csv"),
        ("robot", "~nobody-of-that-name/a.urdf"),
    ],
)
def test_a_home_folder_that_does_not_exist_is_one_line(words: tuple[str, ...]) -> None:
    assert_refused(invoke(*words), "there is no home folder of that user")


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("solve", "ur5-reach", "--start", "."), "."),
        (("solve", "ur5-reach", "--ladder", "legendre:1@99999999999999999999"), "--ladder"),
        (("simulate", "a.npz", "--seed", "3"), "--seed has no effect here; allowed: with --noise"),
        (("simulate", "a.npz", "--controller", "whole-body", "--kp", "2"), "--kp has no effect here"),
        (("bench",), "Missing command"),
    ],
)
def test_what_has_no_effect_or_no_end_is_one_line(words: tuple[str, ...], message: str) -> None:
    assert_refused(invoke(*words), message)
