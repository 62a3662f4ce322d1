"""Problems, robots, solutions and errors go to other processes and come back as they were."""

import copy
import multiprocessing
import pickle
from collections.abc import Callable, Iterator, Mapping
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_array_equal

import trajopt
from trajopt.errors import InputError, UnsupportedJointError
from trajopt.problem.catalogue import families
from trajopt.problem.problem import Problem

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
