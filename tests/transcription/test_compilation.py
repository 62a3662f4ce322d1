"""The cache of compiled point functions: what names an entry, and what may go wrong with it."""

import errno
import os
import subprocess
import sys
import warnings
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from tests.support.problems import hop, hopper, reach
from tests.support.processes import LIMIT, environment
from trajopt.cache import CACHE_VARIABLE
from trajopt.problem.problem import Problem
from trajopt.solving.solving import prepare
from trajopt.terms import FrictionPyramid, TorqueCost
from trajopt.transcription.compilation import compile_points, entry_key
from trajopt.transcription.stage_functions import PointFunction
from trajopt.transcription.transcription import transcribe


@pytest.fixture
def cache(tmp_path, monkeypatch) -> Path:
    """An empty cache folder."""
    folder = tmp_path / "cache"
    monkeypatch.setenv(CACHE_VARIABLE, str(folder))
    return folder


# Code may not grow with the degree of the scheme.
CODE_GROWTH = 1.0


def points_of(problem: Problem, transcription: str = "legendre:2", intervals: int = 6) -> list[PointFunction]:
    groups = transcribe(problem, transcription, intervals).groups
    return list({id(group.point): group.point for group in groups}.values())


def entries(folder: Path) -> set[str]:
    return {entry.name for entry in folder.iterdir() if not entry.name.startswith(".")}


def test_second_time_everything_comes_from_the_cache(cache):
    points = points_of(hop())
    compiled, first = compile_points(points)
    made = entries(cache)
    _, second = compile_points(points)
    assert (first.cached, first.built) == (0, 3 * len(compiled))
    assert (second.cached, second.built) == (first.built, 0)
    assert entries(cache) == made
    assert {entry.split(".")[0] for entry in made} == set(compiled)


def test_landing_after_stance_shares_its_code(cache):
    points = points_of(hop())
    assert {"stance", "flight", "landing"} < {point.name for point in points}
    compiled, _ = compile_points(points)
    assert len(compiled) < len(points)


@pytest.mark.long
def test_parameters_scheme_and_intervals_add_no_entry(cache):
    compile_points(points_of(hop()))
    made = entries(cache)
    terms = [TorqueCost(weight=7.0) if isinstance(term, TorqueCost) else term for term in hop().terms]
    for changed in (
        points_of(hop(terms=tuple(terms))),
        points_of(hop(), "radau:3", 11),
        points_of(hop(), "trapezoidal", 5),
    ):
        _, report = compile_points(changed)
        assert report.built == 0
    assert entries(cache) == made


def test_friction_coefficient_is_a_parameter(cache):
    first, second = (points_of(hop(terms=(FrictionPyramid(friction=mu),))) for mu in (0.4, 0.9))
    assert [entry_key(point) for point in first] == [entry_key(point) for point in second]


def test_another_mass_is_another_entry():
    light, heavy = points_of(hop()), points_of(hop(robot=hopper(mass=3.5)))
    assert entry_key(light[0]) != entry_key(heavy[0])


def test_code_does_not_grow_with_the_degree(cache):
    sizes = [statements(points_of(hop(terms=()), f"legendre:{s}")) for s in (1, 3)]
    assert 0 < sizes[1] <= CODE_GROWTH * sizes[0]


def statements(points: list[PointFunction]) -> int:
    compiled, _ = compile_points(points)
    return sum(
        tape.statements for point in compiled.values() for tape in (point.value, point.first, point.second)
    )


def test_functions_from_the_cache_give_the_same_bits(cache):
    made, read = (prepare(hop(), transcription="legendre:2", intervals=6).nlp.engine for _ in range(2))
    x = np.linspace(-1, 1, made.n_x)
    multipliers = np.cos(np.arange(made.n_g))
    assert_array_equal(read.g(x), made.g(x))
    assert_array_equal(read.jacobian(x), made.jacobian(x))
    assert_array_equal(read.hessian(x, 1.0, multipliers), made.hessian(x, 1.0, multipliers))


def test_other_hessians_take_what_the_exact_one_has_left(cache):
    points = points_of(hop())
    _, exact = compile_points(points)
    _, no_second = compile_points(points, "limited-memory")
    _, gauss_newton = compile_points(points, "gauss-newton")
    assert (no_second.built, no_second.cached) == (0, exact.built * 2 // 3)
    assert (gauss_newton.built, gauss_newton.cached) == (exact.built // 3, exact.built * 2 // 3)


def test_a_cache_folder_that_cannot_be_written_is_said_once_and_done_without(tmp_path, monkeypatch):
    (tmp_path / "file").write_text("not a folder")
    monkeypatch.setenv(CACHE_VARIABLE, str(tmp_path / "file" / "cache"))
    with pytest.warns(UserWarning, match=rf"file/cache cannot be written \(.*{CACHE_VARIABLE}") as told:
        made, report = compile_points(points_of(reach()))
    assert made
    assert report.cached == 0
    assert len(told) == 1
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert compile_points(points_of(reach()))[1].built == report.built


def cut_off(entry: Path) -> None:
    entry.write_bytes(entry.read_bytes()[:-10])


def change_a_byte(entry: Path) -> None:
    text = bytearray(entry.read_bytes())
    text[len(text) // 2] ^= 1
    entry.write_bytes(text)


def empty(entry: Path) -> None:
    entry.write_bytes(b"")


@pytest.mark.parametrize("damage", [cut_off, change_a_byte, empty, Path.unlink])
def test_damaged_entry_is_made_anew(cache, damage):
    points = points_of(reach())
    _, first = compile_points(points)
    damage(cache / sorted(entries(cache))[0])
    _, report = compile_points(points)
    assert (report.built, report.cached) == (1, first.built - 1)
    assert compile_points(points)[1].built == 0


def test_full_disk_is_told_in_one_line_and_leaves_nothing(cache, monkeypatch):
    def full(path: Path, content: bytes) -> int:
        path.touch()
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(Path, "write_bytes", full)
    with pytest.warns(UserWarning, match=r"cannot be written \(No space left on device\)"):
        compile_points(points_of(reach()))
    assert list(cache.iterdir()) == []


COMPILE = """
from tests.support.problems import reach
from trajopt import solve
print(solve(reach(), transcription="legendre:2").statistics.status)
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
        assert out.split() == ["solved"], error
    assert [entry for entry in cache.iterdir() if entry.name.startswith(".")] == []
    assert compile_points(points_of(reach()))[1].built == 0
