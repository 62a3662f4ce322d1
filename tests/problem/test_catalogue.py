"""Problem families are found in whatever packages are installed."""

import json
import sys
from pathlib import Path

import pytest
from click.testing import Result

from tests.support.command_lines import assert_refused, invoke
from trajopt.errors import InputError, TrajoptError
from trajopt.problem import catalogue
from trajopt.problem.catalogue import families, listing
from trajopt.problem.family import Parameter
from trajopt.robot.catalogue import _offers


def trajopt(*arguments: str) -> Result:
    return invoke(*arguments)


def test_an_empty_group_of_problems_is_one_line(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(catalogue, "GROUP", "trajopt.nothing")
    assert_refused(trajopt("list"), "no problem families", "trajopt.nothing")


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
