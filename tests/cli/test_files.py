"""Names of files tell the settings; files of the user are not written over; bad paths are one line."""

from pathlib import Path

import click
import pytest

from tests.support.command_lines import assert_refused, invoke
from trajopt import Solution
from trajopt.cli.commands import main
from trajopt.cli.input import file_of_settings

NOTES = "mine, and no output of trajopt\n"


@pytest.fixture
def notes(tmp_path: Path) -> Path:
    file = tmp_path / "notes.txt"
    file.write_text(NOTES, encoding="utf-8")
    return file


def test_a_log_does_not_replace_another_file(notes: Path) -> None:
    done = invoke("solve", "ur5-reach", "--log", notes, "--output", notes.parent / "reach.npz")
    assert_refused(done, "it is there and is no table of iterations", "allowed: another name")
    assert notes.read_text(encoding="utf-8") == NOTES


def test_a_log_of_a_continuation_does_not_replace_its_start(notes: Path) -> None:
    vary = ("--vary", "x=0.2:0.4:2", "--start", notes, "--log", notes)
    assert_refused(invoke("continue", "ur5-reach", *vary), "notes.txt is an input file")
    assert notes.read_text(encoding="utf-8") == NOTES


def test_a_continuation_that_is_refused_leaves_no_folder(tmp_path: Path) -> None:
    arguments = ("--vary", "x=0.2:0.4:2", "--max-time", 0, "--output-dir", tmp_path / "new" / "out")
    assert_refused(invoke("continue", "ur5-reach", *arguments), "max_time is 0 s")
    assert not (tmp_path / "new").exists()


def test_a_page_of_a_robot_is_a_page(notes: Path) -> None:
    assert_refused(invoke("robot", "ur5", "--html", notes), "does not end with .html")
    assert notes.read_text(encoding="utf-8") == NOTES


def test_results_replace_nothing_else(notes: Path) -> None:
    results = notes.rename(notes.parent / "results.jsonl")
    done = invoke("bench", "suite", "--problems", "ur5-reach", "--output-dir", results.parent)
    assert_refused(done, "it is there and holds no results", "allowed: another folder")
    assert results.read_text(encoding="utf-8") == NOTES


def test_a_sweep_deletes_no_solutions_that_are_not_its_own(tmp_path: Path) -> None:
    mine = tmp_path / "solutions" / "mine.npz"
    mine.parent.mkdir()
    mine.write_text(NOTES, encoding="utf-8")
    done = invoke("bench", "sweep", "ur5-reach", "--output-dir", tmp_path)
    assert_refused(done, "mine.npz is there, without a sweep", "allowed: another folder")
    assert mine.read_text(encoding="utf-8") == NOTES


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


# The words of a name, beside the problem's, of the options that are given.
WORDS = {
    "nothing": ((), ()),
    "a parameter": (("--set", "distance=0.8"), ("distance=0.8",)),
    "parameters": (("--set", "yaw = 45deg", "--set", "height=0.1"), ("yaw=45deg", "height=0.1")),
    "a file": (("--set", "robot=my/dog.py"), ("robot=my_dog.py",)),
    "a mesh": (
        ("--transcription", "legendre:4", "--intervals", "12"),
        ("transcription=legendre_4", "intervals=12"),
    ),
    "a model": (("--smallest", "--explain"), ("smallest",)),
    "joints": (("--keep", "FL_HAA", "--keep", "FR_HAA"), ("keep=FL_HAA", "keep=FR_HAA")),
    "a start": (("--start", "files/old.npz", "--compare"), ("start=files_old",)),
    "a target": (("--accuracy", "1e-3"), ("accuracy=0.001",)),
    "a solver": (
        ("--hessian", "gauss-newton", "--solver-option", "mu_init=1e-7"),
        ("hessian=gauss-newton", "mu_init=1e-7"),
    ),
    "limits": (("--max-iterations", "3"), ("max-iterations=3",)),
    "defaults": (("--solver", "ipopt", "--tolerance", "1e-6"), ()),
    "no change of the motion": (("--watch", "--json", "--explain", "--threads", "2", "--diagnose"), ()),
}


@pytest.mark.parametrize("case", WORDS)
def test_a_name_tells_the_settings_that_change_the_motion(case: str) -> None:
    given, words = WORDS[case]
    command = main.get_command(click.Context(main), "solve")
    assert command is not None
    context = command.make_context("solve", ["jump", *given])
    assert sorted(file_of_settings(context).name.removesuffix(".npz").split("-")) == sorted(
        "-".join(("jump", *words)).split("-")
    )


@pytest.mark.long
def test_other_settings_do_not_overwrite_a_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    hop = ("solve", "hopper-hop", "--intervals", "9")
    for more in ((), ("--set", "distance=0.1")):
        assert invoke(*hop, *more).exit_code == 1  # the mesh is coarse
    first, second = (Path(f"hopper-hop{part}-intervals=9.npz") for part in ("", "-distance=0.1"))
    assert Solution.load(first).description.parameters["distance"] == 0.2
    assert Solution.load(second).description.parameters["distance"] == 0.1


def test_a_name_that_would_be_too_long_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    more = [word for joint in range(40) for word in ("--keep", f"joint_{joint}")]
    assert_refused(invoke("solve", "solo12-jump", *more), "a file name of", "allowed: --output FILE")
    assert not list(tmp_path.iterdir())
