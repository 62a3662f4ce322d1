"""A first solve waits for no compiler: what is compiled beside it, and what may go wrong with that."""

from __future__ import annotations

import contextlib
import json
import os
import re
import resource
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from tests.support.problems import hop, reach
from tests.support.processes import LIMIT, LOOK, environment, needs_proc, processes, until
from trajopt.problem.problem import Problem
from trajopt.solving.solving import solve
from trajopt.transcription import background, compilation
from trajopt.transcription.background import ask, same_functions
from trajopt.transcription.c_compiler import compiler
from trajopt.transcription.cache_entries import CACHE_VARIABLE, intact
from trajopt.transcription.compilation import BACKGROUND, WAITING_LEVEL, compile_points, entry_key
from trajopt.transcription.compiled_point import load
from trajopt.transcription.transcription import transcribe

SCHEME = "legendre:2"
WORKER = "background_worker"
LIBRARYS = background._WORKER
EAGER = "tests.support.eager_background_worker"
SOLVE = f"""
from tests.support.problems import reach
from trajopt import solve
from trajopt.transcription import background
background._WORKER = "{EAGER}"
solution = solve(reach(), transcription="legendre:2")
print(solution.meta["status"], solution.meta["compile"], solution.meta["functions_pending"])
"""
# A compiler that takes its time: what runs meanwhile can be looked at, and ended.
SLOW = """#!/bin/sh
case $1 in --version) echo slow 1;; *) sleep 1; exec {cc} "$@";; esac
"""
STUCK = """#!/bin/sh
case $1 in --version) echo stuck 1;; *) echo here > "$TMPDIR/../../stuck"; sleep 600;; esac
"""
FAILING = """#!/bin/sh
case $1 in --version) echo failing 1;; *) echo disk is full >&2; exit 3;; esac
"""

pytestmark = pytest.mark.long


@pytest.fixture(autouse=True)
def waiting_for_nothing(waiting_for_compilers, monkeypatch):
    """The default level as it is outside tests, with a worker that is not held up by other processes."""
    monkeypatch.setattr(compilation, "_without_waiting", waiting_for_compilers)
    monkeypatch.setattr(background, "_WORKER", EAGER)


@pytest.fixture
def cache(tmp_path, monkeypatch):
    """An empty cache folder; afterwards no worker is left."""
    folder = tmp_path / "cache"
    monkeypatch.setenv(CACHE_VARIABLE, str(folder))
    yield folder
    kill(*workers(folder), *processes(str(folder), "sleep"))


def workers(folder: Path) -> dict[int, str]:
    """Workers of a cache folder, by number."""
    found = processes(str(folder), WORKER)
    return {number: command for number, command in found.items() if str(folder) in command}


def kill(*numbers: int) -> None:
    for number in numbers:
        with contextlib.suppress(ProcessLookupError):
            os.kill(number, signal.SIGKILL)


def compiled(problem: Problem) -> set[str]:
    """Names of a problem's compiled entries."""
    return {entry_key(point, WAITING_LEVEL) for point in transcribe(problem, SCHEME, None).points.values()}


def all_there(folder: Path, keys: set[str]) -> bool:
    return all(intact(folder / key) for key in keys)


def at_rest(folder: Path) -> bool:
    """Whether no worker is left."""
    return until(lambda: not workers(folder))


def leftovers(folder: Path) -> list[Path]:
    """Files of entries that were not finished, and requests."""
    room = folder / ".background"
    hidden = [file for file in folder.iterdir() if file.name.startswith(".") and file != room]
    return [*hidden, *room.glob("unfinished/*"), *room.glob("requests/*")]


@pytest.fixture
def own_compiler(tmp_path, monkeypatch):
    """A function that makes a script the C compiler until the test ends; ``{cc}`` in it is the real one."""
    found = compiler()
    assert found is not None
    script = tmp_path / "own-cc"

    def use(text: str) -> None:
        script.write_text(text.format(cc=found[0]))
        script.chmod(0o755)
        monkeypatch.setenv("CC", str(script))
        compiler.cache_clear()

    yield use
    compiler.cache_clear()


def started(folder: Path, **options: object) -> subprocess.Popen[str]:
    """A first solve in a process of its own session."""
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "stdin": subprocess.DEVNULL}
    known = environment(**{CACHE_VARIABLE: str(folder)})
    return subprocess.Popen([sys.executable, "-c", SOLVE], text=True, env=known, **{**pipes, **options})


@needs_proc
def test_first_solve_does_not_wait_and_the_next_is_compiled(cache, own_compiler, monkeypatch):
    own_compiler(SLOW)
    monkeypatch.setattr(background, "_WORKER", LIBRARYS)
    keys = compiled(reach())
    first = solve(reach(), transcription=SCHEME)
    assert workers(cache)
    assert first.converged
    assert first.meta["compile"] == "none"
    assert first.meta["compile_time_s"] == 0
    assert first.meta["functions_pending"] == len(keys)
    assert until(lambda: all_there(cache, keys))
    second = solve(reach(), transcription=SCHEME)
    assert second.meta["compile"] == WAITING_LEVEL
    assert second.meta["functions_pending"] == second.meta["functions_compiled"] == 0
    assert at_rest(cache)
    assert {entry.name for entry in cache.iterdir()} == {*keys, ".background"}  # nothing is kept twice
    assert leftovers(cache) == []


def test_background_makes_the_entries_of_the_level_that_waits(cache, tmp_path, monkeypatch):
    keys = compiled(reach())
    solve(reach(), transcription=SCHEME)
    assert until(lambda: all_there(cache, keys))
    monkeypatch.setenv(CACHE_VARIABLE, str(tmp_path / "other"))
    solve(reach(), transcription=SCHEME, compile=WAITING_LEVEL)
    for key in keys:
        one, two = (
            json.loads((folder / key / "entry.json").read_text()) for folder in (cache, tmp_path / "other")
        )
        assert one.pop("files").keys() == two.pop("files").keys()
        assert one == two  # among them the size of the C


def test_waiting_level_takes_graphs_of_the_virtual_machine(cache, monkeypatch):
    points = list(transcribe(reach(), SCHEME, None).points.values())
    compile_points(points, "none")

    monkeypatch.setattr(compilation, "derivatives", lambda point: None)  # none can be asked for
    _, report = compile_points(points, "quick")
    assert report.built == len({entry_key(point, "quick") for point in points})


def test_other_hessians_are_compiled_too(cache):
    points = list(transcribe(hop(), SCHEME, 6).points.values())
    for hessian in ("limited-memory", "gauss-newton"):
        _, report = compile_points(points, BACKGROUND, hessian)
        assert (report.level, report.pending) != (WAITING_LEVEL, 0)
        assert at_rest(cache)
        made, report = compile_points(points, BACKGROUND, hessian)
        assert (report.level, report.pending, report.built) == (WAITING_LEVEL, 0, 0)
        assert set(made) == {entry_key(point, WAITING_LEVEL) for point in points}


def test_points_that_are_compiled_are_used_beside_others(cache):
    points = list(transcribe(hop(), SCHEME, 6).points.values())
    key = entry_key(points[0], WAITING_LEVEL)
    compile_points(points[:1], WAITING_LEVEL)
    made, report = compile_points(points, BACKGROUND)
    assert report.level == "none"
    assert report.pending == len({entry_key(point, WAITING_LEVEL) for point in points}) - 1
    assert made[entry_key(points[0], "none")].sources["value"] == (str(cache / key / "value.so"), "value")
    assert at_rest(cache)


def test_solves_that_belong_together_use_the_same_functions(cache):
    points = list(transcribe(reach(), SCHEME, None).points.values())
    with same_functions():
        assert compile_points(points, BACKGROUND)[1].level == "none"
        assert at_rest(cache)
        with same_functions():
            assert compile_points(points, BACKGROUND)[1].level == "none"
    assert compile_points(points, BACKGROUND)[1].level == WAITING_LEVEL


def test_entry_that_is_removed_after_it_was_looked_at_is_made_again(cache, monkeypatch):
    points = list(transcribe(reach(), SCHEME, None).points.values())
    compile_points(points, "none")
    entry = cache / entry_key(points[0], "none")

    def removed(key, entries, made=None):
        if made is not None and not made:
            shutil.rmtree(entry, ignore_errors=True)
        return load(key, entries, made)

    monkeypatch.setattr(compilation, "load", removed)
    _, report = compile_points(points, "none")
    assert report.built == 1
    assert intact(entry)


@needs_proc
def test_several_first_solves_at_once_start_one_compiler_after_the_other(cache, own_compiler):
    own_compiler(SLOW)
    keys = compiled(reach())
    solves = [started(cache) for _ in range(4)]
    most = 0
    while any(process.poll() is None for process in solves) or workers(cache):
        time.sleep(LOOK)
        commands = processes(str(cache), "-shared").values()
        most = max(most, len({re.search(r"unfinished/(\S+)/", command)[1] for command in commands}))
    assert [process.communicate()[0].split()[0] for process in solves] == ["solved"] * len(solves)
    assert most == 1
    assert all_there(cache, keys)
    assert leftovers(cache) == []


@needs_proc
def test_ctrl_c_in_the_terminal_does_not_reach_the_worker(cache, own_compiler):
    own_compiler(SLOW)
    keys = compiled(reach())
    process = started(cache, start_new_session=True)
    assert until(lambda: workers(cache))
    os.killpg(process.pid, signal.SIGINT)
    process.communicate(timeout=LIMIT)
    assert until(lambda: all_there(cache, keys))


@needs_proc
def test_killed_worker_leaves_a_cache_that_the_next_one_tidies(cache, own_compiler):
    own_compiler(STUCK)
    keys = compiled(reach())
    solve(reach(), transcription=SCHEME)
    assert until(lambda: (cache / ".background" / "stuck").exists())
    kill(*workers(cache), *processes(str(cache), "own-cc"))
    assert list((cache / ".background" / "unfinished").iterdir())
    own_compiler(SLOW)
    assert compiled(reach()) != keys  # another compiler
    keys = compiled(reach())
    solve(reach(), transcription=SCHEME)
    assert at_rest(cache)
    assert all_there(cache, keys)
    assert leftovers(cache) == []


@needs_proc
def test_cache_folder_may_be_removed_while_the_background_compiles(cache, own_compiler):
    own_compiler(SLOW)
    keys = compiled(reach())
    solve(reach(), transcription=SCHEME)
    assert until(lambda: list(cache.glob(".background/unfinished/.*/*.c")))
    shutil.rmtree(cache)
    assert at_rest(cache)
    assert not cache.exists()
    again = solve(reach(), transcription=SCHEME)
    assert again.converged
    assert until(lambda: all_there(cache, keys))


def test_compiler_that_fails_is_told_by_the_next_solve(cache, own_compiler):
    own_compiler(FAILING)
    first = solve(reach(), transcription=SCHEME)
    assert "compile_failure" not in first.meta
    assert at_rest(cache)
    second = solve(reach(), transcription=SCHEME)
    assert second.converged
    assert "disk is full" in second.meta["compile_failure"]
    assert at_rest(cache)
    assert leftovers(cache) == []


def test_full_disk_leaves_no_entry_and_nothing_else(cache):
    points = list(transcribe(reach(), SCHEME, None).points.values())
    requests = [
        compilation._request(entry_key(point, WAITING_LEVEL), point, "exact", "exact") for point in points
    ]
    compile_points(points, "none")
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (2000, limits[1]))  # the worker inherits it
    try:
        ask(cache, requests)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    assert at_rest(cache)
    assert leftovers(cache) == []
    assert not any((cache / request.key).exists() for request in requests)
    assert compile_points(points, BACKGROUND)[1].failure
    assert until(lambda: all_there(cache, compiled(reach())))


def test_without_a_compiler_nothing_is_asked_for(cache, tmp_path, monkeypatch):
    monkeypatch.setenv("PATH", str(tmp_path / "nothing"))
    monkeypatch.delenv("CC", raising=False)
    compiler.cache_clear()
    try:
        with pytest.warns(UserWarning, match="no C compiler found"):
            found = solve(reach(), transcription=SCHEME)
    finally:
        compiler.cache_clear()
    assert found.converged
    assert found.meta["functions_pending"] == 0
    assert not (cache / ".background").exists()
