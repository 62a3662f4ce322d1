"""The cache of compiled point functions: what names an entry, and what may go wrong with it."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose

from tests.support.problems import hop, hopper, reach
from tests.support.processes import LIMIT, environment
from trajopt.errors import InputError, TrajoptError
from trajopt.problem.problem import Problem
from trajopt.solving.solving import prepare, solve
from trajopt.terms import FrictionPyramid, TorqueCost
from trajopt.transcription.c_compiler import FLAGS, compiler
from trajopt.transcription.cache_entries import CACHE_VARIABLE
from trajopt.transcription.compilation import compile_points, effective_level, entry_key
from trajopt.transcription.compiled_point import CompiledPoint
from trajopt.transcription.stage_functions import PointFunction
from trajopt.transcription.transcription import transcribe

# Virtual machine and -O1 evaluate one graph in one order, entries up to 1e3.
SAME = {"rtol": 1e-12, "atol": 1e-12}
# Code may not grow with the degree of the scheme; it is the same to the byte today.
CODE_GROWTH = 1.5


@pytest.fixture
def cache(tmp_path, monkeypatch) -> Path:
    """An empty cache folder."""
    folder = tmp_path / "cache"
    monkeypatch.setenv(CACHE_VARIABLE, str(folder))
    return folder


@pytest.fixture
def no_compiler(tmp_path, monkeypatch):
    """A machine without a C compiler."""
    empty = tmp_path / "bin"
    empty.mkdir()
    monkeypatch.setenv("PATH", str(empty))
    monkeypatch.delenv("CC", raising=False)
    compiler.cache_clear()
    yield
    compiler.cache_clear()


def points_of(problem: Problem, transcription: str = "legendre:2", intervals: int = 6) -> list[PointFunction]:
    groups = transcribe(problem, transcription, intervals).groups
    return list({id(group.point): group.point for group in groups}.values())


def entries(folder: Path) -> set[str]:
    return {entry.name for entry in folder.iterdir() if not entry.name.startswith(".")}


def numbers(problem: Problem, level: str) -> list[np.ndarray]:
    made = prepare(problem, transcription="legendre:1", intervals=5, compile=level)
    x = made.guess + 0.1
    multipliers = np.linspace(-1, 1, made.transcription.n_rows)
    nlp = made.nlp.engine
    return [
        np.atleast_1d(nlp.f(x)),
        nlp.g(x),
        nlp.gradient(x),
        nlp.jacobian(x),
        nlp.hessian(x, 1.0, multipliers),
    ]


@pytest.mark.parametrize("level", ["quick", "fast"])
def test_compiled_levels_give_the_numbers_of_the_virtual_machine(level, cache):
    problem = reach(gravity=True, terms=(TorqueCost(weight=1.0),))
    for one, two in zip(numbers(problem, "none"), numbers(problem, level), strict=True):
        assert_allclose(one, two, **SAME)


def test_compiled_code_leaves_the_arithmetic_of_its_process_alone(cache):
    numbers(reach(gravity=True, terms=(TorqueCost(weight=1.0),)), "fast")
    smallest = np.nextafter(np.zeros(8), 1.0)
    assert np.all(smallest * np.ones(8) > 0)  # subnormal numbers are not flushed to zero


def test_second_time_everything_comes_from_the_cache(cache):
    points = points_of(hop())
    _, first = compile_points(points, "none")
    made = entries(cache)
    compiled, second = compile_points(points, "none")
    assert (first.cached, first.built) == (0, len(made))
    assert (second.cached, second.built) == (len(made), 0)
    assert entries(cache) == set(compiled) == made


def test_landing_after_stance_shares_its_code(cache):
    points = points_of(hop())
    assert {"stance", "flight", "landing"} < {point.name for point in points}
    compiled, _ = compile_points(points, "none")
    assert len(compiled) < len(points)


@pytest.mark.long
def test_parameters_scheme_and_intervals_add_no_entry(cache):
    compile_points(points_of(hop()), "none")
    made = entries(cache)
    terms = [TorqueCost(weight=7.0) if isinstance(term, TorqueCost) else term for term in hop().terms]
    for changed in (
        points_of(hop(terms=tuple(terms))),
        points_of(hop(), "radau:3", 11),
        points_of(hop(), "trapezoidal", 5),
    ):
        _, report = compile_points(changed, "none")
        assert report.built == 0
    assert entries(cache) == made


def test_friction_coefficient_is_a_parameter(cache):
    first, second = (points_of(hop(terms=(FrictionPyramid(friction=mu),))) for mu in (0.4, 0.9))
    assert [entry_key(point, "none") for point in first] == [entry_key(point, "none") for point in second]


def test_another_mass_and_another_level_are_other_entries(cache):
    light, heavy = points_of(hop()), points_of(hop(robot=hopper(mass=3.5)))
    assert entry_key(light[0], "none") != entry_key(heavy[0], "none")
    assert len({entry_key(light[0], level) for level in FLAGS}) == 3


def code_size(compiled: dict[str, CompiledPoint]) -> int:
    return sum(point.c_bytes for point in compiled.values())


@pytest.mark.slow
def test_code_does_not_grow_with_the_degree(cache):
    sizes = [code_size(compile_points(points_of(hop(terms=()), f"legendre:{s}"), "quick")[0]) for s in (1, 3)]
    assert 0 < sizes[1] <= CODE_GROWTH * sizes[0]


def test_without_a_compiler_the_virtual_machine_solves_with_a_warning(cache, no_compiler):
    with pytest.warns(UserWarning, match="no C compiler found"):
        solution = solve(reach(), transcription="legendre:2", compile="quick")
    assert solution.converged
    assert solution.meta["compile"] == "none"


def test_compiler_of_the_environment_is_preferred(monkeypatch):
    compiler.cache_clear()
    found = compiler()
    monkeypatch.setenv("CC", "gcc" if found and "cc" in found[0] else "cc")
    compiler.cache_clear()
    preferred = compiler()
    compiler.cache_clear()
    assert preferred is not None
    assert Path(preferred[0]).name == os.environ["CC"]


def test_unknown_level_is_refused_with_the_list():
    with pytest.raises(
        InputError, match="unknown compile level 'O3'; allowed: background, none, quick, fast"
    ):
        effective_level("O3")


def test_cache_folder_that_cannot_be_written_is_refused_in_one_line(tmp_path, monkeypatch):
    (tmp_path / "file").write_text("not a folder")
    monkeypatch.setenv(CACHE_VARIABLE, str(tmp_path / "file" / "cache"))
    with pytest.raises(InputError, match=f"cannot write the cache folder .*set {CACHE_VARIABLE}") as refused:
        compile_points(points_of(reach()), "none")
    assert "\n" not in str(refused.value)


def test_failing_compiler_is_told_in_one_line_and_leaves_nothing(cache, tmp_path, monkeypatch):
    broken = tmp_path / "broken-cc"
    broken.write_text(
        "#!/bin/sh\ncase $1 in --version) echo broken 1;; *) echo disk is full >&2; exit 3;; esac\n"
    )
    broken.chmod(0o755)
    monkeypatch.setenv("CC", str(broken))
    compiler.cache_clear()
    try:
        with pytest.raises(TrajoptError, match="disk is full; try --compile none"):
            compile_points(points_of(reach()), "quick")
    finally:
        compiler.cache_clear()
    assert list(cache.iterdir()) == []


def damage_library(entry: Path) -> None:
    library = entry / "first.so"
    library.write_bytes(library.read_bytes()[:5000])


def damage_description(entry: Path) -> None:
    (entry / "entry.json").write_text('{"c_bytes": ')


def lose_file(entry: Path) -> None:
    (entry / "value.so").unlink()


@pytest.mark.parametrize("damage", [damage_library, damage_description, lose_file])
def test_damaged_entry_is_made_anew(cache, damage):
    points = points_of(reach())
    compiled, _ = compile_points(points, "quick")
    key = next(iter(compiled))
    damage(cache / key)
    again, report = compile_points(points, "quick")
    assert (report.built, report.cached) == (1, len(compiled) - 1)
    assert set(again) == entries(cache)
    assert compile_points(points, "quick")[1].built == 0
    assert [entry for entry in cache.iterdir() if entry.name.startswith(".")] == []


COMPILE = """
from tests.support.problems import reach
from trajopt import solve
solution = solve(reach(), transcription="legendre:2", compile="quick")
print(solution.meta["status"], solution.meta["compile"])
"""


@pytest.mark.long
def test_two_processes_may_fill_an_empty_cache_at_once(cache):
    known = environment(**{CACHE_VARIABLE: str(cache)})
    command = [sys.executable, "-c", COMPILE]
    processes = [
        subprocess.Popen(command, env=known, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
        for _ in range(2)
    ]
    for process in processes:
        out, error = process.communicate(timeout=LIMIT)
        assert out.split() == ["solved", "quick"], error
    assert [entry for entry in cache.iterdir() if entry.name.startswith(".")] == []
    assert compile_points(points_of(reach()), "quick")[1].built == 0
