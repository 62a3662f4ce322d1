"""``trajopt batch`` and ``suite``: output, exit status, Ctrl-C, processes left behind, a full disk."""

import json
import resource
import signal
from pathlib import Path
from typing import Any

import pytest
from click.testing import Result

from tests.support import batch_problems, suite_problems
from tests.support.batch_problems import HELD, runs
from tests.support.command_lines import assert_refused, invoke
from tests.support.packages import offered
from tests.support.processes import (
    TRAJOPT,
    Running,
    environment,
    needs_proc,
    no_task_process_left,
    run,
    task_processes,
    until,
)
from trajopt.study.batch.batch import dataset
from trajopt.study.suite import data

# Size of files on a disk that is "full": rows of the journal of a few cases fit in, a solution does not.
FULL = 4096
PNG = b"\x89PNG\r\n\x1a\n"
package = offered(batch_problems)


def batch(*arguments: object) -> Result:
    return invoke("batch", *arguments)


def fates(noted: Path, words: str, numbers: str) -> tuple[str, ...]:
    return ("t-fated", "--robots", f"{noted}", "--vary", f"fate={words}", "--vary", f"number={numbers}")


def rows(out: Path) -> dict[int, dict[str, Any]]:
    """Rows by case of a batch, also while it runs; none before it is begun."""
    return {row["case"]: row for row in dataset(out).index.to_pylist()} if out.exists() else {}


def test_cases_are_listed_without_solving(tmp_path: Path):
    arguments = ("t-swing", "--vary", "goal=10deg,0.5", "--set", "cost=torque", "--out", tmp_path / "out")
    result = batch(*arguments, "--list")
    assert result.exit_code == 0
    assert result.stdout == "0 t-swing cost=torque goal=0.174533\n1 t-swing cost=torque goal=0.5\n"
    assert result.stderr == "2 cases\n"
    found = json.loads(batch(*arguments, "--list", "--json").stdout)
    assert found["cases"][1] == {"problem": "t-swing", "parameters": {"cost": "torque", "goal": 0.5}}
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ((), "PROBLEM is missing; allowed: without it --resume --out DIR, or --status DIR"),
        (("--resume",), "PROBLEM is missing"),
        (("t-swnig",), "'t-swnig'"),
        (("t-swing", "--vary", "goal=0:1"), "--vary 'goal=0:1' has the wrong form"),
        (("t-swing", "--sample", "goal=uniform(0,1)"), "--count is 0 with 1 parameters to sample"),
        (("t-swing", "--count", "-1"), "--count"),
        (("t-swing", "--seed", "x"), "--seed"),
        (("t-swing", "--set", "goal"), "--set"),
        (("t-swing", "--set", "goal=far"), "goal='far' is not a number"),
        (("t-swing", "--robots", "go2"), "t-swing has no parameter 'robot'"),
        (("t-swing", "--solver", "snopt"), "snopt"),
        (("t-swing", "--max-time", "0"), "max_time is 0 s; allowed: > 0"),
        (("t-swing", "--max-time", "inf"), "max_time"),
        (("t-swing", "--jobs", "0"), "--jobs"),
        (("t-swing", "--jobs", "1", "--scheduler", "tcp://x:1"), "--jobs has no effect here"),
        (("--status", "no/such"), "no/such holds no batch"),
        (("t-swing", "--status", "no/such"), "--status is given with problem t-swing"),
        (("--resume", "--out", "no/such"), "no/such holds no batch"),
        (("--resume", "--out", "no/such", "--max-time", "3"), "--max-time has no effect here"),
        (("--resume", "--out", "no/such", "--set", "a=1"), "--set has no effect here"),
        (("t-swing", "--resume", "--out", "no/such"), "no/such holds no batch"),
    ],
)
def test_bad_input_is_one_line(arguments: tuple[str, ...], words: str):
    assert_refused(batch(*arguments), words)
    assert not Path("no").exists()
    assert not Path("t-swing-batch").exists()


@pytest.mark.long
def test_a_batch_is_printed_written_and_resumed(noted: Path, tmp_path: Path):
    out = tmp_path / "out"
    run_it = (*fates(noted, "solved,refused,killed-once", "1:3:3"), "--jobs", "2", "--out", out)
    first = batch(*run_it, "--json")
    assert first.exit_code == 1
    found = json.loads(first.stdout)
    assert {name: found[name] for name in ("folder", "cases", "done", "outcomes")} == {
        "folder": f"{out}", "cases": 9, "done": 9, "outcomes": {"solved": 6, "refused": 3},
    }  # fmt: skip
    parts = {(one["parameter"], one["region"]): (one["solved"], one["cases"]) for one in found["regions"]}
    assert parts == {
        ("fate", "killed-once"): (3, 3), ("fate", "refused"): (0, 3), ("fate", "solved"): (3, 3),
        ("number", "1"): (2, 3), ("number", "2"): (2, 3), ("number", "3"): (2, 3),
    }  # fmt: skip
    assert found["plot"] == f"{out / 'failures.png'}"
    assert (out / "failures.png").read_bytes().startswith(PNG)
    named = [line for line in first.stderr.splitlines() if line.startswith("case ")]
    assert len(named) == 3
    assert all(line.endswith("NOT solved, the goal is on the moon; allowed: on earth") for line in named)
    assert "9/9 cases, 6 solved" in first.stderr
    assert sorted(path.name for path in out.iterdir()) == [
        "batch.json", "failures.png", "index.parquet", "journal.jsonl", "solutions",
    ]  # fmt: skip

    counts = runs(noted)
    again = batch("--resume", "--out", out)
    assert (again.exit_code, again.stderr, runs(noted)) == (1, "", counts)
    assert again.stdout.startswith("9 of 9 cases done: 6 solved, 3 refused\n")
    assert "3 of 3" in again.stdout
    shown = batch("--status", out)
    assert (shown.exit_code, shown.stderr) == (0, "")
    assert shown.stdout.startswith("9 of 9 cases done: 6 solved, 3 refused\n")
    assert_refused(batch(*run_it), f"{out} is there and not empty; allowed: --resume, or another folder")
    assert_refused(batch(*run_it, "--max-time", "5", "--resume"), "holds a batch with other settings")
    assert_refused(batch(*fates(noted, "solved", "1"), "--out", out, "--resume"), "other cases")

    good = batch(*fates(noted, "solved", "1"), "--jobs", "1", "--out", tmp_path / "good")
    assert (good.exit_code, good.stderr) == (0, "1/1 cases, 1 solved\n")
    assert not (tmp_path / "good" / "failures.png").exists()  # nothing varies


def held(package: Path, noted: Path, out: Path) -> Running:
    """A batch in a process of its own, when all cases but the two that are held are done."""
    (noted / HELD).touch()
    arguments = (*fates(noted, "solved,hold", "1,2"), "--start", "default", "--jobs", "2", "--out", out)
    process = Running(*TRAJOPT, "batch", *arguments, "--json", env=environment(package))
    assert until(lambda: process.popen.poll() is not None or {"hold-1", "hold-2"} <= set(runs(noted)))
    assert task_processes(package)
    return process


def assert_rest_is_run(noted: Path, out: Path, kept: dict[int, dict[str, Any]]) -> None:
    """What was done is kept and not run again; the rest is."""
    (noted / HELD).unlink()
    assert {row["fate"] for row in kept.values()} == {"solved"}
    shown = json.loads(batch("--status", out, "--json").stdout)
    assert (shown["cases"], shown["done"], shown["outcomes"]) == (4, 2, {"solved": 2})
    assert shown["plot"] is None
    again = batch("--resume", "--jobs", "2", "--out", out)
    assert again.exit_code == 0, again.stderr
    assert again.stdout.startswith("4 of 4 cases done: 4 solved\n")
    assert runs(noted) == {"solved-1": 1, "solved-2": 1, "hold-1": 2, "hold-2": 2}
    assert {index: rows(out)[index] for index in kept} == kept


@pytest.mark.long
@needs_proc
def test_ctrl_c_keeps_what_is_done_and_leaves_no_process(package: Path, noted: Path, tmp_path: Path):
    out = tmp_path / "out"
    with held(package, noted, out) as process:
        assert until(lambda: len(rows(out)) == 2)
        assert_refused(batch("--resume", "--out", out), f"a batch runs in {out}; allowed: another folder")
        process.popen.send_signal(signal.SIGINT)
        status, output, errors = process.finish()
    assert status == 130
    assert json.loads(output)["done"] == 2
    assert errors.endswith(f"trajopt: cancelled; go on with --resume --out {out}\n")
    assert "Traceback" not in errors
    assert no_task_process_left(package)
    assert_rest_is_run(noted, out, rows(out))


@pytest.mark.long
@needs_proc
def test_a_client_that_is_killed_loses_no_row(package: Path, noted: Path, tmp_path: Path):
    out = tmp_path / "out"
    with held(package, noted, out) as process:
        assert until(lambda: len(rows(out)) == 2)
        process.popen.kill()
        process.finish()
        assert no_task_process_left(package)
    assert not (out / "index.parquet").exists()  # the journal alone has them
    assert_rest_is_run(noted, out, rows(out))


@pytest.mark.long
def test_before_anything_is_done_the_status_says_so(package: Path, noted: Path, tmp_path: Path):
    out = tmp_path / "out"
    (noted / HELD).touch()
    arguments = (*fates(noted, "hold", "1,2"), "--jobs", "1", "--out", out)
    with Running(*TRAJOPT, "batch", *arguments, env=environment(package)) as process:
        assert until(lambda: process.popen.poll() is not None or runs(noted))
        shown = batch("--status", out)
        assert (shown.exit_code, shown.stderr) == (0, "")
        assert shown.stdout.startswith("0 of 2 cases done: none\n")
        process.popen.send_signal(signal.SIGINT)
        status, output, errors = process.finish()
    assert (status, errors) == (130, f"trajopt: cancelled; go on with --resume --out {out}\n")
    assert output.startswith("0 of 2 cases done: none\n")


def small_files() -> None:
    """In a new process: a file that would become larger cannot be written, as on a full disk."""
    resource.setrlimit(resource.RLIMIT_FSIZE, (FULL, FULL))


@pytest.mark.long
def test_on_a_full_disk_rows_are_kept_and_solutions_are_solved_again(
    package: Path, noted: Path, tmp_path: Path
):
    out = tmp_path / "out"
    arguments = (*fates(noted, "solved", "1,2,3"), "--jobs", "1", "--out", out)
    full = run(*TRAJOPT, "batch", *arguments, env=environment(package), preexec_fn=small_files)
    assert full.returncode == 2, full.stderr  # not even the index can be written
    lines = full.stderr.splitlines()
    assert "Traceback" not in full.stderr
    assert lines[-1].startswith(f"trajopt: cannot write {out / 'index.parquet'}: ")
    assert lines[-1].endswith(
        f"File too large; all rows are kept in {out / 'journal.jsonl'}; free space, then --resume"
    )
    assert [row["status"] for row in rows(out).values()] == ["not_saved"] * 3
    assert not list(out.rglob("*.npz"))
    again = batch("--resume", "--out", out, "--jobs", "1")
    assert again.exit_code == 0, again.stderr
    assert [row["status"] for row in rows(out).values()] == ["solved"] * 3
    assert len(list(out.rglob("*.npz"))) == 3


suite_package = offered(suite_problems)


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
def test_bad_input_of_suite_is_one_line(arguments: tuple[str, ...], words: str):
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


def running(suite_package: Path) -> Running:
    """``trajopt suite`` in a process of its own on a good pair and one that hangs."""
    arguments = ("bench", "suite", "--problems", "t-reach,t-hanging", "--json", "--jobs", "2")
    process = Running(*TRAJOPT, *arguments, env=environment(suite_package))
    assert process.line().startswith("1/2 t-reach@arm: solved")
    assert task_processes(suite_package)
    return process


@pytest.mark.long
@needs_proc
def test_ctrl_c_prints_what_is_done_and_leaves_no_process(suite_package: Path):
    with running(suite_package) as process:
        process.popen.send_signal(signal.SIGINT)
        status, output, errors = process.finish()
    found = json.loads(output)
    assert status == 130
    assert errors == "trajopt: cancelled, 1 of 2 pairs are done\n"
    assert found["complete"] is False
    assert [pair["problem"] for pair in found["pairs"]] == ["t-reach"]
    assert no_task_process_left(suite_package)


@pytest.mark.long
@needs_proc
def test_no_process_outlives_a_suite_that_is_killed(suite_package: Path):
    with running(suite_package) as process:
        process.popen.kill()
        process.finish()
        assert no_task_process_left(suite_package)
