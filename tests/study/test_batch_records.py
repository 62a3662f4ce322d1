"""The folder of a batch: its journal and index; regions and the plot of what is in it."""

import json
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import pyarrow
import pyarrow.parquet
import pytest

from tests.support.command_lines import assert_refused, invoke
from tests.support.refusals import assert_refused_in_one_line
from trajopt.study.batch.batch import dataset
from trajopt.study.batch.records import BatchRecords
from trajopt.study.batch.report import outcomes, plot_failures, regions
from trajopt.study.batch.solved_case import BatchSettings, CaseResult
from trajopt.study.batch.variation import BatchCase

CASES = [
    BatchCase(problem="p", values={"x": float(x), "word": word}) for x in range(20) for word in ("a", "b")
]


def records(folder: Path, *, resume: bool) -> BatchRecords:
    return BatchRecords(folder, CASES, BatchSettings(), {}, resume=resume)


def result(success: bool) -> CaseResult:
    status = "solved" if success else "infeasible"
    return CaseResult(figures={"success": success, "status": status, "detail": ""}, content=None)


@pytest.fixture
def out(tmp_path: Path) -> Path:
    """A batch of which the first 30 cases are done, those up to x = 7 solved."""
    with records(tmp_path / "out", resume=False) as own:
        for index in range(30):
            own.add(index, result(index < 16), start=None, attempts=1)
    return tmp_path / "out"


def rows(out: Path) -> list[dict[str, Any]]:
    return dataset(out).index.to_pylist()


def test_the_journal_alone_loses_nothing(tmp_path: Path):
    own = records(tmp_path / "out", resume=False)
    own.add(3, result(True), start=None, attempts=1)
    assert not (tmp_path / "out" / "index.parquet").exists()
    assert [row["case"] for row in rows(tmp_path / "out")] == [3]


def test_rows_in_journal_and_index_are_one(out: Path):
    journal = out / "journal.jsonl"
    assert journal.read_text() == ""
    with records(out, resume=True) as own:
        own.add(2, result(False), start=None, attempts=2)
        assert [row["case"] for row in rows(out)] == list(range(30))
        assert rows(out)[2]["attempts"] == 2  # the newer one
        journal.write_text(journal.read_text() * 2)
    assert [row["case"] for row in rows(out)] == list(range(30))


def test_a_line_that_is_cut_off_is_run_again(out: Path):
    with (out / "journal.jsonl").open("a") as stream:
        stream.write('{"case": 35, "problem": "p", "x"')
    assert len(rows(out)) == 30
    with records(out, resume=True) as own:
        assert 35 not in own.solved
        own.add(35, result(True), start=None, attempts=1)
    assert [row["case"] for row in rows(out)] == [*range(30), 35]


def test_an_index_of_something_else_is_one_line(out: Path):
    pyarrow.parquet.write_table(pyarrow.table({"a": [1]}), out / "index.parquet")
    assert_refused_in_one_line(lambda: dataset(out), "has other columns; allowed: the index of this batch")
    (out / "index.parquet").write_bytes(b"no index")
    assert_refused_in_one_line(lambda: dataset(out), "cannot read")


def test_regions_hold_every_case_once_for_each_parameter(out: Path):
    found = dataset(out)
    parts = regions(found.index, found.parameters)
    for name in ("x", "word"):
        own = [part for part in parts if part.parameter == name]
        assert (sum(part.cases for part in own), sum(part.solved for part in own)) == (30, 16)
    assert [(part.text, part.solved) for part in parts if part.parameter == "word"] == [("a", 8), ("b", 8)]
    assert len([part for part in parts if part.parameter == "x"]) == 5  # of 15 values: ranges
    assert outcomes(found.index) == {"solved": 16, "infeasible": 14}


def test_the_plot_has_words_as_an_axis(out: Path):
    found = dataset(out)
    for parameters in (["x", "word"], ["x"], ["word"]):
        place = plot_failures(found.index, parameters, "a title", out)
        assert place is not None
        assert place.read_bytes().startswith(b"\x89PNG")
    assert plot_failures(found.index.slice(0, 1), ["x"], "a title", out) is None


# A folder of a stranger


def edited(out: Path, **changes: Any) -> Path:
    request = out / "batch.json"
    request.write_text(json.dumps(json.loads(request.read_text()) | changes))
    return out


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"cases": 3}, ["cases in", "is not a list"]),
        ({"cases": [["p"]]}, ["case 0 of the batch is ['p']", "[problem, parameters]"]),
        ({"cases": [["p", {"x": [1]}]]}, ["x of case 0 of the batch is [1]", "a number or a text"]),
        ({"settings": []}, ["settings in", "is not a dict"]),
    ],
)
def test_a_request_that_is_malformed_is_refused(out: Path, changes: dict[str, Any], words: list[str]):
    edited(out, **changes)
    for each in words:
        assert_refused_in_one_line(lambda: dataset(out), each)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"cases": [["no-such-problem", {}]]}, ["problem 'no-such-problem' is unknown"]),
        ({"settings": {"solver": "ipopt"}}, ["settings of the batch", "allowed: max_iterations"]),
        ({"cases": [["quadruped-trot", {"robot": "ran.py"}]]}, ["'ran.py'", "are not run", "--resume"]),
    ],
)
def test_what_a_folder_alone_may_not_name_is_not_resumed(
    out: Path, changes: dict[str, Any], words: list[str]
):
    (out / "ran.py").write_text(f"open({str(out / 'ran')!r}, 'w')")
    settings = {"cases": [["quadruped-trot", {}]], "settings": asdict(BatchSettings())}
    refused = invoke("batch", "--resume", "--out", edited(out, **(settings | changes)))
    assert_refused(refused, *words)
    assert not (out / "ran").exists()


@pytest.mark.parametrize("name", ["batch.json", "journal.jsonl", "index.parquet", "solutions"])
def test_a_symbolic_link_in_the_folder_is_refused(out: Path, name: str):
    elsewhere = out.parent / "elsewhere"
    elsewhere.write_text("{}")
    (out / name).unlink(missing_ok=True)
    (out / name).symlink_to(elsewhere)
    assert_refused_in_one_line(lambda: records(out, resume=True), f"{name} is a symbolic link")
    assert elsewhere.read_text() == "{}"


def test_a_solution_is_not_written_through_a_symbolic_link(out: Path):
    (out.parent / "elsewhere").mkdir()
    (out / "solutions").mkdir()
    (out / "solutions" / "00000").symlink_to(out.parent / "elsewhere")
    with records(out, resume=True) as batch:
        row = batch.add(30, replace(result(True), content=b"motion"), start=None, attempts=1)
    assert (row["status"], row["file"]) == ("not_saved", None)
    assert "is a symbolic link" in row["detail"]
    assert not any((out.parent / "elsewhere").iterdir())
