"""The worked examples of CONTRIBUTING.md: a robot, a term and a problem, as files that are used."""

import importlib.util
import re
from dataclasses import replace
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

import trajopt
from tests.support.problems import reach
from tests.support.repository import ROOT
from tests.support.tumbling import errors_at_the_end, slope
from trajopt.errors import InputError
from trajopt.motion.grid import mesh_of
from trajopt.solvers.drivers import SOLVERS, Solver
from trajopt.solving.solving import solve
from trajopt.transcription.schemes import FAMILIES, collocation, scheme

pytestmark = pytest.mark.long

# The measured order of a scheme is this near to what it says.
SLOPE = 0.3
# Two solvers at a tolerance of 1e-6.
SAME_OPTIMUM = 1e-4
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


def test_the_document_has_an_example_of_each_kind(files: dict[str, Path]) -> None:
    assert set(files) == {"ur10.py", "joint_power.py", "chebyshev.py", "slsqp.py", "arm_raise.py"}


def test_the_robot_reaches(files: dict[str, Path]) -> None:
    solution = trajopt.solve(trajopt.load("arm-reach", robot=str(files["ur10.py"])))
    assert solution.success
    assert solution.description.robot == "ur10"


def test_the_term_saves_power(files: dict[str, Path]) -> None:
    problem = trajopt.load("arm-reach", robot="ur5")
    cost = module(files["joint_power.py"]).JointPowerCost
    with pytest.raises(InputError, match="weight of JointPowerCost is -1"):
        cost(weight=-1.0)
    term = cost(weight=10.0)
    saving = trajopt.solve(replace(problem, terms=(*problem.terms, term)))
    usual = trajopt.solve(problem)
    assert saving.success
    powers = [np.trapezoid(np.sum((s.tau * s.v) ** 2, axis=1), s.t) for s in (saving, usual)]
    assert powers[0] < powers[1]


@pytest.fixture
def chebyshev(files: dict[str, Path], monkeypatch: pytest.MonkeyPatch) -> None:
    """The scheme, entered in the table."""
    monkeypatch.setitem(FAMILIES, "chebyshev", module(files["chebyshev.py"]).CHEBYSHEV)


@pytest.mark.parametrize(("degree", "counts"), [(1, (20, 40, 80)), (3, (10, 20, 40))])
@pytest.mark.usefixtures("chebyshev")
def test_the_scheme_has_its_order(degree: int, counts: tuple[int, ...]) -> None:
    method = scheme(f"chebyshev:{degree}")
    assert method.order == degree + 1
    assert slope(counts, errors_at_the_end(method, counts)) == pytest.approx(method.order, abs=SLOPE)


@pytest.mark.usefixtures("chebyshev")
def test_the_scheme_is_refined() -> None:
    problem = trajopt.load("ur5-reach")
    fixed = trajopt.solve(problem, transcription="chebyshev:2", intervals=4)
    assert (fixed.converged, fixed.success) == (True, False)
    refined = trajopt.solve(replace(problem, default_transcription="chebyshev:2", default_intervals=4))
    assert refined.success
    assert mesh_of(refined).transcription.startswith("chebyshev:")


@pytest.mark.parametrize(
    ("order", "points", "said"),
    [
        (5, [0.0, 0.5, 1.0], "order of scheme 'mine' is 5; allowed: up to 4"),
        (3, [0.5, 0.2, 1.3], "points of scheme 'mine' are 0.5, 0.2, 1.3; allowed: ascending, from 0 to 1"),
        (2, [0.5, 0.5], "points of scheme 'mine' are 0.5, 0.5; allowed: ascending"),
        (1, [], "points of scheme 'mine' are none; allowed: ascending"),
    ],
)
def test_a_scheme_with_mistakes_is_refused(order: int, points: list[float], said: str) -> None:
    with pytest.raises(InputError, match=said):
        collocation("mine", order, np.array(points))


def test_the_solver_finds_the_optimum(files: dict[str, Path], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(files["slsqp.py"].parent)
    monkeypatch.setitem(SOLVERS, "slsqp", Solver(driver="slsqp:solve_slsqp"))
    usual = solve(reach(), transcription="legendre:2", intervals=6)
    solution = solve(reach(), transcription="legendre:2", intervals=6, solver="slsqp")
    assert solution.success
    assert solution.meta["objective"] == pytest.approx(usual.meta["objective"], rel=SAME_OPTIMUM)
    stopped = solve(reach(), intervals=6, solver="slsqp", progress=lambda figures: figures["iteration"] < 2)
    assert stopped.meta["status"] == "interrupted"
    with pytest.raises(InputError, match="slsqp: option 'tol' is unknown; allowed: none"):
        solve(reach(), solver="slsqp", options={"tol": 1.0})


@pytest.mark.parametrize("robot", ["ur5", "panda"])
def test_the_problem_is_solved_on_its_robots(files: dict[str, Path], robot: str) -> None:
    family = module(files["arm_raise.py"]).FAMILY
    assert robot in family.robots
    solution = trajopt.solve(family.load({"robot": robot, "height": "20cm"}))
    assert solution.success
    assert solution.description.problem == "arm-raise"
    assert solution.description.parameters["height"] == 0.2
