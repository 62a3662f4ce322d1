"""Batches on this machine: executors, lost cases, what is resumed, what is refused."""

import multiprocessing
import signal
from collections.abc import Callable
from concurrent.futures import Executor, ProcessPoolExecutor, ThreadPoolExecutor
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.support import batch_problems
from tests.support.batch_problems import FATES, runs
from tests.support.packages import offered
from tests.support.refusals import assert_refused_in_one_line
from trajopt import Solution, batch, check, dataset
from trajopt.study import BatchCase, BatchDataset, BatchSettings, batch_cases
from trajopt.study.batch.engine import run_batch
from trajopt.study.batch.records import BatchRecords
from trajopt.study.batch.solved_case import CaseResult
from trajopt.study.tasks import local_executor, open_workers

pytestmark = pytest.mark.long

# Columns that are measured.
TIMES = ["solver_time_s", "case_time_s"]
package = offered(batch_problems)


def swings() -> list[BatchCase]:
    """Two groups; the farthest swing is not possible in the shortest time."""
    return batch_cases("t-swing", vary=["goal=0.2,0.4,1.4", "duration=0.4,0.8", "cost=acceleration,torque"])


def fates(noted: Path, words: str, numbers: str = "0") -> list[BatchCase]:
    return batch_cases("t-fated", robots=[str(noted)], vary=[f"fate={words}", f"number={numbers}"])


def figures(found: BatchDataset) -> list[dict[str, Any]]:
    """The index without what is measured."""
    return found.index.drop_columns(TIMES).to_pylist()


def statuses(found: BatchDataset) -> list[str]:
    return found.index["status"].to_pylist()


@pytest.fixture(scope="module")
def reference(tmp_path_factory: pytest.TempPathFactory) -> BatchDataset:
    """The swings, one at a time."""
    return batch(swings(), tmp_path_factory.mktemp("reference"), jobs=1)


# Results


def test_every_case_has_a_row_in_order(reference: BatchDataset):
    rows, cases = reference.index.to_pylist(), swings()
    assert [row["case"] for row in rows] == list(range(len(cases)))
    for row, case in zip(rows, cases, strict=True):
        assert {name: row[name] for name in case.values} == dict(case.values)
        possible = not (case.values["goal"] == 1.4 and case.values["duration"] == 0.4)
        assert (row["success"], row["status"]) == (possible, "solved" if possible else "infeasible")
        assert row["motion_time_s"] == pytest.approx(case.values["duration"])
        assert row["attempts"] == 1
        assert (row["detail"] == "") == possible
    assert len(reference) == len(rows) - 2
    assert reference.parameters == ["goal", "duration", "cost"]


def test_solved_cases_are_data_equal_to_their_files(reference: BatchDataset):
    entries = list(reference)
    assert len(entries) == len(reference)
    assert [entry.figures["case"] for entry in entries] == sorted(entry.figures["case"] for entry in entries)
    for entry in entries:
        assert entry.file is not None
        written = Solution.load(entry.file)
        assert np.array_equal(entry.solution.q, written.q)
        assert entry.figures["objective"] == written.statistics.objective
        assert check(written).ok
        assert dict(entry.case.values).items() <= written.description.parameters.items()


def test_cases_start_from_solved_neighbours_of_their_group(reference: BatchDataset):
    rows = reference.index.to_pylist()
    assert sum(row["start"] is None for row in rows) == 2  # the roots of both groups
    for row in rows:
        assert row["warm_start"] == (row["start"] is not None and row["success"])
        if row["start"] is not None:
            assert rows[row["start"]]["success"]
            assert rows[row["start"]]["cost"] == row["cost"]


def test_the_index_is_read_by_pandas(reference: BatchDataset):
    pandas = pytest.importorskip("pandas")
    frame = pandas.read_parquet(reference.folder / "index.parquet")
    assert list(frame.columns) == reference.index.column_names
    assert frame["objective"].tolist() == reference.index["objective"].to_pylist()
    assert frame.groupby("duration")["success"].mean().to_dict() == {0.4: pytest.approx(2 / 3), 0.8: 1.0}


def test_a_batch_read_from_its_folder_is_the_same(reference: BatchDataset):
    again = dataset(reference.folder)
    assert again.index.equals(reference.index)
    assert again.cases == reference.cases


# Executors


def forked() -> Executor:
    return ProcessPoolExecutor(2, mp_context=multiprocessing.get_context("fork"))


def spawned() -> Executor:
    return ProcessPoolExecutor(2, mp_context=multiprocessing.get_context("spawn"))


@pytest.mark.parametrize(
    "make", [lambda: local_executor(4), lambda: ThreadPoolExecutor(3), forked, spawned],
    ids=["processes", "threads", "forked", "spawned"],
)  # fmt: skip
def test_results_do_not_depend_on_the_executor(
    make: Callable[[], Executor], reference: BatchDataset, tmp_path: Path
):
    with make() as executor:
        found = batch(swings(), tmp_path / "out", executor=executor)
    assert figures(found) == figures(reference)
    for entry, other in zip(found, reference, strict=True):
        assert np.array_equal(entry.solution.q, other.solution.q)


def test_results_do_not_depend_on_the_order_of_the_cases(reference: BatchDataset, tmp_path: Path):
    found = batch(swings()[::-1], tmp_path / "out", jobs=2)
    objectives = reference.index["objective"].to_pylist()
    assert found.index["success"].to_pylist() == reference.index["success"].to_pylist()[::-1]
    solved = found.index["success"].to_pylist()
    pairs = zip(found.index["objective"].to_pylist(), objectives[::-1], solved, strict=True)
    assert all(own == pytest.approx(other, rel=1e-6) for own, other, success in pairs if success)


def test_without_neighbours_every_case_starts_from_its_guess(tmp_path: Path):
    found = batch(swings()[:3], tmp_path / "out", jobs=1, neighbours=False)
    assert found.index["start"].to_pylist() == [None] * 3
    assert found.index["warm_start"].to_pylist() == [False] * 3


# Cases that are lost


def lost_cases(noted: Path) -> list[BatchCase]:
    return fates(noted, ",".join(FATES), "1,2")


@pytest.mark.parametrize(
    "make", [lambda: None, lambda: ThreadPoolExecutor(2), forked], ids=["processes", "threads", "forked"]
)
def test_a_lost_case_has_one_row_and_loses_no_other(
    make: Callable[[], Executor | None], noted: Path, tmp_path: Path
):
    with ExitStack() as stack:
        executor = make()
        if executor is not None:
            stack.enter_context(executor)
        found = batch(lost_cases(noted), tmp_path / "out", executor=executor)
    rows = {(row["fate"], row["number"]): row for row in found.index.to_pylist()}
    assert found.index.num_rows == len(rows) == 2 * len(FATES)
    for number in (1.0, 2.0):
        own = {fate: rows[fate, number] for fate in FATES}
        told = {fate: (row["status"], row["attempts"]) for fate, row in own.items()}
        assert told == {
            "solved": ("solved", 1),
            "hold": ("solved", 1),
            "hang": ("time_limit", 1),
            "killed": ("lost", 3),
            "killed-once": ("solved", 2),
            "refused": ("refused", 1),
            "broken": ("refused", 1),
        }
        assert own["killed"]["detail"] == "crash: SIGKILL (out of memory?)"
        assert own["refused"]["detail"] == "the goal is on the moon; allowed: on earth"
        assert own["hang"]["detail"] == f"killed after {batch_problems.SHORT:g} s"
        assert "RuntimeError: first line" in own["broken"]["detail"]
        assert all("\n" not in row["detail"] for row in own.values())
    assert all((row["file"] is None) != row["success"] for row in rows.values())
    assert len(list((tmp_path / "out").rglob("*.npz"))) == len(found) == 6
    assert runs(noted)["killed-1"] == 3
    for entry in found.entries():
        if not entry.figures["success"]:
            assert_refused_in_one_line(lambda entry=entry: entry.solution, "has no solution: ")


class ShortSettings(BatchSettings):
    """Settings whose cases are ended early."""

    longest = 3.0


def test_a_case_is_ended_after_its_longest_time(noted: Path, tmp_path: Path):
    (noted / batch_problems.HELD).touch()
    cases, settings = fates(noted, "hold"), ShortSettings()
    with (
        BatchRecords(tmp_path / "out", cases, settings, {}, resume=False) as records,
        open_workers(jobs=1) as workers,
    ):
        (row,) = run_batch(cases, settings, records, workers)
    assert (row["status"], row["detail"]) == ("time_limit", "killed after 3 s")


def test_the_longest_time_has_room_for_all_solves():
    settings = BatchSettings(max_time=7.0)
    assert settings.longest > 2 * settings.max_time
    assert settings.longest > replace(settings, neighbours=False).longest > settings.max_time
    signal.setitimer(signal.ITIMER_REAL, BatchSettings(max_time=1e300).longest)
    signal.setitimer(signal.ITIMER_REAL, 0.0)


def test_an_executor_that_breaks_ends_the_batch_in_one_line(noted: Path, tmp_path: Path):
    executor = ThreadPoolExecutor(1)
    executor.shutdown()
    cases = fates(noted, "solved", "1,2")
    words = (
        "the executor has broken down: cannot schedule new futures after shutdown; what was reported is kept"
    )
    assert_refused_in_one_line(lambda: batch(cases, tmp_path / "out", executor=executor), words)
    assert len(batch(cases, tmp_path / "out", resume=True)) == 2


# What is resumed


def test_only_what_is_missing_is_solved(noted: Path, tmp_path: Path):
    cases, told = fates(noted, "solved,refused", "1,2,3,4"), []

    def stop(row: dict[str, Any]) -> None:
        told.append(row["case"])
        if len(told) == 3:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        batch(cases, tmp_path / "out", jobs=1, on_row=stop)
    before = dataset(tmp_path / "out")
    assert sorted(told) == before.index["case"].to_pylist()
    known = {f"{cases[i].values['fate']}-{cases[i].values['number']:g}" for i in told}
    counts = runs(noted)
    batch(cases, tmp_path / "out", jobs=1, on_row=lambda row: told.append(row["case"]), resume=True)
    assert sorted(told) == list(range(len(cases)))
    assert {name: runs(noted)[name] for name in known} == {name: counts[name] for name in known}
    rows = dataset(tmp_path / "out").index.to_pylist()
    assert all(row in rows for row in before.index.to_pylist())
    whole = batch(cases, tmp_path / "whole", jobs=1)
    assert figures(whole) == figures(dataset(tmp_path / "out"))


def test_lost_and_unsaved_cases_are_run_again_and_refused_ones_are_not(noted: Path, tmp_path: Path):
    cases, out = fates(noted, "solved,killed-once,refused,killed", "1"), tmp_path / "out"
    found = batch(cases, out, jobs=1)
    assert statuses(found) == ["solved", "solved", "refused", "lost"]
    counts = runs(noted)
    again = batch(cases, out, jobs=1, resume=True)
    assert statuses(again) == statuses(found)
    changed = {name for name, count in runs(noted).items() if count != counts[name]}
    assert changed == {"killed-1"}


def test_solutions_that_cannot_be_written_are_rows_and_solved_when_resumed(noted: Path, tmp_path: Path):
    cases, out = fates(noted, "solved", "1,2,3"), tmp_path / "out"

    def block(row: dict[str, Any]) -> None:
        """Put a file in the folder's place after the first solution."""
        folder = out / "solutions"
        if folder.is_dir():
            folder.rename(out / "away")
            folder.touch()

    found = batch(cases, out, jobs=1, neighbours=False, on_row=block)
    assert statuses(found) == ["solved", "not_saved", "not_saved"]
    assert [row["file"] is None for row in found.index.to_pylist()] == [False, True, True]
    assert all("\n" not in row["detail"] and row["detail"] for row in found.index.to_pylist()[1:])
    (out / "solutions").unlink()
    (out / "away").rename(out / "solutions")
    again = batch(cases, out, jobs=1, neighbours=False, resume=True)
    assert statuses(again) == ["solved"] * 3
    assert runs(noted) == {"solved-1": 1, "solved-2": 2, "solved-3": 2}


def test_a_batch_that_is_complete_runs_nothing(reference: BatchDataset):
    told: list[dict[str, Any]] = []
    again = batch(swings(), reference.folder, jobs=1, resume=True, on_row=told.append)
    assert told == []
    assert again.index.equals(reference.index)


def test_a_case_waits_for_ancestors_that_are_run_again(noted: Path, tmp_path: Path):
    """Where a root was lost and some descendants were not, the others start as if it had been there."""
    cases = fates(noted, "solved", "1,2,3,4,5,6,7")
    whole = batch(cases, tmp_path / "whole", jobs=1)
    rows = whole.index.to_pylist()
    root = next(row["case"] for row in rows if row["start"] is None)
    leaf = next(row["case"] for row in rows if row["start"] == root)
    settings = BatchSettings()
    with BatchRecords(tmp_path / "out", cases, settings, {}, resume=False) as records:
        names = ["success", "status", "detail"]
        known = [row["case"] for row in rows if row["start"] == root and row["case"] != leaf]
        for index in known:
            content = (whole.folder / rows[index]["file"]).read_bytes()
            result = CaseResult(figures={name: rows[index][name] for name in names}, content=content)
            records.add(index, result, start=None, attempts=1)
        with open_workers(jobs=3) as workers:
            found = {row["case"]: row["start"] for row in run_batch(cases, settings, records, workers)}
    assert found == {row["case"]: row["start"] for row in rows if row["case"] not in known}


# What is refused


def test_a_folder_of_something_else_is_one_line(noted: Path, tmp_path: Path):
    cases, out = fates(noted, "solved", "1,2"), tmp_path / "out"
    out.mkdir()
    (out / "mine").write_text("mine")
    assert_refused_in_one_line(
        lambda: batch(cases, out), "is there and not empty; allowed: a new or an empty folder"
    )
    assert_refused_in_one_line(lambda: batch(cases, out, resume=True), "holds no batch; allowed: the folder")
    assert_refused_in_one_line(lambda: dataset(out), "holds no batch; allowed: the folder of a batch")
    assert_refused_in_one_line(lambda: batch(cases, out / "mine"), "is there and not empty")
    assert_refused_in_one_line(lambda: batch(cases, out / "mine" / "new"), "cannot write")
    assert_refused_in_one_line(lambda: batch(cases, tmp_path / "no", resume=True), "holds no batch")
    assert [path.name for path in out.iterdir()] == ["mine"]
    assert (out / "mine").read_text() == "mine"
    assert not (tmp_path / "no").exists()


def test_another_batch_is_not_mixed_with_the_first(noted: Path, tmp_path: Path):
    cases, out = fates(noted, "solved", "1,2"), tmp_path / "out"
    batch(cases[:1], out, jobs=1)
    kept = {path: path.read_bytes() for path in out.rglob("*") if path.is_file()}
    for changes, words in (
        ({"cases": cases[:1]}, "is there and not empty; allowed: `resume`, or another folder"),
        ({"cases": cases, "resume": True}, "holds a batch with other cases; allowed: the same batch"),
        ({"cases": cases[:1], "resume": True, "max_time": 5.0}, "holds a batch with other settings"),
        ({"cases": cases[:1], "resume": True, "neighbours": False}, "holds a batch with other settings"),
    ):
        assert_refused_in_one_line(lambda changes=changes: batch(folder=out, **changes), words)
    assert kept == {path: path.read_bytes() for path in out.rglob("*") if path.is_file()}


def test_a_folder_in_use_is_one_line(noted: Path, tmp_path: Path):
    cases, out = fates(noted, "solved", "1"), tmp_path / "out"
    with BatchRecords(out, cases, BatchSettings(), {}, resume=False):
        assert_refused_in_one_line(
            lambda: BatchRecords(out, cases, BatchSettings(), {}, resume=True), f"a batch runs in {out}; "
        )
    BatchRecords(out, cases, BatchSettings(), {}, resume=True).__exit__()


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        ({"solver": "snopt"}, "unknown solver 'snopt'; allowed: "),
        ({"max_time": 0.0}, "max_time is 0 s; allowed: > 0"),
        ({"tolerance": 2.0}, "tolerance is 2; allowed: between 0 and 1"),
        ({"jobs": 0}, "jobs of batch is 0; allowed: "),
        (
            {"jobs": 1, "executor": ThreadPoolExecutor(1)},
            "`jobs` has no effect here; allowed: without `executor`",
        ),
        ({"executor": 3}, "executor of batch is 3"),
        ({"max_itertaions": 3}, "max_itertaions"),
        ({"max_time": "long"}, "max_time"),
    ],
)
def test_settings_that_are_not_allowed_are_one_line(settings: dict[str, Any], words: str, tmp_path: Path):
    assert_refused_in_one_line(lambda: batch(swings(), tmp_path / "out", **settings), words)
    assert not (tmp_path / "out").exists()
