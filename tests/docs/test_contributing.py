"""The worked examples of CONTRIBUTING.md: a robot, a term and a problem, as files that are used."""

from __future__ import annotations

import importlib.util
import re
from dataclasses import replace
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

import trajopt
from tests.support.repository import ROOT

BLOCK = re.compile(r"^```python ([\w.]+)\n(.*?)^```$", re.DOTALL | re.MULTILINE)


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """The files that the document tells to write, by name."""
    folder = tmp_path_factory.mktemp("contributing")
    found = {}
    for name, text in BLOCK.findall((ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")):
        found[name] = folder / name
        found[name].write_text(text, encoding="utf-8")
    return found


def module(path: Path) -> ModuleType:
    specification = importlib.util.spec_from_file_location(path.stem, path)
    assert specification is not None
    assert specification.loader is not None
    made = importlib.util.module_from_spec(specification)
    specification.loader.exec_module(made)
    return made


def test_the_document_has_a_robot_a_term_and_a_problem(files: dict[str, Path]) -> None:
    assert set(files) == {"ur10.py", "joint_power.py", "arm_raise.py"}


@pytest.mark.long
def test_the_robot_reaches(files: dict[str, Path]) -> None:
    solution = trajopt.solve(trajopt.load("arm-reach", robot=str(files["ur10.py"])))
    assert solution.success
    assert solution.description.robot == "ur10"


@pytest.mark.long
def test_the_term_saves_power(files: dict[str, Path]) -> None:
    problem = trajopt.load("arm-reach", robot="ur5")
    term = module(files["joint_power.py"]).JointPowerCost(weight=10.0)
    saving = trajopt.solve(replace(problem, terms=(*problem.terms, term)))
    usual = trajopt.solve(problem)
    assert saving.success
    powers = [np.trapezoid(np.sum((s.tau * s.v) ** 2, axis=1), s.t) for s in (saving, usual)]
    assert powers[0] < powers[1]


@pytest.mark.long
@pytest.mark.parametrize("robot", ["ur5", "panda"])
def test_the_problem_is_solved_on_its_robots(files: dict[str, Path], robot: str) -> None:
    family = module(files["arm_raise.py"]).FAMILY
    assert robot in family.robots
    solution = trajopt.solve(family.load({"robot": robot, "height": "20cm"}))
    assert solution.success
    assert solution.description.problem == "arm-raise"
    assert solution.description.parameters["height"] == 0.2
