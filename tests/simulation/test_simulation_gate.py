"""The acceptance gate of physics: what a suite makes of plans in MuJoCo."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.support.suite_outcomes import outcome_of
from trajopt import Solution
from trajopt.cli.commands import main
from trajopt.errors import InputError
from trajopt.motion.configurations import geodesic_configurations
from trajopt.study.records import versions
from trajopt.study.suite import data
from trajopt.study.suite.cases import Case
from trajopt.study.suite.engine import SIMULATED, SuiteRecords, run_suite
from trajopt.study.suite.outcome import FELL, OFF, TRACKED, WORDS, Outcome, Physics
from trajopt.study.suite.run import SuiteSettings, measure_case
from trajopt.study.suite.table import outcome_line, outcome_table, summary
from trajopt.study.tasks import open_workers

pytest.importorskip("mujoco")

# The figure that is asked for: the base's distance from the plan at its end, m.
MOST_BASE_ERROR = 0.05
# The same distance from two files: rounding.
ROUNDING = 1e-9
SETTINGS = SuiteSettings(simulate=True)
ROBOTS = ("solo12", "go2", "anymal_c")


def gated(problem: str, robot: str, folder: Path) -> Outcome:
    case = Case(problem=problem, robot=robot, takes_robot=True)
    with open_workers(jobs=1) as workers:
        (outcome,) = run_suite([case], SETTINGS, SuiteRecords(folder, SETTINGS, {}), workers)
    return outcome


@pytest.mark.slow
@pytest.mark.parametrize("problem", ["quadruped-jump-forward", "quadruped-trot"])
@pytest.mark.parametrize("robot", ROBOTS)
def test_physics_tracks_jumps_and_trots_without_a_fall(problem: str, robot: str, tmp_path: Path):
    outcome = gated(problem, robot, tmp_path)
    assert outcome.ok
    assert outcome.physics is not None
    assert (outcome.physics.word, outcome.physics.detail) == (TRACKED, "")
    plan, motion = (Solution.load(tmp_path / f"{problem}@{robot}{end}.npz") for end in ("", SIMULATED))
    planned, reached = plan.q[-1, :3], geodesic_configurations(motion, np.array([plan.t[-1]]))[0, :3]
    error = float(np.linalg.norm(reached - planned))
    assert error <= MOST_BASE_ERROR
    assert error == pytest.approx(outcome.physics.base_error_end, abs=ROUNDING)


@pytest.mark.long
@pytest.mark.parametrize(("simulate", "physics"), [(True, Physics()), (False, None)])
def test_a_fixed_base_has_no_physics_and_without_the_option_there_is_none(
    simulate: bool, physics: Physics | None
):
    case = Case(problem="double-pendulum", robot="double_pendulum", takes_robot=False)
    assert measure_case(case, replace(SETTINGS, simulate=simulate)).physics == physics


def found(word: str = TRACKED, **changes: Any) -> Outcome:
    physics = Physics(word=word, base_error_end=0.004, base_error_max=0.006, slips=1, missed=0)
    return outcome_of(physics=replace(physics, **changes))


@pytest.mark.parametrize("now", [*WORDS, ""])
@pytest.mark.parametrize("before", [*WORDS, ""])
def test_a_plan_that_physics_makes_less_of_is_outside_its_bands(now: str, before: str):
    entry = replace(data.entry_of(found(), SETTINGS), physics=before)
    worse = data.deviation(found(now, detail="it lies down"), SETTINGS, entry)
    rank = {"": -1, FELL: 0, OFF: 1, TRACKED: 2}
    assert bool(worse) == (before != "" and rank[now] < rank[before])
    assert not worse or ("it lies down" in worse and f"the data say {before}" in worse)


def test_bands_say_nothing_of_physics_that_was_not_asked_for():
    entry = data.entry_of(found(), SETTINGS)
    assert entry.physics == TRACKED
    assert data.deviation(outcome_of(), SETTINGS, entry) == ""


def test_data_with_physics_survive_a_file_and_an_update_without_it(tmp_path: Path):
    entries = data.updated({}, [found(OFF)], SETTINGS, ["jump@dog"])
    data.write_bands(tmp_path / "bands.csv", entries, {"casadi": "3"})
    known, _ = data.read(tmp_path / "bands.csv")
    assert known == entries
    kept = data.updated(known, [outcome_of()], SETTINGS, ["jump@dog"])
    assert kept["jump@dog"].physics == OFF
    assert data.updated(known, [found()], SETTINGS, ["jump@dog"])["jump@dog"].physics == TRACKED


def test_data_from_before_physics_are_read_as_unknown(tmp_path: Path):
    data.write_bands(tmp_path / "bands.csv", {"jump@dog": data.entry_of(found(), SETTINGS)}, {})
    text = (tmp_path / "bands.csv").read_text().splitlines()
    (tmp_path / "old.csv").write_text("\n".join(row.rpartition(",")[0] for row in text) + "\n")
    assert data.read(tmp_path / "old.csv")[0]["jump@dog"].physics == ""


def test_data_with_an_unknown_word_are_refused(tmp_path: Path):
    data.write_bands(tmp_path / "bands.csv", {"jump@dog": data.entry_of(found("swam"), SETTINGS)}, {})
    with pytest.raises(InputError, match="line 1"):
        data.read(tmp_path / "bands.csv")


def test_an_outcome_with_physics_survives_json_and_a_resumed_run(tmp_path: Path):
    outcome = found()
    assert Outcome.from_dict(json.loads(json.dumps(outcome.to_dict()))) == outcome
    records = SuiteRecords(tmp_path, SETTINGS, {})
    records.open(resume=False)
    records.add(outcome)
    assert SuiteRecords(tmp_path, SETTINGS, {}).open(resume=True) == {outcome.name: outcome}
    assert SuiteRecords(tmp_path, replace(SETTINGS, simulate=False), {}).open(resume=True) == {}


def test_line_table_and_summary_tell_of_physics():
    assert "tracked in physics, base 4 mm off at the end" in outcome_line(found())
    outcomes = [found(), found(FELL, detail="it fell at 0.500 s"), found("", detail="cannot be simulated")]
    assert summary(outcomes)["physics"] == {TRACKED: 1, OFF: 0, FELL: 1}
    assert summary([outcome_of()])["physics"] is None
    titles = [str(column.header) for column in outcome_table(outcomes, 200).columns]
    assert titles[-10:-6] == ["physics", "base end", "most", "slips"]
    assert "physics" not in [str(column.header) for column in outcome_table([outcome_of()], 200).columns]


@pytest.mark.parametrize("word", WORDS)
@pytest.mark.parametrize("before", [None, *WORDS])
def test_a_fall_fails_a_suite_unless_the_data_know_of_it(
    word: str, before: str | None, tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    outcome = replace(found(word), problem="hopper-hop", robot="hopper", starts=())
    records = SuiteRecords(tmp_path, SETTINGS, versions())
    records.open(resume=False)
    records.add(outcome)  # taken over below: nothing is solved here
    arguments = ["bench", "suite", "--problems", "hopper-hop", "--robots", "hopper", "--simulate", "--json"]
    arguments += ["--output-dir", str(tmp_path), "--resume"]
    if before is not None:
        entry = replace(data.entry_of(outcome, SETTINGS), physics=before)
        data.write_bands(tmp_path / "bands.csv", {entry.name: entry}, {})
        arguments += ["--compare", str(tmp_path / "bands.csv")]
    with pytest.raises(SystemExit) as ended:
        main(arguments)
    printed = json.loads(capsys.readouterr().out)
    assert printed["summary"]["physics"][word] == 1
    worse = word == FELL if before is None else WORDS.index(word) < WORDS.index(before)
    assert ended.value.code == int(worse)
    assert bool(printed["outside"]) == (worse and before is not None)
