"""`trajopt list` finds motions by name and by robot."""

from __future__ import annotations

import json

import pytest

from tests.support.command_lines import assert_refused, invoke


def _listed(*arguments: str) -> list[str]:
    result = invoke("list", *arguments, "--json")
    assert result.exit_code == 0, result.output
    return [entry["name"] for entry in json.loads(result.output)["problems"]]


def test_patterns_choose_problems() -> None:
    assert _listed("arm-re*", "hopper-hop") == ["arm-reach", "hopper-hop"]


def test_a_robot_chooses_the_problems_it_is_tested_on() -> None:
    found = _listed("--robot", "go2")
    assert "quadruped-trot" in found
    assert all(name.startswith("quadruped-") for name in found)


def test_brief_is_one_table_of_names_robots_and_summaries() -> None:
    result = invoke("list", "arm-reach", "--brief")
    assert "panda" in result.output
    assert "parameter" not in result.output


@pytest.mark.parametrize(
    ("arguments", "says"), [(["no-such*"], "'no-such*' is unknown"), (["--robot", "nao"], "'nao' is unknown")]
)
def test_unknown_names_are_refused_with_what_is_known(arguments: list[str], says: str) -> None:
    assert_refused(invoke("list", *arguments), says)
