"""`trajopt list` finds motions by name and by robot."""

import json

import pytest

from tests.support.command_lines import assert_refused, invoke
from trajopt.problem.catalogue import families


def _listed(*arguments: str) -> list[str]:
    result = invoke("list", *arguments, "--json")
    assert result.exit_code == 0, result.output
    return [entry["name"] for entry in json.loads(result.output)["problems"]]


def test_patterns_choose_problems() -> None:
    assert _listed("arm-re*", "hopper-hop") == ["arm-reach", "hopper-hop"]


def test_a_robot_chooses_the_problems_it_is_tested_on() -> None:
    names = _listed("--robot", "go2")
    assert "quadruped-trot" in names
    assert all(name.startswith("quadruped-") for name in names)


def test_without_a_problem_each_has_a_line_under_the_robots_of_its_kind() -> None:
    result = invoke("list")
    assert {line.split(":")[0] for line in result.output.splitlines() if line[:1].isupper()} == {
        "Arms", "Quadrupeds", "Bipeds", "Others",
    }  # fmt: skip
    assert max(map(len, result.output.splitlines())) <= 80
    assert "torque_limit" not in result.output
    for name in families():
        assert sum(line.startswith(f"  {name} ") for line in result.output.splitlines()) == 1, name


def test_a_named_problem_is_shown_in_full_unless_brief_is_asked_for() -> None:
    assert "parameter  " in invoke("list", "arm-reach").output
    brief = invoke("list", "arm-reach", "--brief").output
    assert "panda" in brief
    assert "parameter  " not in brief
    assert_refused(invoke("list", "--brief", "--full"), "--brief and --full are both given")


@pytest.mark.parametrize(
    ("arguments", "says"), [(["no-such*"], "'no-such*' is unknown"), (["--robot", "nao"], "'nao' is unknown")]
)
def test_unknown_names_are_refused_with_what_is_known(arguments: list[str], says: str) -> None:
    assert_refused(invoke("list", *arguments), says)
