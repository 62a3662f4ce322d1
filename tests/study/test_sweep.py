"""Sweeps without solving: plans, fronts, settings, summaries, tables, the plot, records."""

import csv
import itertools
import json
import math
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
import pytest

from tests.support.problems import REACH_TIME, hop, reach
from trajopt.errors import InputError
from trajopt.robot.units import Units
from trajopt.study.sweep.plan import OTHER_SCHEMES, SweepPlan, make_plan, own_setting
from trajopt.study.sweep.plot import plot
from trajopt.study.sweep.records import Job, SweepRecords, SweepRequest, SweepResults, TimedRun
from trajopt.study.sweep.setting import WORDS, Setting, cone_of, with_cone
from trajopt.study.sweep.summary import disturbance, dominators, front, median_run, summarize, write_tables
from trajopt.terms import FrictionCone, FrictionPyramid

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


# Fronts


@pytest.mark.parametrize(
    ("points", "expected"),
    [
        ([], []),
        ([(1.0, 1.0)], [0]),
        ([(2.0, 1.0), (1.0, 2.0), (2.0, 2.0)], [1, 0]),
        ([(1.0, 1.0), (1.0, 1.0)], [0, 1]),  # equal points do not dominate each other
        ([(1.0, 2.0), (1.0, 1.0)], [1]),  # as fast, more accurate
        ([(1.0, 1.0), (2.0, 1.0)], [0]),  # as accurate, faster
        ([(INF, 1e-9), (1.0, 1.0), (NAN, 0.0), (0.5, INF), (0.1, NAN)], [1]),
        ([(NAN, NAN)], []),
        ([(1.0, 0.0), (2.0, 0.0)], [0]),
    ],
)
def test_the_front_holds_what_nothing_dominates(points: list[tuple[float, float]], expected: list[int]):
    assert front(points) == expected


def test_the_front_is_that_of_the_definition():
    points = [tuple(row) for row in np.random.default_rng(0).integers(1, 12, (60, 2)).astype(float)]

    def dominated(point: tuple[float, float]) -> bool:
        return any(other[0] <= point[0] and other[1] <= point[1] and other != point for other in points)

    found = front(points)
    assert sorted(found) == [i for i, point in enumerate(points) if not dominated(point)]
    assert found == sorted(found, key=lambda i: points[i])


def test_a_slower_point_has_to_gain():
    points = [(1.0, 1.0), (2.0, 0.96), (3.0, 0.94), (4.0, 0.5)]
    assert front(points, gain=0.05) == [0, 2, 3]
    assert dominators(points, gain=0.05) == [None, 0, None, None]


def test_dominators_are_on_the_front_and_ahead():
    points = [(1.0, 1.0), (4.0, 0.01), (5.0, 1.1), (5.0, 0.02), (INF, 1.0)]
    assert dominators(points) == [None, None, 1, 1, None]


def test_a_point_without_error_is_ahead_of_all():
    assert dominators([(1.0, 0.0), (2.0, 0.0), (2.0, 1.0)]) == [None, 0, 0]


# Settings


def test_no_word_belongs_to_two_axes():
    words = [word for words in WORDS.values() for word in words]
    assert len(words) == len(set(words))


@pytest.mark.long
def test_a_setting_is_its_words():
    for values in itertools.product(*WORDS.values()):
        setting = replace(BASE, tolerance=3e-4, **dict(zip(WORDS, values, strict=True)))
        assert Setting.parse(setting.name, replace(BASE, intervals=3)) == setting
        assert Setting.parse(setting.label(BASE), BASE) == setting
        assert Setting(**setting.to_dict()) == setting


def test_labels_tell_only_what_differs():
    assert BASE.label(BASE) == "legendre:2@10"
    changed = replace(BASE, hessian="gauss-newton", tolerance=1e-3)
    assert changed.label(BASE) == "legendre:2@10 1e-3 gauss-newton"


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("ipotp", "'ipotp' is no word of a setting; allowed: SCHEME@INTERVALS"),
        ("legendre:9", "unknown transcription 'legendre:9'"),
        ("legendre:2@x", "'legendre:2@x' is no grid"),
        ("@0", "intervals is 0; allowed: 1 to 100000"),
        ("@1000000000", "intervals is 1000000000"),
        ("ipopt ipopt", "setting 'ipopt ipopt' gives its solver twice"),
        ("1e-3 1e-4", "setting '1e-3 1e-4' gives its tolerance twice"),
        ("2", "tolerance is 2"),
        ("nan", "tolerance is nan"),
    ],
)
def test_wrong_words_are_refused_in_one_line(text: str, words: str):
    with pytest.raises(InputError) as caught:
        Setting.parse(text, BASE)
    assert str(caught.value).startswith(words)


# Plans


def test_the_default_plan_holds_the_grid_each_factor_and_no_setting_twice():
    problem = hop()
    plan = make_plan(problem)
    own = own_setting(problem)
    assert plan.settings[0] == plan.base == own
    assert own.cone == "smooth"
    assert len(set(plan.settings)) == len(plan.settings)
    assert plan.left_out == ()
    for axis, words in WORDS.items():
        tried = {getattr(setting, axis) for setting in plan.settings}
        assert tried >= set(words) - {"own"}
    grids = {(setting.transcription, setting.intervals) for setting in plan.settings}
    least = len(problem.schedule.phases)
    counts = {max(least, round(share * problem.default_intervals)) for share in (0.2, 0.5, 1, 2)}
    assert grids >= set(itertools.product(("legendre:1", "legendre:2", "legendre:3"), counts))
    assert grids >= {(name, problem.default_intervals) for name in OTHER_SCHEMES}


def test_what_a_problem_does_not_have_is_left_out_and_said():
    plan = make_plan(reach())
    assert {setting.model for setting in plan.settings} == {"full"}
    assert {setting.cone for setting in plan.settings} == {"own"}
    assert [note.split(":")[0] for note in plan.left_out] == ["cone smooth, pyramid", "model two-stage"]


def test_named_axes_are_varied_alone_and_grids_together():
    named = {"transcription": ["legendre:1", "radau:2"], "intervals": [5, 9], "tolerance": [1e-3, 1e-4]}
    plan = make_plan(reach(), {**named, "hessian": ["gauss-newton"]})
    assert {setting.hessian for setting in plan.settings} == {"gauss-newton"}
    labels = {setting.label(plan.base) for setting in plan.settings}
    grid = {"legendre:1@5", "legendre:1@9", "radau:2@5", "radau:2@9"}
    assert labels == grid | {"legendre:2@10", "legendre:2@10 1e-3", "legendre:2@10 1e-4"}


def test_a_full_plan_is_the_product():
    named = {"intervals": [5, 9], "hessian": ["exact", "gauss-newton"], "tolerance": [1e-3, 1e-4, 1e-5]}
    plan = make_plan(reach(), named, full=True)
    assert len(plan.settings) == 1 + 2 * 2 * 3  # the problem's own beside them


def test_a_fixed_axis_holds_in_the_default_plan():
    plan = make_plan(hop(), {"hessian": ["gauss-newton"], "transcription": ["legendre:1"]})
    assert {setting.hessian for setting in plan.settings} == {"gauss-newton"}
    assert {setting.transcription for setting in plan.settings} == {"legendre:1"}
    assert {setting.solver for setting in plan.settings} == set(WORDS["solver"])


@pytest.mark.long
@pytest.mark.parametrize(
    ("named", "words"),
    [
        ({"solver": ["snopt"]}, "unknown solver 'snopt'; allowed: ipopt"),
        ({"transcription": ["legendre:7"]}, "unknown transcription 'legendre:7'"),
        ({"tolerance": [0.0]}, "tolerance is 0"),
        ({"intervals": [0, 5]}, "intervals is 0"),
        ({"cone": ["smooth"]}, "problem 'reach' has no friction term of point contacts"),
        ({"model": ["two-stage"]}, "problem 'reach' has no base rows"),
        ({"intervals": list(range(1, 3000))}, "the product of all named values is too large"),
    ],
)
def test_a_plan_that_cannot_be_is_refused(named: dict[str, list], words: str):
    with pytest.raises(InputError) as caught:
        make_plan(reach(), named)
    assert str(caught.value).startswith(words)


def test_fewer_intervals_than_phases_are_refused():
    with pytest.raises(InputError, match="2 intervals for 3 phases"):
        make_plan(hop(), {"intervals": [2, 10]})


def test_cones_are_exchanged_with_their_values():
    problem = hop()
    (own,) = [term for term in problem.terms if isinstance(term, FrictionCone)]
    changed = with_cone(problem, "pyramid")
    (new,) = [term for term in changed.terms if isinstance(term, FrictionPyramid)]
    assert (new.friction, new.contacts, new.phases) == (own.friction, own.contacts, own.phases)
    assert cone_of(changed) == "pyramid"
    assert with_cone(changed, "smooth").terms == problem.terms
    assert with_cone(problem, "smooth") is with_cone(problem, "own") is problem
    assert cone_of(reach()) is None


def test_terms_of_both_kinds_are_told_apart():
    problem = hop()
    both = replace(problem, terms=(*problem.terms, FrictionPyramid()))
    assert cone_of(both) == "own"
    assert cone_of(with_cone(both, "smooth")) == "smooth"
    with pytest.raises(InputError, match="no friction term"):
        with_cone(reach(), "smooth")
