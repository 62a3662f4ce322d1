"""Problem families are found in whatever packages are installed."""

import json
from pathlib import Path

import pytest
from click.testing import Result

from tests.support.command_lines import assert_refused, invoke
from trajopt.errors import InputError
from trajopt.problem import catalogue
from trajopt.problem.catalogue import families
from trajopt.problem.family import Parameter


def trajopt(*arguments: str) -> Result:
    return invoke(*arguments)


def test_an_empty_group_of_problems_is_one_line(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(catalogue, "GROUP", "trajopt.nothing")
    assert_refused(trajopt("list"), "no problem families", "trajopt.nothing")


def install(folder: Path, name: str, source: str) -> None:
    """A package as pip installs it: a module and the metadata of its entry point."""
    (folder / f"{name}.py").write_text(source)
    information = folder / f"{name}-1.dist-info"
    information.mkdir()
    (information / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: 1\n")
    (information / "entry_points.txt").write_text(f"[trajopt.problems]\nown = {name}\n")


FOREIGN_FAMILY = """
from trajopt.problem.family import Family
def families():
    return {"%s": Family(name="%s", robot="arm", phases=("go",), summary="", parameters=(), build=dict)}
"""


def test_problems_of_another_package_are_found(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    install(tmp_path, "foreign_problems", FOREIGN_FAMILY % ("reach", "reach"))
    monkeypatch.syspath_prepend(tmp_path)
    names = [problem["name"] for problem in json.loads(trajopt("list", "--json").stdout)["problems"]]
    assert "reach" in names
    assert "solo12-jump" in names
    assert names == sorted(names)


def test_a_package_that_cannot_be_loaded_leaves_the_others(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    install(tmp_path, "broken_problems", "import no_such_module")
    monkeypatch.syspath_prepend(tmp_path)
    result = trajopt("list", "--json")
    assert result.exit_code == 0
    assert "solo12-jump" in result.stdout
    assert "warning: problems of 'broken_problems' cannot be loaded: " in result.stderr
    assert "broken_problems.py, line 1: ModuleNotFoundError" in result.stderr


def test_a_name_offered_twice_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    install(tmp_path, "same_problems", FOREIGN_FAMILY % ("solo12-jump", "solo12-jump"))
    monkeypatch.syspath_prepend(tmp_path)
    assert_refused(trajopt("list"), "'solo12-jump' is offered by both", "same_problems")


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
