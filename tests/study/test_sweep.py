"""Sweeps without solving: summaries, tables, the plot, records."""

import csv
import json
import math
from dataclasses import asdict, replace
from pathlib import Path

import pytest

from tests.support.problems import REACH_TIME, reach
from trajopt.errors import InputError
from trajopt.robot.units import Units
from trajopt.study.sweep.plan import SweepPlan
from trajopt.study.sweep.plot import plot
from trajopt.study.sweep.records import Job, SweepRecords, SweepRequest, SweepResults, TimedRun
from trajopt.study.sweep.setting import Setting
from trajopt.study.sweep.summary import disturbance, median_run, summarize, write_tables

BASE = Setting(transcription="legendre:2", intervals=10)
NAN, INF = math.nan, math.inf
# Tables have six digits.
DIGITS = 1e-5


# Summaries


def run(setting: Setting, start: int, time: float, **values: object) -> TimedRun:
    known = {
        "status": "solved", "success": True, "iterations": 5, "variables": 50, "calibration": 1e-3,
        "cpu_share": 1.0,
    }  # fmt: skip
    return TimedRun(setting=setting.name, start=start, attempt=0, wall_time=time, **{**known, **values})


def found(*runs: TimedRun, errors: dict[str, float] | None = None) -> SweepResults:
    """Runs and the errors of their medians, by setting's name."""
    made = SweepResults(runs={one.job: one for one in runs})
    for name, error in (errors or {}).items():
        median = median_run(made, name, range(3))
        assert median is not None
        made.accuracy[name] = (median.job, False, {"open_loop_m": error})
    return made


def test_the_median_run_counts_failures_as_slowest():
    failed = {"success": False, "status": "infeasible"}
    assert median_run(found(), BASE.name, range(3)) is None
    calm = found(run(BASE, 0, 3.0), run(BASE, 1, 1.0), run(BASE, 2, 2.0))
    assert median_run(calm, BASE.name, range(3)).time == 2.0
    one = found(run(BASE, 0, 3.0), run(BASE, 1, 1.0), run(BASE, 2, 0.1, **failed))
    assert median_run(one, BASE.name, range(3)).time == 3.0
    two = found(run(BASE, 0, 3.0), run(BASE, 1, 1.0, **failed), run(BASE, 2, 0.1, **failed))
    assert median_run(two, BASE.name, range(3)).time == INF


def test_a_disturbed_run_gives_way_to_its_repetition():
    disturbed = run(BASE, 0, 9.0, disturbed=True)
    again = replace(run(BASE, 0, 1.0), attempt=1)
    worse = replace(run(BASE, 0, 5.0, disturbed=True, calibration=2e-3), attempt=1)
    assert found(disturbed, again).best(BASE.name, 0) == again
    assert found(disturbed, worse).best(BASE.name, 0) == disturbed
    assert disturbance(found(disturbed, again))["disturbed"] == 1


def test_times_of_warm_starts_and_second_stages_count():
    assert run(BASE, 0, 1.0, start_time=0.5, stage_two_time=0.25).time == 1.75


FAST, FINE, SLOW, FAILED = (
    replace(BASE, **changes)
    for changes in ({"intervals": 5}, {"intervals": 20}, {"hessian": "gauss-newton"}, {"tolerance": 1e-3})
)
PLAN = SweepPlan(base=BASE, settings=(BASE, FAST, FINE, SLOW, FAILED))


def measured() -> SweepResults:
    failed = {"success": False, "status": "lost", "detail": "crash: SIGSEGV"}
    return found(
        run(BASE, 0, 1.0), run(FAST, 0, 0.1), run(FINE, 0, 4.0), run(SLOW, 0, 3.0),
        run(FAILED, 0, 0.0, **failed),
        errors={BASE.name: 1e-3, FAST.name: 1e-2, FINE.name: 1e-7, SLOW.name: 1e-3},
    )  # fmt: skip


def test_settings_are_placed_on_the_front_or_below_it():
    rows = summarize(PLAN, measured(), (0,))
    assert [row.on_front for row in rows] == [True, True, True, False, False]
    assert [row.dominated_by for row in rows] == ["", "", "", "legendre:2@10", ""]
    assert rows[-1].failure == "lost: crash: SIGSEGV"


def test_figures_of_another_run_are_not_the_medians():
    known = measured()
    known.runs[Job(setting=FAST.name, start=1)] = run(FAST, 1, 9.0)
    rows = summarize(PLAN, known, (0, 1))
    assert math.isnan(rows[1].error)
    assert not rows[1].on_front


def test_tables_hold_the_settings_and_the_front(tmp_path: Path):
    known, problem = measured(), reach()
    units = Units(problem.robot)
    write_tables(tmp_path, "reach", problem, known, summarize(PLAN, known, (0,)))
    with (tmp_path / "settings.csv").open() as stream:
        rows = {row["label"]: row for row in csv.DictReader(stream)}
    base, fast = rows[BASE.label(BASE)], rows[FAST.label(BASE)]
    assert (base["problem"], base["robot"], base["kind"]) == ("reach", problem.robot.name, "arm")
    assert float(base["length_m"]) == pytest.approx(units.length, rel=DIGITS)
    assert float(fast["relative_time"]) == pytest.approx(0.1)
    assert float(fast["relative_error"]) == pytest.approx(1e-2 / units.length, rel=DIGITS)
    density = 5 * units.time / REACH_TIME
    assert float(fast["intervals_per_natural_time"]) == pytest.approx(density, rel=DIGITS)
    with (tmp_path / "front.csv").open() as stream:
        assert [row["label"] for row in csv.DictReader(stream)] == [
            "legendre:2@5", "legendre:2@10", "legendre:2@20",
        ]  # fmt: skip


def test_the_plot_shows_the_front(tmp_path: Path):
    rows = summarize(PLAN, measured(), (0,))
    assert plot(rows, "reach", tmp_path / "front.png") == tmp_path / "front.png"
    from matplotlib.image import imread

    picture = imread(tmp_path / "front.png")[..., :3]
    assert min(picture.shape[:2]) > 500
    blue = (picture[..., 2] > 0.5) & (picture[..., 0] < 0.2)
    red = (picture[..., 0] > 0.7) & (picture[..., 1] < 0.1)
    assert blue.sum() > 100
    assert red.sum() > 100


def test_without_figures_there_is_no_plot(tmp_path: Path):
    assert plot(summarize(PLAN, found(), (0,)), "reach", tmp_path / "front.png") is None
    assert not (tmp_path / "front.png").exists()


# Records


def records(folder: Path, *, resume: bool, **changes: object) -> SweepRecords:
    asked = SweepRequest(problem="reach", values={"x": "1"}, **changes)
    return SweepRecords(folder, asked.head(PLAN, {"trajopt": "1"}), resume=resume)


def test_records_are_read_back(tmp_path: Path):
    first = records(tmp_path, resume=False)
    for one in measured().runs.values():
        first.add(run=asdict(one))
    job = asdict(Job(setting=BASE.name, start=0))
    first.add(accuracy=[job, True, {"open_loop_m": 1e-3, "distance_m": None}])
    first.add(reference={"ok": False, "text": "none"})
    first.add(calibrations=[1e-3, 2e-3])
    with (tmp_path / "record.jsonl").open("a") as stream:
        stream.write('{"run": {"setting": "cut')  # as a crash leaves it
    again = records(tmp_path, resume=True)
    assert again.results == first.results
    again.add(calibrations=[3e-3])
    assert records(tmp_path, resume=True).results.calibrations == [1e-3, 2e-3, 3e-3]


def test_a_new_sweep_forgets_the_old_one(tmp_path: Path):
    records(tmp_path, resume=False).add(calibrations=[1.0])
    assert not records(tmp_path, resume=False).results.calibrations


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"repeats": 5}, "another number of runs"),
        ({"sigma": 0.2}, "other noise"),
        ({"max_time": 1.0}, "another time"),
    ],
)
def test_another_sweep_is_not_resumed(tmp_path: Path, changes: dict[str, object], words: str):
    records(tmp_path, resume=False)
    with pytest.raises(InputError, match=f"holds a sweep with {words}"):
        records(tmp_path, resume=True, **changes)


def test_another_plan_and_no_sweep_at_all_are_not_resumed(tmp_path: Path):
    head = SweepRequest(problem="reach", values={"x": "1"}).head(
        replace(PLAN, settings=PLAN.settings[:2]), {"trajopt": "1"}
    )
    (tmp_path / "record.jsonl").write_text(json.dumps({"head": head}) + "\n")
    with pytest.raises(InputError, match="holds a sweep with another plan"):
        records(tmp_path, resume=True)
    (tmp_path / "record.jsonl").write_text("nothing\n")
    with pytest.raises(InputError, match="holds no sweep; allowed: the folder of a sweep"):
        records(tmp_path, resume=True)
    with pytest.raises(InputError, match="holds no sweep"):
        records(tmp_path / "new", resume=True)
    assert not (tmp_path / "new").exists()


def test_a_folder_that_cannot_be_written_is_refused(tmp_path: Path):
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match="cannot write"):
        records(tmp_path / "file", resume=False)
