"""The suite: pairs, failure modes, lost processes, statistics, results on disk, bands."""

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from tests.support import suite_problems
from tests.support.packages import offered
from trajopt import InputError, Solution, check, solve
from trajopt.motion.grid import mesh_of
from trajopt.motion.statistics import SolveStatistics
from trajopt.problem import families
from trajopt.solvers.status import Status
from trajopt.study import solves
from trajopt.study.suite.cases import Case, all_cases, select
from trajopt.study.suite.engine import SuiteRecords, run_suite
from trajopt.study.suite.outcome import Outcome
from trajopt.study.suite.run import SuiteSettings, measure_case
from trajopt.study.tasks import open_workers

pytestmark = pytest.mark.long

PLAIN = SuiteSettings()
STARTS = replace(PLAIN, perturbed=3)
# Objectives of one start, solved here and in another process: the same arithmetic.
SAME = 1e-12
# IPOPT's rows with two bounds meet slacks, which are a little inside their bounds.
SLACK = 1e-2
problems = offered(suite_problems)


def case(problem: str, robot: str = "arm") -> Case:
    return Case(problem=problem, robot=robot, takes_robot=problem == "t-robots")


def run_pairs(names: list[str], settings: SuiteSettings, folder: Path | None = None) -> dict[str, Outcome]:
    records = SuiteRecords(folder, settings, {})
    with open_workers(jobs=2) as workers:
        outcomes = run_suite([case(name) for name in names], settings, records, workers)
        return {outcome.problem: outcome for outcome in outcomes}


# Pairs


def test_every_family_meets_every_robot_that_it_names():
    cases = all_cases(families())
    assert {one.name for one in cases if one.problem == "t-robots"} == {"t-robots@one", "t-robots@two"}
    assert len(cases) == sum(len(on) for family in families().values() for _, on in family.tested)
    assert list(cases) == sorted(cases)


def test_patterns_and_robots_select():
    assert {one.name for one in select(families(), ["t-ro*", "t-reach"])} == {
        "t-robots@one", "t-robots@two", "t-reach@arm",
    }  # fmt: skip
    assert [one.name for one in select(families(), ["t-*"], ["two"])] == ["t-robots@two"]
    assert select(families(), ["solo12-jump"]) == (
        Case(problem="solo12-jump", robot="solo12", takes_robot=False),
    )


def test_a_family_is_also_run_with_settings_of_its_variants():
    named = select(families(), ["arm-reach*"], ["panda"])
    assert [one.name for one in named] == ["arm-reach@panda", "arm-reach:actuation=jerk@panda"]
    assert [one.values for one in named] == [{"robot": "panda"}, {"robot": "panda", "actuation": "jerk"}]
    assert {one.family for one in named} == {"arm-reach"}
    assert [one.name for one in select(families(), ["arm-reach"], ["panda"])] == ["arm-reach@panda"]
    reach = families()["arm-reach"]
    for setting, words in (("actuation=fast", "actuation"), ("speed=1", "no parameter 'speed'")):
        with pytest.raises(InputError, match=words):
            replace(reach, parameters=reach.parameters[1:], variants={setting: ("panda",)})


def test_a_robot_file_meets_the_families_that_take_a_robot(tmp_path: Path):
    file = tmp_path / "mine.py"
    file.write_text("KIND = 'arm'\ndef build(): ...\n")
    (found,) = select(families(), ["t-*"], [str(file)])
    assert (found.problem, found.values) == ("t-robots", {"robot": str(file)})


@pytest.mark.parametrize(
    ("patterns", "robots", "words"),
    [
        (["t-raech"], [], "problem 't-raech' is unknown; did you mean t-reach? "),
        (["nothing-*"], [], "problem 'nothing-*' is unknown; allowed: "),
        ([], ["solo13"], "robot 'solo13' is unknown; did you mean solo12? "),
        ([], ["nowhere/mine.py"], "there is no robot file nowhere/mine.py; allowed: "),
        (["t-reach"], ["two"], "no problem of t-reach is run on two; allowed: "),
    ],
)
def test_an_unknown_pair_is_one_line(patterns: list[str], robots: list[str], words: str):
    with pytest.raises(InputError) as caught:
        select(families(), patterns, robots)
    assert str(caught.value).startswith(words)


# Failure modes


@pytest.mark.parametrize(
    ("figures", "mode"),
    [
        ((1e-2, 1e3, 1e3), "primal"),  # far off the rows: the others say nothing
        ((1e-5, 1e-3, 0.0), "dual"),
        ((1e-5, 1e-6, 0.0), "primal"),  # a hundred times its tolerance of 1e-7
        ((0.0, 1e-6, 1e-4), "complementarity"),
        ((0.0, None, 0.0), "NaN"),
        ((0.0, 0.0, math.inf), "NaN"),
    ],
)
def test_the_condition_missed_most_names_the_failure(figures: tuple[float | None, ...], mode: str):
    assert solves.worst_condition(*figures, tolerance=1e-6, feasibility=1e-7) == mode


@pytest.mark.parametrize("status", Status)
def test_every_status_has_a_mode(status: Status):
    statistics = SolveStatistics(
        status=status.word, solver="ipopt", tolerance=1e-6, transcription="legendre:2", iterations=1,
        success=False, converged=False, objective=0.0, wall_time_s=0.0,
        primal_infeasibility=0.0, dual_infeasibility=1.0, complementarity=0.0,
    )  # fmt: skip
    mode = solves.mode_of(statistics)
    assert (mode == solves.SOLVED) == (status is Status.SOLVED)
    assert mode in (solves.SOLVED, *solves.MODES)


@pytest.mark.parametrize(
    ("problem", "changes", "mode", "detail"),
    [
        ("t-reach", {}, "", ""),
        ("t-infeasible", {}, "primal", "infeasible: defect in phase 'reach'"),
        ("t-not-finite", {}, "NaN", "not_finite: "),
        ("t-coarse", {"fixed_mesh": True}, "check", "coarse_grid: the rows hold at the points, but "),
        ("t-coarse", {"max_iterations": 1}, "primal", "iteration_limit: "),
        ("t-coarse", {"max_time": 1e-6}, "time", "time_limit: "),
    ],
)
def test_a_failed_solve_has_its_mode(problem: str, changes: dict[str, Any], mode: str, detail: str):
    outcome = measure_case(case(problem), replace(PLAIN, **changes))
    assert outcome.mode == mode
    assert outcome.detail.startswith(detail)
    assert outcome.ok == (mode == "")


def test_the_primal_figure_is_the_largest_violation_of_a_row():
    """The solver's own figure, against all rows evaluated anew at the iterate it left."""
    solution = solve(suite_problems.coarse(), max_iterations=3, fixed_mesh=True)
    assert solution.statistics.status == "iteration_limit"
    assert solution.statistics.primal_infeasibility == pytest.approx(
        solution.statistics.max_violation, rel=SLACK
    )


def test_a_problem_that_cannot_be_built_is_an_error_here():
    with pytest.raises(InputError, match="moon"):
        measure_case(case("t-refused"), PLAIN)


# Processes


def test_a_lost_process_loses_no_other_pair():
    errors = {
        "t-refused": "bad input: the goal is on the moon; allowed: on earth",
        "t-broken": "bad input: problem 't-broken' cannot be built: "
        "suite_problems.py, line 53: RuntimeError: first line",
        "t-segmentation-fault": "crash: SIGSEGV",
        "t-killed": "crash: SIGKILL (out of memory?)",
        "t-without-memory": "crash: out of memory",
    }
    found = run_pairs([*errors, "t-reach"], PLAIN)
    assert found.pop("t-reach").ok
    folder = f"{Path(suite_problems.__file__).parent}/"
    assert {name: (outcome.mode, outcome.detail.replace(folder, "")) for name, outcome in found.items()} == {
        name: ("error", text) for name, text in errors.items()
    }


class ShortSettings(SuiteSettings):
    """Settings whose tasks are ended early."""

    longest = 2.0


def test_a_process_that_hangs_is_killed():
    outcome = run_pairs(["t-hanging"], ShortSettings(perturbed=3))["t-hanging"]
    assert (outcome.mode, outcome.detail) == ("time", "killed after 2 s")
    starts = outcome.perturbed()
    assert (starts.count, starts.solved, starts.median_iterations, starts.optima) == (3, 0, None, 0)


def test_a_lost_start_leaves_the_others():
    outcome = run_pairs(["t-losing-a-start"], STARTS)["t-losing-a-start"]
    assert outcome.ok
    assert [start.seed for start in outcome.starts] == [0, 1, 2]
    assert [start.mode for start in outcome.starts] == ["", "error", ""]
    assert outcome.starts[1].detail == "crash: SIGABRT"
    assert (outcome.perturbed().count, outcome.perturbed().solved) == (3, 2)


@pytest.mark.parametrize("fixed_mesh", [True, False])
def test_a_pair_is_solved_as_the_library_solves_it(fixed_mesh: bool, tmp_path: Path):
    """Own guess and starts against `trajopt.solve`; the file that is written is the solution's."""
    settings = replace(PLAIN, perturbed=2, sigma=0.2, fixed_mesh=fixed_mesh)
    outcome = run_pairs(["t-coarse"], settings, folder=tmp_path)["t-coarse"]
    for start in (outcome.own, *outcome.starts):
        noise = {} if start.seed is None else {"seed": start.seed, "perturb": 0.2}
        solution = solve(suite_problems.coarse(), **noise, fixed_mesh=fixed_mesh)
        assert start.iterations == sum(one.iterations for one in solution.statistics.graded.rounds)
        assert start.objective == pytest.approx(solution.statistics.objective, rel=SAME)
        assert start.solved == solution.success
    written = Solution.load(tmp_path / "t-coarse@arm.npz")
    assert written.statistics.objective == pytest.approx(outcome.own.objective, rel=SAME)
    assert outcome.own.legged
    mesh = mesh_of(written)
    assert (outcome.own.scheme, outcome.own.intervals) == (mesh.transcription, sum(mesh.counts))
    assert outcome.ok == check(written).ok
