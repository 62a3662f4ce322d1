"""Families and their parameters; problems, robots and errors that go to other processes and back."""

import copy
import json
import multiprocessing
import pickle
import sys
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_array_equal

import trajopt
from tests.support.command_lines import assert_refused, invoke
from tests.support.refusals import refused_calls
from trajopt import InputError, Problem, TrajoptError
from trajopt.errors import WIDTH, UnsupportedJointError, shown
from trajopt.problem import Parameter, catalogue, families
from trajopt.problem.catalogue import listing
from trajopt.robot.catalogue import _offers
from trajopt_library import robots


def test_an_empty_group_of_problems_is_one_line(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(catalogue, "GROUP", "trajopt.nothing")
    assert_refused(invoke("list"), "no problem families", "trajopt.nothing")


def install(folder: Path, name: str, source: str, group: str = "trajopt.problems") -> None:
    """A package as pip installs it: a module and the metadata of its entry point."""
    (folder / f"{name}.py").write_text(source)
    information = folder / f"{name}-1.dist-info"
    information.mkdir()
    (information / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: 1\n")
    (information / "entry_points.txt").write_text(f"[{group}]\nown = {name}\n")


FOREIGN_FAMILY = """
from trajopt.problem.family import Family
def families():
    return {"%s": Family(name="%s", robot="arm", phases=("go",), summary="", parameters=(), build=dict)}
"""


def test_problems_of_another_package_are_found(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    install(tmp_path, "foreign_problems", FOREIGN_FAMILY % ("reach", "reach"))
    monkeypatch.syspath_prepend(tmp_path)
    names = [problem["name"] for problem in json.loads(invoke("list", "--json").stdout)["problems"]]
    assert "reach" in names
    assert "solo12-jump" in names
    assert names == sorted(names)


def test_a_package_that_cannot_be_loaded_leaves_the_others(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    install(tmp_path, "broken_problems", "import no_such_module")
    monkeypatch.syspath_prepend(tmp_path)
    result = invoke("list", "--json")
    assert result.exit_code == 0
    assert "solo12-jump" in result.stdout
    assert "warning: problems of 'broken_problems' cannot be loaded: " in result.stderr
    assert "broken_problems.py, line 1: ModuleNotFoundError" in result.stderr


def test_a_name_offered_twice_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    install(tmp_path, "same_problems", FOREIGN_FAMILY % ("solo12-jump", "solo12-jump"))
    monkeypatch.syspath_prepend(tmp_path)
    assert_refused(invoke("list"), "'solo12-jump' is offered by both", "same_problems")


@pytest.fixture
def alone(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The folder of a package whose problems are the only ones; the cache is in ``cache``."""
    (tmp_path / "cache").mkdir()
    sys.modules.pop("lone_problems", None)
    install(tmp_path, "lone_problems", FOREIGN_FAMILY % ("reach", "reach"), "trajopt.alone")
    monkeypatch.setattr(catalogue, "GROUP", "trajopt.alone")
    monkeypatch.setenv("TRAJOPT_CACHE_DIR", str(tmp_path / "cache"))
    monkeypatch.syspath_prepend(tmp_path)
    return tmp_path


def listed() -> tuple[list[str], bool]:
    """Names of the listing where no problems are loaded, and whether it is from the cache."""
    sys.modules.pop("lone_problems", None)
    sys.modules.pop("more_problems", None)
    _offers.cache_clear()
    return list(listing()[0]), "lone_problems" not in sys.modules


def test_a_listing_is_kept_until_a_file_is_changed_added_or_removed(alone: Path) -> None:
    assert listed() == (["reach"], False)
    assert listed() == (["reach"], True)
    (alone / "lone_problems.py").write_text(FOREIGN_FAMILY % ("reach-far", "reach-far"))
    assert listed() == (["reach-far"], False)
    (entry,) = (alone / "cache").iterdir()
    entry.write_bytes(entry.read_bytes()[:-1])
    assert listed() == (["reach-far"], False)
    install(alone, "more_problems", FOREIGN_FAMILY % ("push", "push"), "trajopt.alone")
    assert listed() == (["push", "reach-far"], False)
    (alone / "more_problems-1.dist-info" / "entry_points.txt").unlink()
    assert listed() == (["reach-far"], False)
    assert listed() == (["reach-far"], True)


def test_a_listing_with_a_warning_is_not_kept(alone: Path) -> None:
    install(alone, "more_problems", "import no_such_module", "trajopt.alone")
    for _ in range(2):
        with pytest.warns(UserWarning, match="'more_problems' cannot be loaded"):
            assert listed() == (["reach"], False)


def test_why_the_only_package_cannot_be_loaded_is_the_error(alone: Path) -> None:
    (alone / "lone_problems.py").write_text("import no_such_module")
    for find in (families, lambda: catalogue.family("reach")):
        with pytest.raises(TrajoptError, match=r"'lone_problems' cannot .* line 1: ModuleNotFound"):
            find()


SPEED = Parameter(name="speed", default=0.0, unit="m/s", lower=-10.0, upper=10.0, meaning="forward")


@pytest.mark.parametrize(("text", "number"), [("0.8", 0.8), ("80cm", 0.8), ("80 cm/s", 0.8), ("1m/s", 1.0)])
def test_a_value_may_carry_a_unit_that_fits(text: str, number: float) -> None:
    assert SPEED.parse(text) == pytest.approx(number)


@pytest.mark.parametrize("text", ["45deg", "1s", "1m/s/s", "fast"])
def test_a_value_with_the_unit_of_something_else_is_refused(text: str) -> None:
    with pytest.raises(InputError, match=f"speed='{text}' is not a number"):
        SPEED.parse(text)


def test_parameters_of_an_older_file_are_known_by_their_new_names() -> None:
    family = families()["solo12-jump"]
    known = family.of_file({"effort": 2.2, "distance": 0.3, "yaw": None, "lost": 1.0})
    assert known == {"torque_limit": 2.2, "distance": 0.3}


WITH_ROBOT = sorted(name for name, family in families().items() if family.takes_robot)


@pytest.mark.long
@pytest.mark.parametrize("name", WITH_ROBOT)
def test_a_robot_does_what_its_name_does(name: str) -> None:
    named = trajopt.load(name)
    given = trajopt.load(name, robot=robots.load(families()[name].robot))
    assert [type(term) for term in given.terms] == [type(term) for term in named.terms]
    assert given.schedule.names == named.schedule.names
    np.testing.assert_array_equal(given.initial_q, named.initial_q)
    others = [{k: v for k, v in each.parameters.items() if k != "robot"} for each in (given, named)]
    assert others[0] == others[1]


def test_a_robot_of_ones_own_is_the_problems() -> None:
    strong = robots.load("ur5")
    strong = replace(strong, name="strong", torque_limit=2 * strong.torque_limit)
    problem = trajopt.load("arm-reach", robot=strong)
    assert problem.robot is strong
    assert problem.parameters["robot"] == "strong (a Robot)"


def test_what_a_solution_says_of_such_a_robot_is_not_looked_up() -> None:
    problem = trajopt.load("arm-reach", robot=robots.load("ur5"))
    with pytest.raises(InputError, match=r"names the robot 'ur5 \(a Robot\)'.*not run"):
        families()["arm-reach"].of_file(problem.parameters)


test_robots_and_values_that_do_not_fit_a_family_are_refused = refused_calls(
    (lambda: trajopt.load("arm-reach", robot=robots.load("go2")), "'go2' has no tool: it is not an arm"),
    (lambda: trajopt.load("solo12-jump", robot=robots.load("solo12")), "no parameter 'robot'"),
    (lambda: trajopt.load("arm-reach", robot=3), "parameter robot=3; allowed: a name"),
    (lambda: trajopt.load("arm-reach", robot=robots.load("ur5").model), "parameter robot=a Model; allowed"),
    (
        lambda: trajopt.load("arm-reach", duration=robots.load("ur5")),
        "parameter duration=a Robot is not a number",
    ),
)


def test_kind_and_tool_of_a_robot_are_those_of_its_file() -> None:
    for name in robots.names("arm"):
        robot = robots.load(name)
        assert robots.kind(robot) == "arm"
        assert robot.model.existFrame(robots.tool_frame(robot))
    assert robots.kind(robots.load("talos")) == "biped"


class Loud:
    def __repr__(self) -> str:
        raise RuntimeError


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (1.5, "1.5"),
        ("a b", "'a b'"),
        (None, "None"),
        ([1, (2,), "x"], "[1, (2,), 'x']"),
        ({"a": Loud()}, "{'a': a Loud}"),
        (np.float64(2.0), "2.0"),
        (np.array([1.0, np.nan]), "[1.0, nan]"),
        (np.zeros((20, 3)), "an array of shape (20, 3)"),
        (np.zeros(0), "an array of shape (0,)"),
        (Loud(), "a Loud"),
        (Loud, "the class Loud"),
        (Path("a/b"), "'a/b'"),
        (len, "a builtin_function_or_method"),
        (list(range(20)), "[0, 1, 2, 3, 4, 5, 6, 7, ...]"),
    ],
)
def test_values_are_shown(value: Any, text: str) -> None:
    assert shown(value) == text


def test_a_robot_is_a_robot() -> None:
    assert shown([robots.load("ur5")]) == "[a Robot]"


def test_long_and_endless_values_are_cut() -> None:
    endless: list[Any] = []
    endless.append(endless)
    assert shown(endless) == "[[[[...]]]]"
    assert len(shown("x" * 1000)) == WIDTH
    assert "\n" not in shown("a\nb")


# One family for each way in which guesses and terms of the library are written.
FAMILIES = (
    "acrobot", "arm-avoid", "arm-wipe", "biped-step-up", "biped-walk", "hopper-hop", "quadruped-trot",
    "quadruped-stepping-stones", "solo12-flip", "solo12-jump", "solo12-slope", "talos-wall", "humanoid-climb",
)  # fmt: skip
COPIES = {"pickle": lambda thing: pickle.loads(pickle.dumps(thing)), "deepcopy": copy.deepcopy}


def arrays_of(thing: Any, place: str = "", seen: set[int] | None = None) -> Iterator[tuple[str, np.ndarray]]:
    """Arrays of an object and of what it holds, with their places."""
    seen = set() if seen is None else seen
    if id(thing) in seen:
        return
    seen.add(id(thing))
    if isinstance(thing, np.ndarray):
        yield place, thing
    elif isinstance(thing, tuple | list):
        for index, each in enumerate(thing):
            yield from arrays_of(each, f"{place}[{index}]", seen)
    elif isinstance(thing, Mapping):
        for key, each in thing.items():
            yield from arrays_of(each, f"{place}[{key}]", seen)
    elif hasattr(thing, "__dict__") and not isinstance(thing, type):
        for name, each in vars(thing).items():
            yield from arrays_of(each, f"{place}.{name}", seen)


@pytest.mark.parametrize("name", FAMILIES)
@pytest.mark.parametrize("copied", COPIES.values(), ids=COPIES)
def test_problems_are_the_same_again(name: str, copied: Callable[[Problem], Problem]) -> None:
    problem = trajopt.load(name)
    other = copied(problem)
    assert other.schedule.names == problem.schedule.names
    assert dict(other.parameters) == dict(problem.parameters)
    assert other.robot.model == problem.robot.model
    assert [type(term) for term in other.terms] == [type(term) for term in problem.terms]
    for t in np.linspace(0.0, problem.schedule.duration, 4):
        assert_array_equal(other.guess(t), problem.guess(t))
    before = dict(arrays_of(problem))
    for place, array in arrays_of(other):
        if place in before:
            assert_array_equal(array, before[place])
            assert before[place].flags.writeable or not array.flags.writeable, place


@pytest.mark.long
def test_every_problem_can_be_pickled() -> None:
    for name in families():
        assert pickle.loads(pickle.dumps(trajopt.load(name))).name


def test_mappings_are_as_fixed_as_before() -> None:
    problem = pickle.loads(pickle.dumps(trajopt.load("solo12-jump")))
    with pytest.raises(TypeError):
        problem.parameters["distance"] = 1.0
    landing = problem.schedule.phases[-1]
    with pytest.raises(ValueError, match="read-only"):
        next(iter(landing.footholds.values()))[0] = 1.0


def test_what_is_found_when_asked_for_is_not_pickled() -> None:
    robot = trajopt.robot("ur5")
    size = len(pickle.dumps(robot))
    assert robot.mass > 0
    assert len(pickle.dumps(robot)) == size
    assert pickle.loads(pickle.dumps(robot)).mass == robot.mass


@pytest.mark.parametrize(
    "error", [InputError("what", "allowed"), UnsupportedJointError("hip", "spiral", "revolute")]
)
def test_errors_keep_their_text_and_data(error: InputError) -> None:
    other = pickle.loads(pickle.dumps(error))
    assert type(other) is type(error)
    assert str(other) == str(error)
    assert vars(other) == vars(error)


def solve_briefly(problem: Problem) -> trajopt.Solution:
    return trajopt.solve(problem)


@pytest.mark.long
def test_a_pool_of_new_processes_solves_a_problem() -> None:
    problem = trajopt.load("ur5-reach")
    with multiprocessing.get_context("spawn").Pool(1) as pool:
        (solution,) = pool.map(solve_briefly, [problem])
    here = trajopt.solve(problem)
    assert solution.statistics.iterations == here.statistics.iterations
    for name, array in here.arrays.items():
        assert_array_equal(solution.arrays[name], array)
        assert not solution.arrays[name].flags.writeable
