"""Sweeps that solve: what is measured, lost processes, resuming, the command line."""

import csv
import json
import signal
from pathlib import Path

import numpy as np
import pytest
from click.testing import Result

from tests.support import sweep_problems
from tests.support.command_lines import invoke
from tests.support.packages import offered
from tests.support.problems import hop
from tests.support.processes import (
    TRAJOPT,
    Running,
    environment,
    needs_proc,
    no_task_process_left,
    task_processes,
)
from trajopt import InputError, Problem, Solution, solve
from trajopt.certify.accuracy import measure
from trajopt.reduced import base_rows_problem
from trajopt.study.display import TaskDisplay
from trajopt.study.processes import LOST, REFUSED
from trajopt.study.sweep.engine import Sweep, cores_for, physical_cores
from trajopt.study.sweep.plan import make_plan
from trajopt.study.sweep.records import Job, SweepRecords, SweepRequest
from trajopt.study.sweep.run import objective_of, run_setting, with_torques
from trajopt.study.sweep.setting import Setting

pytestmark = pytest.mark.long

# The same arithmetic, called in another way.
SAME = 1e-12
# From all starts the reach is the same to the solver's tolerance, of errors of 1e-4 m.
CONVERGED = 1e-2
# s until a hanging run is killed: the runs here take a tenth of one.
SHORT = 3.0
# A rate of change of the objective along the motion that a resampled solution leaves: rounding.
RESAMPLED = 1e-9
REQUEST = SweepRequest(problem="s-reach", max_iterations=200)
package = offered(sweep_problems)


def sweep(*arguments: object) -> Result:
    return invoke("bench", "sweep", *arguments)


def rows(path: Path) -> list[dict[str, str]]:
    with path.open(encoding="utf-8") as stream:
        return list(csv.DictReader(stream))


def weighed() -> Problem:
    return sweep_problems.weighed(gravity=1.0)


QUICK = ("--repeats", 1)


# Runs


def test_a_run_is_what_the_library_solves(tmp_path: Path):
    setting = Setting(transcription="legendre:2", intervals=6)
    for start in (0, 3):
        job = Job(setting=setting.name, start=start)
        found = run_setting(weighed(), setting, job, REQUEST, tmp_path / "run.npz")
        noise = {"seed": start, "perturb": REQUEST.sigma} if start else {}
        known = solve(weighed(), intervals=6, **noise)
        assert (found.iterations, found.variables) == (
            known.statistics.iterations,
            known.statistics.variables,
        )
        assert found.objective == pytest.approx(known.statistics.objective, rel=SAME)
        np.testing.assert_array_equal(Solution.load(tmp_path / "run.npz").q, known.q)
        assert found.time == found.wall_time
        assert 0 < found.cpu_share <= 1


def test_a_warm_start_costs_what_made_it(tmp_path: Path):
    setting = Setting(transcription="legendre:2", intervals=8, start="warm")
    found = run_setting(weighed(), setting, Job(setting=setting.name, start=0), REQUEST, tmp_path / "run.npz")
    coarse = solve(weighed(), intervals=4)
    fine = solve(weighed(), intervals=8, start=coarse)
    assert found.iterations == coarse.statistics.iterations + fine.statistics.iterations
    assert found.start_time > 0
    assert found.time == found.wall_time + found.start_time
    assert Solution.load(tmp_path / "run.npz").n_intervals == 8


def test_two_stages_are_judged_by_the_whole_problem(tmp_path: Path):
    """Objective of the full problem, computed by another way: torques as unknowns of no NLP."""
    setting = Setting(transcription="legendre:2", intervals=8, model="two-stage")
    found = run_setting(hop(), setting, Job(setting=setting.name, start=0), REQUEST, tmp_path / "run.npz")
    assert found.success
    assert found.stage_two_time > 0
    full = solve(hop(), intervals=8)
    assert found.objective >= full.statistics.objective
    assert objective_of(hop(), setting, full) == pytest.approx(full.statistics.objective, rel=RESAMPLED)
    first = solve(base_rows_problem(hop()), intervals=8)
    assert found.objective != pytest.approx(first.statistics.objective)
    np.testing.assert_allclose(with_torques(hop(), first).tau, Solution.load(tmp_path / "run.npz").tau)


# Processes


def test_a_lost_run_loses_no_other(tmp_path: Path):
    """Settings are lost on their grids from every start, and given up after two lost runs or a refusal."""
    grids = {"intervals": [3, 4, 7, 11, 13]}
    plan = make_plan(sweep_problems.losing(), grids)
    asked = SweepRequest(
        problem="s-losing", values={}, repeats=2, max_time=1.0, build_time=SHORT, reference_time=0.0
    )
    records = SweepRecords(tmp_path, asked.head(plan, {}), resume=False)
    Sweep(asked, plan, records, cores_for(1), TaskDisplay("sweep")).run()
    first = [one for one in records.results.runs.values() if one.attempt == 0]
    found = {
        setting.intervals: [(one.status, one.detail) for one in first if one.setting == setting.name]
        for setting in plan.settings
    }
    assert found == {
        3: [(LOST, "crash: SIGSEGV")] * 2,
        4: [("solved", "")] * 3,
        7: [(REFUSED, "a seventh of the way is not allowed; allowed: the rest")],
        10: [("solved", "")] * 3,
        11: [(LOST, "crash: RuntimeError: first line second line")] * 2,
        13: [(LOST, f"killed after {SHORT + 1:g} s")] * 2,
    }


def test_timed_processes_get_cores_of_their_own():
    cores = physical_cores()
    assert cores_for(1) == cores[-1:]
    for jobs in (0, max(2, len(cores))):
        with pytest.raises(InputError, match=f"jobs is {jobs}; allowed: 1 to "):
            cores_for(jobs)


# The command


def test_a_sweep_is_written_printed_and_resumed(tmp_path: Path):
    out = tmp_path / "out"
    asked = ("s-reach", "--set", "gravity=1", "--intervals", "4,8", *QUICK, "--output-dir", out)
    result = sweep(*asked)
    assert result.exit_code == 0, result.stderr
    assert "3 settings, 2 starts each: 6 runs" in result.stderr
    assert "legendre:2@10 (base)" in result.stdout
    assert (out / "front.png").stat().st_size > 10_000
    settings = {row["label"]: row for row in rows(out / "settings.csv")}
    assert set(settings) == {"legendre:2@10", "legendre:2@4", "legendre:2@8"}
    runs = [row for row in rows(out / "runs.csv") if row["attempt"] == "0"]
    assert len(runs) == 6
    for label, row in settings.items():
        intervals = int(label.partition("@")[2])
        assert (row["runs"], row["solved"], row["success_rate"]) == ("2", "2", "1")
        file = next((out / "solutions").glob(f"legendre-2-{intervals}-*.npz"))
        known = measure(file, out / "reference.npz")
        assert float(row["open_loop_m"]) == pytest.approx(known.open_loop, rel=CONVERGED)
        assert float(row["distance_m"]) == pytest.approx(known.distance, rel=CONVERGED)
        assert row["variables"] == str(Solution.load(file).statistics.variables)
    assert float(settings["legendre:2@8"]["error_m"]) < float(settings["legendre:2@4"]["error_m"])

    before = (out / "runs.csv").read_text()
    again = sweep(*asked, "--resume", "--json")
    assert again.exit_code == 0
    found = json.loads(again.stdout)
    assert found["complete"]
    assert [row["label"] for row in found["settings"]] == list(settings)
    assert (out / "runs.csv").read_text() == before  # nothing was run again
    other = sweep(*asked[:-1], out, "--resume", "--tolerance", "1e-4")
    assert (other.exit_code, other.stdout) == (2, "")
    assert other.stderr.startswith(f"trajopt: {out} holds a sweep with another plan; allowed: ")
    assert other.stderr.count("\n") == 1


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("s-raech",), "trajopt: problem 's-raech' is unknown; did you mean s-reach? "),
        (("s-reach", "--set", "gravity=9"), "trajopt: parameter gravity is 9; allowed: 0 to 1"),
        (("s-reach", "--solver", "snopt"), "trajopt: unknown solver 'snopt'; allowed: ipopt"),
        (
            ("s-reach", "--intervals", "5,x"),
            "trajopt: Invalid value for '--intervals': '5,x' is not a list of whole",
        ),
        (
            ("s-reach", "--solver", "ipopt,"),
            "trajopt: Invalid value for '--solver': 'ipopt,' has an empty entry",
        ),
        (("s-reach", "--also", "ipotp"), "trajopt: 'ipotp' is no word of a setting"),
        (("s-reach", "--jobs", "1000"), "trajopt: jobs is 1000; allowed: 1 to "),
        (("s-reach", "--perturb", "-1"), "trajopt: perturb is -1; allowed: "),
        (("s-reach", "--max-time", "nan"), "trajopt: max_time is nan s; allowed: > 0"),
        (("s-reach", "--reference", "-1"), "trajopt: reference is -1 s; allowed: "),
        (("s-reach", "--cone", "smooth"), "trajopt: problem 's-reach' has no friction term"),
    ],
)
def test_bad_input_is_one_line(arguments: tuple[str, ...], words: str, tmp_path: Path):
    result = sweep(*arguments, "--output-dir", tmp_path / "out")
    assert (result.exit_code, result.stdout) == (2, "")
    assert result.stderr.startswith(words)
    assert result.stderr.count("\n") == 1
    assert not (tmp_path / "out").exists()


def test_a_plan_can_be_listed():
    result = sweep("s-reach", "--hessian", "exact,gauss-newton", "--list")
    assert result.stdout == "legendre:2@10 (base)\nlegendre:2@10 gauss-newton\n"
    assert result.stderr.endswith("2 settings, 6 runs\n")


def test_an_unsolved_default_has_exit_status_one(tmp_path: Path):
    arguments = ("--intervals", "11", "--tolerance", "1e-4,1e-6", *QUICK, "--reference", "0")
    result = sweep("s-losing", *arguments, "--output-dir", tmp_path)
    assert result.exit_code == 1
    assert "lost: crash: RuntimeError" in result.stdout
    assert not (tmp_path / "front.png").exists()


def swept(folder: Path) -> tuple[str, ...]:
    """Arguments of a sweep of many settings into a folder."""
    measured = ("--repeats", "1", "--reference", "0", "--output-dir", str(folder))
    return ("s-reach", *measured, "--intervals", "4,5,6,7,8,9")


def running(package: Path, folder: Path) -> Running:
    """That sweep in a process of its own, some of whose runs have ended."""
    process = Running(*TRAJOPT, "bench", "sweep", *swept(folder), env=environment(package))
    while "solved" not in process.line():
        assert process.popen.poll() is None
    return process


@needs_proc
def test_ctrl_c_keeps_what_is_there_and_leaves_no_process(package: Path, tmp_path: Path):
    with running(package, tmp_path) as process:
        assert task_processes(package)
        process.popen.send_signal(signal.SIGINT)
        status, _, errors = process.finish()
    assert status == 130
    assert errors.endswith(f"trajopt: cancelled; continue with --resume --output-dir {tmp_path}\n")
    assert no_task_process_left(package)
    done = rows(tmp_path / "runs.csv")
    assert 0 < len(done) < 14
    result = sweep(*swept(tmp_path), "--resume")
    assert result.exit_code == 0
    runs = rows(tmp_path / "runs.csv")
    assert runs[: len(done)] == done
    assert len([row for row in runs if row["attempt"] == "0"]) == 14


@needs_proc
def test_no_process_outlives_a_sweep_that_is_killed(package: Path, tmp_path: Path):
    with running(package, tmp_path) as process:
        process.popen.kill()
        process.finish()
        assert no_task_process_left(package)
