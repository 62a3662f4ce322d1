"""Cases of a batch: grids, samples, what is refused; the tree that says which case starts from which."""

import math
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

from tests.support import batch_problems
from tests.support.packages import installed
from tests.support.refusals import assert_refused_in_one_line
from trajopt.study.batch.engine import StartTree
from trajopt.study.batch.variation import BatchCase, batch_cases, checked_cases

SWING = "t-swing"
# Draws of a sample whose distribution is compared with its formula, and how far its mean may be off: four
# standard deviations of the mean of so many.
DRAWS, OFF = 400, 4.0


@pytest.fixture(scope="module", autouse=True)
def package(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """The tests' own families beside the library's."""
    with installed(batch_problems, tmp_path_factory.mktemp("package")):
        yield


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
