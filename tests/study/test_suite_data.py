"""What a suite makes of its outcomes: figures, results on disk, bands, statistics over starts."""

import json
import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

from tests.support import suite_problems
from tests.support.packages import offered
from tests.support.problems import hop, hopper, planar_hopper, reach
from tests.support.refusals import refused
from tests.support.suite_outcomes import outcome_of
from trajopt import InputError, solve
from trajopt.solvers.drivers import SOLVERS
from trajopt.study.records import versions
from trajopt.study.solves import CHECK
from trajopt.study.suite import data
from trajopt.study.suite.cases import Case
from trajopt.study.suite.engine import SuiteRecords, run_suite
from trajopt.study.suite.optima import SAME_MOTION, counted, described, distances, embedded
from trajopt.study.suite.outcome import Outcome, quantile
from trajopt.study.suite.run import SuiteSettings, attempt
from trajopt.study.tasks import open_workers

VIRTUAL_MACHINE = SuiteSettings()
STARTS = replace(VIRTUAL_MACHINE, perturbed=3)


# Figures


def test_the_worst_figure_is_beyond_where_the_check_fails():
    for problem in (reach(), suite_problems.coarse()):
        own = attempt(solve(problem, fixed_mesh=True), None, legged=False)
        assert own.figure
        assert (own.used > 1) == (own.mode == CHECK)
        assert own.solved == (own.mode == "")


@pytest.mark.parametrize("part", [0.1, 0.5, 0.9, 1.0])
def test_quantiles_are_numpys(part: float):
    values = sorted(np.random.default_rng(0).integers(0, 100, 20).tolist())
    assert quantile(values, part) == np.quantile(values, part, method="inverted_cdf")
    assert quantile(values[:1], part) == values[0]


@pytest.mark.parametrize("changes", [{}, {"starts": ()}, {"own": None, "error": "crash: SIGSEGV"}])
def test_an_outcome_survives_json(changes: dict[str, Any]):
    outcome = outcome_of(**changes)
    assert Outcome.from_dict(json.loads(json.dumps(outcome.to_dict()))) == outcome


# Results on disk


def test_a_resumed_suite_takes_over_what_is_done(tmp_path: Path):
    records = SuiteRecords(tmp_path / "new", VIRTUAL_MACHINE, {"casadi": "3"})
    assert records.open(resume=True) == {}
    done, lost = outcome_of(), outcome_of(robot="cat", own=None, error="crash: SIGKILL")
    records.add(done)
    records.add(lost)
    with (tmp_path / "new" / "results.jsonl").open("a") as stream:
        stream.write('{"settings": {"perturbed"')  # the machine stopped here
    again = SuiteRecords(tmp_path / "new", VIRTUAL_MACHINE, {"casadi": "3"})
    assert again.open(resume=True) == {done.name: done}
    again.add(newer := replace(done, total_time=2.0))
    assert again.open(resume=True) == {done.name: newer}


def test_results_of_other_settings_or_versions_are_not_taken_over(tmp_path: Path):
    records = SuiteRecords(tmp_path, VIRTUAL_MACHINE, {"casadi": "3"})
    records.open(resume=False)
    records.add(outcome_of())
    assert SuiteRecords(tmp_path, STARTS, {"casadi": "3"}).open(resume=True) == {}
    assert SuiteRecords(tmp_path, VIRTUAL_MACHINE, {"casadi": "4"}).open(resume=True) == {}
    assert SuiteRecords(tmp_path, VIRTUAL_MACHINE, {"casadi": "3"}).open(resume=True) == {
        "jump@dog": outcome_of()
    }
    assert SuiteRecords(tmp_path, VIRTUAL_MACHINE, {"casadi": "3"}).open(resume=False) == {}
    assert SuiteRecords(tmp_path, VIRTUAL_MACHINE, {"casadi": "3"}).open(resume=True) == {}


def test_a_folder_that_cannot_be_written_is_one_line(tmp_path: Path):
    (tmp_path / "file").write_text("")
    with refused(r"cannot write .*results\.jsonl: File exists; allowed: a folder that can be written"):
        SuiteRecords(tmp_path / "file", VIRTUAL_MACHINE, {}).open(resume=False)


# Bands


def test_bands_hold_the_solve_and_the_middle_of_its_starts():
    entry = data.entry_of(outcome_of(), VIRTUAL_MACHINE)
    assert (entry.objective_low, entry.objective_high) == pytest.approx((1.99, 2.01))
    assert (entry.iterations_low, entry.iterations_high) == (20, 120)  # starts: 40, 50 ... 130
    alone = data.entry_of(outcome_of(starts=()), VIRTUAL_MACHINE)
    assert (alone.iterations_low, alone.iterations_high) == (20, 80)


def test_a_solve_that_went_astray_has_a_band_from_half_of_what_its_starts_take():
    pair = outcome_of()
    starts = tuple(
        replace(start, iterations=count) for start, count in zip(pair.starts, range(16, 36), strict=False)
    )
    entry = data.entry_of(replace(pair, starts=starts), VIRTUAL_MACHINE)
    assert (entry.iterations_low, entry.iterations_high) == (8, 80)


def test_bands_survive_their_file(tmp_path: Path):
    outcomes = [outcome_of(), outcome_of(robot="a-long-name"), outcome_of(problem="a")]
    entries = data.updated({}, outcomes, VIRTUAL_MACHINE, [outcome.name for outcome in outcomes])
    data.write_bands(tmp_path / "bands.csv", entries, versions())
    found, head = data.read(tmp_path / "bands.csv")
    assert found == entries
    assert list(found) == sorted(found)
    assert head == versions()
    assert data.deviations(outcomes, VIRTUAL_MACHINE, found) == {}


def test_what_is_outside_its_band_is_named(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setitem(SOLVERS, "other", SOLVERS["ipopt"])
    inside = outcome_of()
    entries = {inside.name: data.entry_of(inside, VIRTUAL_MACHINE)}

    def said(settings: SuiteSettings = VIRTUAL_MACHINE, **changes: Any) -> str:
        changed = replace(inside, own=replace(inside.own, **changes))
        return data.deviation(changed, settings, entries[inside.name])

    assert said() == ""
    assert said(objective=2.02) == "objective 2.02, band 1.99 to 2.01"
    assert said(iterations=121) == "121 iterations, band 20 to 120"
    assert said(mode="dual", detail="step_failed: x") == "dual: step_failed: x"
    words = "solved on a {} mesh with {}, the data on a refined mesh with ipopt"
    assert said(replace(VIRTUAL_MACHINE, solver="other")) == words.format("refined", "other")
    assert said(replace(VIRTUAL_MACHINE, fixed_mesh=True)) == words.format("fixed", "ipopt")
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
    with refused(r"bands\.csv has no table of bands: column (mesh|problem|robot) is missing"):
        data.read(tmp_path / "bands.csv")


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"perturbed": -1}, "perturbed is -1; allowed: 0 to"),
        ({"sigma": 0.0}, "sigma is 0; allowed: > 0"),
        ({"sigma": math.nan}, "sigma is nan; allowed: > 0"),
        ({"sigma": 1e3}, "perturb is 1000; allowed: 0 to"),
        ({"solver": "snopt"}, "unknown solver 'snopt'; allowed: ipopt"),
        ({"max_time": 0.0}, "max_time is 0 s; allowed: > 0"),
    ],
)
def test_a_bad_setting_is_one_line(changes: dict[str, Any], words: str):
    with pytest.raises(InputError) as caught:
        SuiteSettings(**changes)
    assert str(caught.value).startswith(words)


ROBUSTNESS_STARTS = SuiteSettings(perturbed=3)
CASE = Case(problem="t-reach", robot="arm", takes_robot=False)
# Single precision of what is recorded of a motion.
SINGLE = 1e-6
problems = offered(suite_problems)


def motions(values: list[float]) -> list[str]:
    """Motions of one joint that stands still at these angles."""
    solution = solve(reach(), intervals=2)
    return [described(replace(solution, q=np.full_like(solution.q, value))) for value in values]


# Optima


@pytest.mark.parametrize(
    ("objectives", "angles", "optima", "shapes"),
    [
        ([], [], 0, 0),
        ([1.0, 1.0 + 1e-6, 1.0], [0.0, 1e-3, 0.0], 1, 1),  # noise
        ([1.0, 2.0], [0.0, 1.0], 2, 2),
        ([1.0, 1.0], [-1.0, 1.0], 1, 2),  # mirror images
        ([1.0, 1.01], [0.0, 1e-3], 1, 2),  # a flat minimum, not quite reached
        ([1.0, 1.0, 3.0, 3.0 + 1e-7, 2.0], [0.0, 0.0, 1.0, 1.0, 2.0], 3, 3),
        ([-1.0, -2.0, 0.0, 0.0], [0.0, 1.0, 2.0, 2.0], 3, 3),
    ],
)
def test_optima_differ_in_objective_and_motion(objectives, angles, optima, shapes):
    assert counted(objectives, motions(angles)) == (optima, shapes)


def test_runs_without_a_known_motion_go_by_the_objective():
    assert counted([1.0, 1.0 + 1e-7, 2.0], ["", "", ""]) == (2, 2)


def test_the_distance_of_motions_is_the_largest_difference():
    found = distances([*motions([0.1, 0.4]), ""])
    assert found[0, 1] == pytest.approx(0.3, abs=SINGLE)
    assert found[0, 0] == 0.0
    assert np.isnan(found[2]).all()


@pytest.mark.parametrize("robot", [hopper(), planar_hopper()])
def test_configurations_embed_without_their_double_cover(robot):
    generator = np.random.default_rng(0)
    q = pin.integrate(robot.model, robot.reference, generator.standard_normal(robot.nv))
    moved = pin.integrate(robot.model, q, np.full(robot.nv, 1e-4))
    other = q.copy()
    if robot.base == "freeflyer":
        other[3:7] *= -1
    assert embedded(robot.model, other) == pytest.approx(embedded(robot.model, q), abs=1e-12)
    small = np.abs(embedded(robot.model, moved) - embedded(robot.model, q)).max()
    assert 1e-5 < small < SAME_MOTION


def test_solves_of_one_problem_from_two_starts_are_one_optimum():
    runs = [solve(hop(), seed=seed, perturb=0.05, fixed_mesh=True) for seed in (0, 1)]
    assert all(run.converged for run in runs)
    objectives = [run.statistics.objective for run in runs]
    apart = distances([described(run) for run in runs])[0, 1]
    optima, shapes = counted(objectives, [described(run) for run in runs])
    close = abs(objectives[0] - objectives[1]) < 1e-4 * max(objectives)
    assert optima == (1 if close or apart <= SAME_MOTION else 2)
    assert shapes == (1 if close and apart <= SAME_MOTION else 2)


# Runs that go on


class Interrupted(SuiteRecords):
    """Records that are interrupted after so many starts."""

    def interrupt_after(self, most: int) -> list[int]:
        self.most, self.starts = most, list[int]()
        return self.starts

    def add_event(self, pair: str, event: dict[str, Any]) -> None:
        super().add_event(pair, event)
        if event["event"] == "start":
            self.starts.append(event["values"]["seed"])
            if len(self.starts) == self.most:
                raise KeyboardInterrupt


def pursue(folder: Path, most: int) -> tuple[list[Outcome], list[int]]:
    records = Interrupted(folder, ROBUSTNESS_STARTS, {"version": "1"})
    records.open(resume=True)
    starts = records.interrupt_after(most)
    try:
        with open_workers(jobs=1) as workers:
            outcomes = list(run_suite([CASE], ROBUSTNESS_STARTS, records, workers))
    except KeyboardInterrupt:
        outcomes = []
    for outcome in outcomes:
        records.add(outcome)
    return outcomes, starts


@pytest.mark.long
def test_a_pair_that_was_interrupted_goes_on_with_the_starts_that_are_left(tmp_path):
    assert pursue(tmp_path, 2) == ([], [0, 1])
    (found,), starts = pursue(tmp_path, 99)
    assert starts == [2]
    assert found.ok
    assert [start.seed for start in found.starts] == [0, 1, 2]
    assert all(start.solved and start.motion for start in found.starts)
    figures = found.perturbed()
    assert (figures.count, figures.solved, figures.optima, figures.motions) == (3, 3, 1, 1)
    assert figures.most_iterations == max(start.iterations for start in found.starts)
    again, starts = pursue(tmp_path, 99)
    assert (starts, again[0].starts) == ([], found.starts)


def test_events_of_other_settings_or_damaged_ones_are_not_taken(tmp_path):
    pursue(tmp_path, 1)
    with (tmp_path / "events.jsonl").open("a") as stream:
        stream.write("{no json\n" + json.dumps({"pair": "x", "told": {"event": "start"}}) + "\n")
    assert list(SuiteRecords(tmp_path, ROBUSTNESS_STARTS, {"version": "1"}).unfinished()) == [CASE.name]
    assert SuiteRecords(tmp_path, replace(ROBUSTNESS_STARTS, sigma=0.2), {"version": "1"}).unfinished() == {}
    SuiteRecords(tmp_path, ROBUSTNESS_STARTS, {"version": "1"}).open(resume=False)
    assert SuiteRecords(tmp_path, ROBUSTNESS_STARTS, {"version": "1"}).unfinished() == {}
