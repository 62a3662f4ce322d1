"""Cases of a batch and the tree of their starts; its folder, journal, index and plot."""

import json
import math
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow
import pyarrow.parquet
import pytest

from tests.support import batch_problems
from tests.support.command_lines import assert_refused, invoke
from tests.support.packages import offered
from tests.support.refusals import assert_refused_in_one_line
from trajopt.study.batch.batch import dataset
from trajopt.study.batch.engine import StartTree
from trajopt.study.batch.records import BatchRecords
from trajopt.study.batch.report import outcomes, plot_failures, regions
from trajopt.study.batch.solved_case import BatchSettings, CaseResult
from trajopt.study.batch.variation import BatchCase, batch_cases, checked_cases

SWING = "t-swing"
# Draws of a sample whose distribution is compared with its formula, and how far its mean may be off: four
# standard deviations of the mean of so many.
DRAWS, OFF = 400, 4.0
package = offered(batch_problems)


def values(*given: Any, **arguments: Any) -> list[dict[str, Any]]:
    return [dict(case.values) for case in batch_cases(*(given or (SWING,)), **arguments)]


def column(found: list[dict[str, Any]], name: str) -> list[Any]:
    return [own[name] for own in found]


# Grids


def test_grids_are_combined_in_order_with_what_holds_for_all():
    found = values(vary=["goal=0:1:3", "cost=torque,acceleration"], values={"duration": "0.5"})
    assert found == [
        {"duration": 0.5, "goal": goal, "cost": cost}
        for goal in (0.0, 0.5, 1.0)
        for cost in ("torque", "acceleration")
    ]


@pytest.mark.parametrize(
    ("text", "numbers"),
    [
        ("goal=10deg:30deg:3", np.radians([10, 20, 30])),
        ("goal=10deg, 0.2", [math.radians(10), 0.2]),
        ("duration=200ms:1:2", [0.2, 1.0]),
        (" goal = -1 : 1 : 2 ", [-1.0, 1.0]),
        ("goal=1:-1:3", [1.0, 0.0, -1.0]),
        ("goal=1:1:1", [1.0]),
    ],
)
def test_grids_have_units(text: str, numbers: Any):
    assert column(values(vary=[text]), text.partition("=")[0].strip()) == pytest.approx(list(numbers))


def test_ends_of_a_grid_are_exact():
    goals = column(values(vary=["goal=-0.1:0.7:9"]), "goal")
    assert (goals[0], goals[-1], len(goals)) == (-0.1, 0.7, 9)


def test_robots_come_before_grids():
    found = values("t-fated", robots=["b", "a"], vary=["number=1,2"])
    assert found == [{"robot": robot, "number": number} for robot in "ba" for number in (1.0, 2.0)]


def test_without_anything_there_is_one_case():
    assert values() == [{}]


# Samples


def test_samples_depend_on_seed_name_and_number_alone():
    sample = ["goal=uniform(0,1)"]
    alone = column(values(sample=sample, count=3, seed=7), "goal")
    assert len(set(alone)) == 3
    assert column(values(sample=sample, count=3, seed=7), "goal") == alone
    assert column(values(sample=sample, count=5, seed=7), "goal")[:3] == alone
    assert column(values(sample=sample, count=3, seed=8), "goal") != alone
    with_others = values(
        sample=["duration=uniform(0.5,1)", *sample], count=3, seed=7, vary=["cost=torque,acceleration"]
    )
    assert column(with_others, "goal") == [*alone, *alone]
    on_robots = values("t-fated", robots=["a", "b"], sample=["number=uniform(0,9)"], count=2)
    assert column(on_robots[:2], "number") == column(on_robots[2:], "number")


def test_two_parameters_of_one_distribution_have_different_samples():
    found = values(sample=["goal=uniform(0.5,1)", "duration=uniform(0.5,1)"], count=3)
    assert not set(column(found, "goal")) & set(column(found, "duration"))


@pytest.mark.parametrize(
    ("text", "least", "most", "mean", "deviation"),
    [
        (
            "uniform(-10deg,20deg)",
            math.radians(-10),
            math.radians(20),
            math.radians(5),
            math.radians(30) / 12**0.5,
        ),
        ("loguniform(0.01,1)", 0.01, 1.0, 0.99 / math.log(100), 0.26),
        ("normal(0.2,0.1)", -1.5, 1.5, 0.2, 0.1),
    ],
)
def test_samples_have_their_distribution(text: str, least: float, most: float, mean: float, deviation: float):
    drawn = np.array(column(values(sample=[f"goal={text}"], count=DRAWS), "goal"))
    assert least <= drawn.min()
    assert drawn.max() <= most
    assert abs(drawn.mean() - mean) < OFF * deviation / DRAWS**0.5


def test_draws_outside_of_a_parameters_range_are_drawn_again():
    drawn = column(values(sample=["duration=normal(0,1)"], count=DRAWS), "duration")
    assert min(drawn) >= 0.1
    assert max(drawn) <= 2.0


# What is refused


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ({"vary": ["goal"]}, "`vary` 'goal' has the wrong form; allowed: NAME=FIRST:LAST:COUNT or NAME=A,B"),
        ({"vary": ["goal="]}, "`vary` 'goal=' has the wrong form"),
        ({"vary": ["=1,2"]}, "`vary` '=1,2' has the wrong form"),
        ({"vary": ["goal=0:1"]}, "`vary` 'goal=0:1' has the wrong form"),
        ({"vary": ["goal=0:1:2:3"]}, "`vary` 'goal=0:1:2:3' has the wrong form"),
        ({"vary": ["goal=0:1:0"]}, "`vary` 'goal=0:1:0' has the wrong form"),
        ({"vary": ["goal=0:1:-2"]}, "`vary` 'goal=0:1:-2' has the wrong form"),
        ({"vary": ["goal=0:1:2.5"]}, "`vary` 'goal=0:1:2.5' has the wrong form"),
        ({"vary": ["goal=0:1:999999999"]}, "`vary` 'goal=0:1:999999999' has the wrong form"),
        ({"vary": ["goal=0:1:1"]}, "`vary` 'goal=0:1:1' has one value, and two ends"),
        ({"vary": ["goal=1:1:2"]}, "`vary` 'goal=1:1:2' has a value twice; allowed: FIRST and LAST apart"),
        ({"vary": ["goal=1,1.0"]}, "`vary` 'goal=1,1.0' has a value twice; allowed: different values"),
        ({"vary": ["goal=0:9:3"]}, "parameter goal is 9; allowed: -1.5 to 1.5 rad"),
        ({"vary": ["goal=1,"]}, "parameter goal='' is not a number; allowed: -1.5 to 1.5 rad"),
        ({"vary": ["goal=nan:1:2"]}, "parameter goal is nan"),
        ({"vary": ["goal=1kg"]}, "parameter goal='1kg' is not a number"),
        ({"vary": ["gaol=1"]}, "t-swing has no parameter 'gaol'; did you mean goal? allowed: "),
        ({"vary": ["cost=1:2:3"]}, "`vary` 'cost=1:2:3': parameter cost is no number; allowed: NAME=A,B"),
        ({"vary": ["cost=torque,speed"]}, "parameter cost='speed'; allowed: acceleration, torque"),
        ({"vary": ["goal=1", "goal=0"]}, "parameter 'goal' is given twice; allowed: once"),
        ({"vary": ["goal=1"], "values": {"goal": "1"}}, "parameter 'goal' is given twice"),
        ({"vary": ["goal=0:1:4000", "duration=0.2:1:4000"]}, "the batch has 16000000 cases; allowed: up to "),
        ({"values": {"goal": "far"}}, "parameter goal='far' is not a number"),
        ({"values": {"gaol": "1"}}, "t-swing has no parameter 'gaol'; did you mean goal?"),
        ({"robots": ["go2"]}, "t-swing has no parameter 'robot'"),
        (
            {"sample": ["goal"], "count": 1},
            "`sample` 'goal' has the wrong form; allowed: NAME=DISTRIBUTION(A,B)",
        ),
        ({"sample": ["goal=uniform(0,1"], "count": 1}, "has the wrong form; allowed: NAME=DISTRIBUTION(A,B)"),
        ({"sample": ["goal=unifrom(0,1)"], "count": 1}, "no distribution 'unifrom'; did you mean uniform?"),
        ({"sample": ["goal=uniform(0)"], "count": 1}, "has the wrong form; allowed: uniform(low,high)"),
        ({"sample": ["goal=uniform(0,x)"], "count": 1}, "has the wrong form; allowed: uniform(low,high)"),
        ({"sample": ["goal=uniform(0,inf)"], "count": 1}, "has the wrong form; allowed: uniform(low,high)"),
        ({"sample": ["goal=uniform(1,0)"], "count": 1}, "is empty; allowed: low < high"),
        ({"sample": ["goal=uniform(0,9)"], "count": 1}, "parameter goal is 9; allowed: -1.5 to 1.5 rad"),
        ({"sample": ["goal=loguniform(0,1)"], "count": 1}, "is empty; allowed: 0 < low < high"),
        (
            {"sample": ["goal=normal(0,0)"], "count": 1},
            "the deviation of `sample` 'goal=normal(0,0)' is 0; allowed: > 0",
        ),
        (
            {"sample": ["goal=normal(90,1)"], "count": 1},
            "gives no value in 1000 draws that is allowed; allowed: -1.5 to 1.5 rad",
        ),
        (
            {"sample": ["cost=uniform(0,1)"], "count": 1},
            "parameter cost is no number; allowed: a parameter that is a number",
        ),
        (
            {"sample": ["gaol=uniform(0,1)"], "count": 1},
            "t-swing has no parameter 'gaol'; did you mean goal?",
        ),
        (
            {"sample": ["goal=uniform(0,1)", "goal=normal(0,1)"], "count": 1},
            "parameter 'goal' is given twice",
        ),
        (
            {"sample": ["goal=uniform(0,1)"]},
            "`count` is 0 with 1 parameters to sample; allowed: `sample` and `count` together",
        ),
        ({"count": 3}, "`count` is 3 with 0 parameters to sample"),
        ({"count": -1}, "count of batch_cases is -1; allowed: "),
        ({"seed": -1}, "seed of batch_cases is -1; allowed: "),
    ],
)
def test_what_is_not_allowed_is_one_line(arguments: dict[str, Any], words: str):
    assert_refused_in_one_line(lambda: batch_cases(SWING, **arguments), words)


def test_other_names_are_one_line():
    assert_refused_in_one_line(lambda: batch_cases("t-swnig"), "'t-swnig'")
    assert_refused_in_one_line(
        lambda: batch_cases("t-fated", robots=["a", "a"]), "`robots` a,a has a value twice"
    )
    assert_refused_in_one_line(lambda: batch_cases("t-fated", robots=["a", ""]), "parameter robot=''")
    assert_refused_in_one_line(
        lambda: batch_cases("t-fated", robots=["a"], vary=["robot=b"]), "parameter 'robot' is given twice"
    )


def test_cases_of_ones_own_are_checked():
    (found,) = checked_cases([BatchCase(problem=SWING, values={"goal": "10deg", "cost": "torque"})])
    assert found.values == {"goal": pytest.approx(math.radians(10)), "cost": "torque"}
    assert found.name == "t-swing goal=0.174533 cost=torque"
    assert_refused_in_one_line(lambda: checked_cases([]), "a batch has no case; allowed: one or more")
    wrong = BatchCase(problem=SWING, values={"gaol": 1})
    assert_refused_in_one_line(lambda: checked_cases([wrong]), "no parameter 'gaol'")
    assert_refused_in_one_line(
        lambda: BatchCase(problem=SWING, values={"goal": True}), "values['goal'] of BatchCase is True"
    )


# The tree of starts


def some_cases() -> list[BatchCase]:
    """Two groups of a grid, one of samples, and one of a single case."""
    return [
        *batch_cases(SWING, vary=["goal=-1:1:7", "duration=0.3:2:9", "cost=torque,acceleration"]),
        *batch_cases(SWING, sample=["goal=uniform(-1,1)"], count=50),
        *batch_cases(SWING, values={"duration": "1"}),
    ]


def group(case: BatchCase) -> tuple[Any, ...]:
    return (*case.values, str(case.values.get("cost")))


def test_each_group_has_a_tree_of_its_own_and_parents_come_first():
    cases = some_cases()
    tree = StartTree(cases)
    assert sorted(tree.order) == list(range(len(cases)))
    place = {index: number for number, index in enumerate(tree.order)}
    roots = [index for index, parent in enumerate(tree.parents) if parent is None]
    assert sorted(group(cases[index]) for index in roots) == sorted({group(case) for case in cases})
    for index, parent in enumerate(tree.parents):
        if parent is not None:
            assert place[parent] < place[index]
            assert group(cases[parent]) == group(cases[index])


def test_a_case_waits_for_about_the_logarithm_of_their_number():
    cases = batch_cases(SWING, vary=["goal=-1:1:25", "duration=0.3:2:40"])
    tree = StartTree(cases)
    assert max(len(tree.ancestors(index)) for index in range(1000)) == 9  # 2^9 - 1 < 1000 < 2^10


def test_nearest_ancestors_come_first_by_their_distance_in_the_ranges():
    cases = batch_cases(SWING, vary=["goal=-1:1:7", "duration=0.3:2:9"])
    tree = StartTree(cases)
    points = np.array([[own.values["goal"] / 2.0, own.values["duration"] / 1.7] for own in cases])
    for index in range(len(cases)):
        found = tree.nearest(index)
        assert sorted(found) == sorted(tree.ancestors(index))
        distances = [float(np.linalg.norm(points[other] - points[index])) for other in found]
        assert distances == pytest.approx(sorted(distances))


def test_a_groups_tree_does_not_depend_on_the_other_groups():
    cases = some_cases()
    whole = StartTree(cases)
    members = [index for index, case in enumerate(cases) if group(case) == group(cases[0])]
    alone = StartTree([cases[index] for index in members])
    assert [whole.parents[index] for index in members] == [
        None if parent is None else members[parent] for parent in alone.parents
    ]


def test_trees_of_the_same_cases_are_the_same():
    first, second = StartTree(some_cases()), StartTree(some_cases())
    assert (first.parents, first.order) == (second.parents, second.order)


def test_equal_cases_and_cases_without_numbers_have_a_tree():
    cases = [BatchCase(problem=SWING, values={"cost": "torque"})] * 5
    tree = StartTree(cases)
    assert sorted(tree.order) == list(range(5))
    assert tree.parents.count(None) == 1


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
