"""``trajopt suite`` on the command line: output, exit status, files, Ctrl-C, processes left behind."""

import json
import signal
from collections.abc import Iterator
from pathlib import Path

import pytest
from click.testing import Result

from tests.support import suite_problems
from tests.support.command_lines import invoke
from tests.support.packages import installed
from tests.support.processes import (
    TRAJOPT,
    Running,
    environment,
    needs_proc,
    no_task_process_left,
    task_processes,
)
from trajopt.study.suite import data


@pytest.fixture(scope="module", autouse=True)
def package(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """The folder that offers the tests' own families."""
    with installed(suite_problems, tmp_path_factory.mktemp("package")) as folder:
        yield folder


def suite(*arguments: object) -> Result:
    return invoke("bench", "suite", *arguments)


@pytest.mark.parametrize(
    "lists",
    [
        ("--problems", "t-rob*", "t-reach", "--robots", "two", "arm"),
        ("--problems", "t-rob*,t-reach", "--robots=two,arm"),
        ("--problems", "t-rob*", "--problems", "t-reach", "--robots", "two", "--robots", "arm"),
    ],
)
def test_lists_take_several_words(lists: tuple[str, ...]):
    result = suite(*lists, "--list", "--json")
    assert result.exit_code == 0
    assert json.loads(result.stdout) == {
        "pairs": [{"problem": "t-reach", "robot": "arm"}, {"problem": "t-robots", "robot": "two"}]
    }
    assert suite("--list", *lists).stdout == "t-reach   arm\nt-robots  two\n"


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("--problems", "t-raech"), "trajopt: problem 't-raech' is unknown; did you mean t-reach? "),
        (("--robots", "solo13"), "trajopt: robot 'solo13' is unknown; did you mean solo12? "),
        (("--problems",), "trajopt: Option '--problems' requires an argument"),
        (("t-reach",), "trajopt: Got unexpected extra argument (t-reach); see "),
        (("--resume",), "trajopt: --resume has no results to continue from; allowed: with --output-dir DIR"),
        (("--perturbed", "x"), "trajopt: Invalid value for '--perturbed': 'x' is not a whole number"),
        (("--sigma", "-1"), "trajopt: sigma is -1; allowed: > 0"),
        (("--solver", "snopt"), "trajopt: unknown solver 'snopt'; allowed: ipopt"),
        (("--compare", "no/such"), "trajopt: cannot read no/such: No such file or directory; allowed: "),
        (
            ("--scheduler", "nonsense"),
            "trajopt: no scheduler answers at 'nonsense': the form is wrong",
        ),
        (("--scheduler", "nonsense", "--jobs", "2"), "trajopt: --jobs has no effect here; allowed: "),
        (("--update", "no/such"), "trajopt: cannot write no/such: the folder no does not exist"),
    ],
)
def test_bad_input_is_one_line(arguments: tuple[str, ...], words: str):
    result = suite(*arguments)
    assert (result.exit_code, result.stdout) == (2, "")
    assert result.stderr.startswith(words)
    assert result.stderr.count("\n") == 1


@pytest.mark.long
def test_results_are_printed_written_resumed_and_compared(tmp_path: Path):
    run = ("--problems", "t-reach", "t-refused", "--perturbed", 2, "--output-dir", tmp_path / "out")
    bands = tmp_path / "bands.csv"
    first = suite(*run, "--json", "--update", bands)
    found = json.loads(first.stdout)
    assert first.exit_code == 1
    assert [(pair["problem"], pair["ok"], pair["mode"]) for pair in found["pairs"]] == [
        ("t-reach", True, ""),
        ("t-refused", False, "error"),
    ]
    assert found["summary"]["perturbed_failures"] == {"error": 2}
    assert (found["complete"], found["outside"]) == (True, None)
    assert first.stderr.count("\n") == 2  # one line a pair
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == ["results.jsonl", "t-reach@arm.npz"]
    assert set(data.read(bands)[0]) == {"t-reach@arm"}

    again = suite(*run, "--resume", "--compare", bands)
    assert again.exit_code == 1
    assert "t-reach@arm" not in again.stderr  # only what had ended with an error is run
    assert "outside its bands: t-refused@arm: error: bad input: the goal is on the moon" in again.stdout
    summary = "2 pairs (2 problems, 1 robots): 1 solved from their default guess"
    assert summary in again.stdout
    assert "perturbed starts: 2 of 4 solved (50.0%), worst pair 0%, error 2" in again.stdout

    good = suite("--problems", "t-reach", *run[3:], "--resume", "--compare", bands)
    assert good.exit_code == 0
    assert good.stderr == ""
    bands.write_text(bands.read_text().replace("refined", "fixed"))
    other = suite("--problems", "t-reach", *run[3:], "--resume", "--compare", bands)
    assert other.exit_code == 1
    assert "outside its bands: t-reach@arm: solved on a refined mesh with ipopt" in other.stdout


def test_results_stay_where_no_scheduler_answers(tmp_path: Path):
    results = tmp_path / "results.jsonl"
    results.write_text('{"kept": 1}\n')
    assert suite("--scheduler", "nonsense", "--output-dir", tmp_path).exit_code == 2
    assert results.read_text() == '{"kept": 1}\n'


def running(package: Path) -> Running:
    """``trajopt suite`` in a process of its own on a good pair and one that hangs."""
    arguments = ("bench", "suite", "--problems", "t-reach,t-hanging", "--json", "--jobs", "2")
    process = Running(*TRAJOPT, *arguments, env=environment(package))
    assert process.line().startswith("1/2 t-reach@arm: solved")
    assert task_processes(package)
    return process


@pytest.mark.long
@needs_proc
def test_ctrl_c_prints_what_is_done_and_leaves_no_process(package: Path):
    with running(package) as process:
        process.popen.send_signal(signal.SIGINT)
        status, output, errors = process.finish()
    found = json.loads(output)
    assert status == 130
    assert errors == "trajopt: cancelled, 1 of 2 pairs are done\n"
    assert found["complete"] is False
    assert [pair["problem"] for pair in found["pairs"]] == ["t-reach"]
    assert no_task_process_left(package)


@pytest.mark.long
@needs_proc
def test_no_process_outlives_a_suite_that_is_killed(package: Path):
    with running(package) as process:
        process.popen.kill()
        process.finish()
        assert no_task_process_left(package)
