"""Problems of a robot that is given as an object, and what their parameters say of it."""

from dataclasses import replace

import numpy as np
import pytest

import trajopt
from trajopt.errors import InputError
from trajopt.problem.catalogue import families
from trajopt_library import robots

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


def test_a_robot_that_does_not_suit_is_named() -> None:
    with pytest.raises(InputError, match="'go2' has no tool: it is not an arm"):
        trajopt.load("arm-reach", robot=robots.load("go2"))
    with pytest.raises(InputError, match="no parameter 'robot'"):
        trajopt.load("solo12-jump", robot=robots.load("solo12"))
    with pytest.raises(InputError, match="parameter robot=3; allowed: a name"):
        trajopt.load("arm-reach", robot=3)


def test_other_objects_are_named_by_their_kind() -> None:
    with pytest.raises(InputError, match="parameter robot=a Model; allowed"):
        trajopt.load("arm-reach", robot=robots.load("ur5").model)
    with pytest.raises(InputError, match="parameter duration=a Robot is not a number"):
        trajopt.load("arm-reach", duration=robots.load("ur5"))


def test_kind_and_tool_of_a_robot_are_those_of_its_file() -> None:
    for name in robots.names("arm"):
        robot = robots.load(name)
        assert robots.kind(robot) == "arm"
        assert robot.model.existFrame(robots.tool_frame(robot))
    assert robots.kind(robots.load("talos")) == "biped"
