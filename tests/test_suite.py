"""The suite: pairs, failure modes, lost processes, statistics, results on disk, bands."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import suite_problems
from problems_for_tests import reach

from trajopt import Solution, check, solve
from trajopt.catalogue import families
from trajopt.errors import InputError
from trajopt.solvers import Status
from trajopt.suite import data, failure
from trajopt.suite.cases import Case, all_cases, representatives, select
from trajopt.suite.outcome import Attempt, Checked, Grid, Outcome, distinct, quantile
from trajopt.suite.pool import run_all
from trajopt.suite.process import Limits
from trajopt.suite.records import Records, left
from trajopt.suite.run import measure, worst_figure
from trajopt.suite.settings import Settings
from trajopt.suite.versions import versions

VIRTUAL_MACHINE = Settings(compile="none")
STARTS = replace(VIRTUAL_MACHINE, perturbed=3)
# Seconds until a hanging build is killed: nothing else runs there.
BUILD = 2.0
# Objectives of one start, solved here and in another process: the same arithmetic.
SAME = 1e-12
# IPOPT's rows with two bounds meet slacks, which are a little inside their bounds.
SLACK = 1e-2


class Silent:
    """A display that shows nothing."""

    def event(self, slot: int, case: Case, event: dict[str, Any]) -> None:
        pass

    def finished(self, slot: int, outcome: Outcome) -> None:
        pass


@pytest.fixture(scope="module", autouse=True)
def problems(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """The tests' own families beside the library's."""
    folder = tmp_path_factory.mktemp("package")
    suite_problems.install(folder)
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(folder)
        yield


def case(problem: str, robot: str = "arm") -> Case:
    return Case(problem=problem, robot=robot, takes_robot=problem == "t-robots")


def run_pairs(names: list[str], settings: Settings, build: float = 120.0) -> dict[str, Outcome]:
    cases = [case(name) for name in names]
    limits = Limits(build=build)
    found = run_all(cases, settings, jobs=2, display=Silent(), limits=limits)
    return {outcome.problem: outcome for outcome in found}


# Pairs


def test_every_family_meets_every_robot_that_it_names():
    cases = all_cases(families())
    assert {one.name for one in cases if one.problem == "t-robots"} == {"t-robots@one", "t-robots@two"}
    assert len(cases) == sum(len(family.robots) for family in families().values())
    assert list(cases) == sorted(cases)


def test_patterns_and_robots_select():
    assert {one.name for one in select(families(), ["t-ro*", "t-reach"])} == {
        "t-robots@one", "t-robots@two", "t-reach@arm",
    }  # fmt: skip
    assert [one.name for one in select(families(), ["t-*"], ["two"])] == ["t-robots@two"]
    assert select(families(), ["solo12-jump"]) == (
        Case(problem="solo12-jump", robot="solo12", takes_robot=False),
    )


def test_a_robot_file_meets_the_families_that_take_a_robot(tmp_path: Path):
    file = tmp_path / "mine.py"
    file.write_text("")
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


def test_representatives_hold_every_problem_and_every_robot():
    cases = all_cases(families())
    chosen = representatives(cases)
    assert {one.problem for one in chosen} == {one.problem for one in cases}
    assert {one.robot for one in chosen} == {one.robot for one in cases}
    assert (
        len(chosen)
        == len(set(chosen))
        <= len({one.problem for one in cases}) + len({one.robot for one in cases})
    )
    assert representatives(cases[::-1]) == chosen


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
    assert failure.worst_condition(*figures, tolerance=1e-6, feasibility=1e-7) == mode


@pytest.mark.parametrize("status", Status)
def test_every_status_has_a_mode(status: Status):
    meta = {
        "status": status.word, "solver": "ipopt", "tolerance": 1e-6,
        "primal_infeasibility": 0.0, "dual_infeasibility": 1.0, "complementarity": 0.0,
    }  # fmt: skip
    mode = failure.mode_of(meta)
    assert (mode == failure.SOLVED) == (status is Status.SOLVED)
    assert mode in (failure.SOLVED, *failure.MODES)


@pytest.mark.parametrize(
    ("problem", "changes", "mode", "detail"),
    [
        ("t-reach", {}, "", ""),
        ("t-infeasible", {}, "primal", "infeasible: defect in phase 'reach'"),
        ("t-not-finite", {}, "NaN", "not_finite: "),
        ("t-coarse", {}, "check", "beyond tolerance: "),
        ("t-coarse", {"max_iterations": 1}, "primal", "iteration_limit: "),
        ("t-coarse", {"max_time": 1e-6}, "time", "time_limit: "),
        ("t-coarse", {"solver": "fatrop", "max_iterations": 1}, "primal", "iteration_limit: "),
    ],
)
def test_a_failed_solve_has_its_mode(problem: str, changes: dict[str, Any], mode: str, detail: str):
    outcome = measure(case(problem), replace(VIRTUAL_MACHINE, **changes))
    assert outcome.mode == mode
    assert outcome.detail.startswith(detail)
    assert outcome.ok == (mode == "")


@pytest.mark.parametrize("solver", ["ipopt", "fatrop"])
def test_the_primal_figure_is_the_largest_violation_of_a_row(solver: str):
    """The solver's own figure, against all rows evaluated anew at the iterate it left."""
    solution = solve(suite_problems.coarse(), solver=solver, max_iterations=3, compile="none")
    assert solution.meta["status"] == "iteration_limit"
    assert solution.meta["primal_infeasibility"] == pytest.approx(solution.meta["max_violation"], rel=SLACK)


def test_a_problem_that_cannot_be_built_is_an_error_here():
    with pytest.raises(InputError, match="moon"):
        measure(case("t-refused"), VIRTUAL_MACHINE)


# Processes


def test_a_lost_process_loses_no_other_pair():
    errors = {
        "t-refused": "bad input: the goal is on the moon; allowed: on earth",
        "t-broken": "crash: RuntimeError: first line second line",
        "t-segmentation-fault": "crash: SIGSEGV",
        "t-killed": "crash: SIGKILL (out of memory?)",
        "t-without-memory": "crash: out of memory",
    }
    found = run_pairs([*errors, "t-reach"], VIRTUAL_MACHINE)
    assert found.pop("t-reach").ok
    assert {name: (outcome.mode, outcome.detail) for name, outcome in found.items()} == {
        name: ("error", text) for name, text in errors.items()
    }


def test_a_process_that_hangs_is_killed():
    outcome = run_pairs(["t-hanging"], STARTS, BUILD)["t-hanging"]
    assert (outcome.mode, outcome.detail) == ("time", "build killed after 2 s")
    starts = outcome.perturbed()
    assert (starts.count, starts.solved, starts.median_iterations, starts.optima) == (3, 0, None, 0)


def test_a_lost_start_leaves_the_others():
    outcome = run_pairs(["t-losing-a-start"], STARTS)["t-losing-a-start"]
    assert outcome.ok
    assert [start.seed for start in outcome.starts] == [0, 1, 2]
    assert [start.mode for start in outcome.starts] == ["", "error", ""]
    assert outcome.starts[1].detail == "crash: SIGABRT"
    assert (outcome.perturbed().count, outcome.perturbed().solved) == (3, 2)


def test_a_pair_is_solved_as_the_library_solves_it(tmp_path: Path):
    """Own guess and starts against `trajopt.solve`; the file that is written is the solution's."""
    settings = replace(VIRTUAL_MACHINE, perturbed=2, sigma=0.2)
    (outcome,) = run_all([case("t-coarse")], settings, jobs=1, display=Silent(), folder=tmp_path)
    for start in (outcome.own, *outcome.starts):
        noise = {} if start.seed is None else {"seed": start.seed, "perturb": 0.2}
        solution = solve(suite_problems.coarse(), compile="none", **noise)
        assert start.iterations == solution.meta["iterations"]
        assert start.objective == pytest.approx(solution.meta["objective"], rel=SAME)
        assert start.solved == solution.success
    written = Solution.load(tmp_path / "t-coarse@arm.npz")
    assert written.meta["objective"] == pytest.approx(outcome.own.objective, rel=SAME)
    assert outcome.grid.legged
    assert (outcome.grid.scheme, outcome.grid.intervals) == ("semi-implicit-euler", written.n_intervals)
    assert outcome.check.ok == check(written).ok


# Figures


def test_the_worst_figure_is_beyond_where_the_check_fails():
    for problem in (reach(), suite_problems.coarse()):
        report = check(solve(problem, compile="none"))
        name, used = worst_figure(report)
        assert (used > 1) == (not report.ok)
        assert report.ok or name in report.failures()


def test_optima_are_told_apart_by_their_objectives():
    assert distinct([]) == 0
    assert distinct([1.0, 1.0 + 1e-6, 1.0005]) == 1
    assert distinct([2.0, 1.0, 1.002, 2.0001]) == 3
    assert distinct([0.0, 0.0]) == 1
    assert distinct([-1.0, -1.002, 1.0]) == 3


@pytest.mark.parametrize("part", [0.1, 0.5, 0.9, 1.0])
def test_quantiles_are_numpys(part: float):
    values = sorted(np.random.default_rng(0).integers(0, 100, 20).tolist())
    assert quantile(values, part) == np.quantile(values, part, method="inverted_cdf")
    assert quantile(values[:1], part) == values[0]


def outcome_of(**changes: Any) -> Outcome:
    own = Attempt(seed=None, mode="", status="solved", iterations=40, wall_time=1.5, objective=2.0)
    starts = tuple(replace(own, seed=seed, iterations=40 + 10 * seed) for seed in range(10))
    grid = Grid(
        scheme="legendre:2", intervals=30, variables=9, constraints=8, legged=True,
        build_time=0.1, compile_time=0.2,
    )  # fmt: skip
    checked = Checked(ok=True, figure="drift", used=0.25)
    values = {"problem": "jump", "robot": "dog", "grid": grid, "own": own, "check": checked, "starts": starts}
    return Outcome(**{**values, **changes})


@pytest.mark.parametrize(
    "changes", [{}, {"starts": ()}, {"own": None, "check": None, "grid": None, "error": "crash: SIGSEGV"}]
)
def test_an_outcome_survives_json(changes: dict[str, Any]):
    outcome = outcome_of(**changes)
    assert Outcome.from_dict(json.loads(json.dumps(outcome.to_dict()))) == outcome


# Results on disk


def test_a_resumed_suite_takes_over_what_is_done(tmp_path: Path):
    records = Records(tmp_path / "new", VIRTUAL_MACHINE, {"casadi": "3"})
    assert records.open(resume=True) == ()
    done, lost = outcome_of(), outcome_of(robot="cat", own=None, check=None, error="crash: SIGKILL")
    records.add(done)
    records.add(lost)
    with (tmp_path / "new" / "results.jsonl").open("a") as stream:
        stream.write('{"settings": {"perturbed"')  # the machine stopped here
    again = Records(tmp_path / "new", VIRTUAL_MACHINE, {"casadi": "3"})
    assert again.open(resume=True) == (done,)
    again.add(newer := replace(done, total_time=2.0))
    assert again.open(resume=True) == (newer,)
    cases = [case("jump", robot) for robot in ("cat", "dog")]
    assert left(cases, (done,)) == ((cases[0],), (done,))
    assert left(cases[:1], (done,)) == ((cases[0],), ())


def test_results_of_other_settings_or_versions_are_not_taken_over(tmp_path: Path):
    records = Records(tmp_path, VIRTUAL_MACHINE, {"casadi": "3"})
    records.open(resume=False)
    records.add(outcome_of())
    assert Records(tmp_path, STARTS, {"casadi": "3"}).open(resume=True) == ()
    assert Records(tmp_path, VIRTUAL_MACHINE, {"casadi": "4"}).open(resume=True) == ()
    assert Records(tmp_path, VIRTUAL_MACHINE, {"casadi": "3"}).open(resume=True) == (outcome_of(),)
    assert Records(tmp_path, VIRTUAL_MACHINE, {"casadi": "3"}).open(resume=False) == ()
    assert Records(tmp_path, VIRTUAL_MACHINE, {"casadi": "3"}).open(resume=True) == ()


def test_a_folder_that_cannot_be_written_is_one_line(tmp_path: Path):
    (tmp_path / "file").write_text("")
    with pytest.raises(
        InputError, match=r"cannot write .*results\.jsonl: File exists; allowed: a folder that can be written"
    ):
        Records(tmp_path / "file", VIRTUAL_MACHINE, {}).open(resume=False)


# Bands


def test_bands_hold_the_solve_and_the_middle_of_its_starts():
    entry = data.entry_of(outcome_of(), VIRTUAL_MACHINE)
    assert (entry.objective_low, entry.objective_high) == pytest.approx((1.998, 2.002))
    assert (entry.iterations_low, entry.iterations_high) == (20, 120)  # starts: 40, 50 ... 130
    alone = data.entry_of(outcome_of(starts=()), VIRTUAL_MACHINE)
    assert (alone.iterations_low, alone.iterations_high) == (20, 60)


def test_bands_survive_their_file(tmp_path: Path):
    outcomes = [outcome_of(), outcome_of(robot="a-long-name"), outcome_of(problem="a")]
    entries = data.updated({}, outcomes, VIRTUAL_MACHINE, [outcome.name for outcome in outcomes])
    data.write(tmp_path / "bands.csv", entries, versions())
    found, head = data.read(tmp_path / "bands.csv")
    assert found == entries
    assert list(found) == sorted(found)
    assert head == versions()
    assert data.deviations(outcomes, VIRTUAL_MACHINE, found) == {}


def test_what_is_outside_its_band_is_named():
    inside = outcome_of()
    entries = {inside.name: data.entry_of(inside, VIRTUAL_MACHINE)}

    def said(settings: Settings = VIRTUAL_MACHINE, **changes: Any) -> str:
        changed = replace(inside, own=replace(inside.own, **changes))
        return data.deviation(changed, settings, entries[inside.name])

    assert said() == ""
    assert said(objective=2.01) == "objective 2.01, band 1.998 to 2.002"
    assert said(iterations=121) == "121 iterations, band 20 to 120"
    assert said(mode="dual", detail="step_failed: x") == "dual: step_failed: x"
    assert "solved with legendre:2, 30 intervals, fatrop" in said(replace(VIRTUAL_MACHINE, solver="fatrop"))
    assert data.deviations([inside], VIRTUAL_MACHINE, {}) == {"jump@dog": "no line of data"}


def test_an_update_keeps_the_line_of_a_failed_pair_and_drops_one_that_is_gone():
    inside, gone = outcome_of(), outcome_of(robot="gone")
    entries = {one.name: data.entry_of(one, VIRTUAL_MACHINE) for one in (inside, gone)}
    failed = replace(inside, own=replace(inside.own, mode="primal", objective=7.0))
    assert data.updated(entries, [failed], VIRTUAL_MACHINE, [inside.name]) == {
        inside.name: entries[inside.name]
    }


@pytest.mark.parametrize("text", ["problem, robot\nx, y\n", "\x00\n1\n", "# casadi: 3\nproblem\nx\n"])
def test_a_foreign_table_is_one_line(text: str, tmp_path: Path):
    (tmp_path / "bands.csv").write_text(text)
    with pytest.raises(InputError, match=r"line 1 of the table in .*bands\.csv is not one; columns: problem"):
        data.read(tmp_path / "bands.csv")


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"perturbed": -1}, "perturbed is -1; allowed: 0 to"),
        ({"sigma": 0.0}, "sigma is 0; allowed: > 0"),
        ({"sigma": math.nan}, "sigma is nan; allowed: > 0"),
        ({"sigma": 1e3}, "perturb is 1000; allowed: 0 to"),
        ({"solver": "snopt"}, "unknown solver 'snopt'; allowed: ipopt, fatrop"),
        ({"max_time": 0.0}, "max_time is 0 s; allowed: > 0"),
        ({"compile": "slow"}, "unknown compile level 'slow'; allowed: none, quick, fast"),
    ],
)
def test_a_bad_setting_is_one_line(changes: dict[str, Any], words: str):
    with pytest.raises(InputError) as caught:
        Settings(**changes)
    assert str(caught.value).startswith(words)


def test_settings_survive_json():
    assert Settings.from_dict(json.loads(json.dumps(STARTS.to_dict()))) == STARTS
    assert asdict(STARTS) == STARTS.to_dict()
