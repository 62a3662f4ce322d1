"""What a suite makes of its outcomes: figures, results on disk, bands, settings."""

import json
import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.support import suite_problems
from tests.support.problems import reach
from tests.support.suite_outcomes import outcome_of
from trajopt import solve
from trajopt.errors import InputError
from trajopt.solvers.drivers import SOLVERS
from trajopt.study.records import versions
from trajopt.study.solves import CHECK
from trajopt.study.suite import data
from trajopt.study.suite.engine import SuiteRecords
from trajopt.study.suite.outcome import Outcome, quantile
from trajopt.study.suite.run import SuiteSettings, attempt

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
    with pytest.raises(
        InputError, match=r"cannot write .*results\.jsonl: File exists; allowed: a folder that can be written"
    ):
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
    with pytest.raises(
        InputError, match=r"bands\.csv has no table of bands: column (mesh|problem|robot) is missing"
    ):
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
