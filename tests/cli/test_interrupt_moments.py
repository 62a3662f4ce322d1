"""Ctrl-C at many moments of the commands that run long: each ends, says so, and leaves nothing behind."""

import json
import sys
import uuid
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import pytest

from tests.support import suite_problems, sweep_problems
from tests.support.packages import install
from tests.support.problems import hop
from tests.support.processes import LIMIT, environment, needs_proc, processes, run
from trajopt import solve
from trajopt.cache import CACHE_VARIABLE

pytestmark = [pytest.mark.slow, needs_proc]

SMALL = ("hopper-hop", "--intervals", "12")
WATCH = ("solve", "hopper-hop", "--draft", "--output", "x.npz", "--watch")
SWEPT = ("--repeats", "0", "--reference", "0", "--intervals", "4,5")
HOP = "hop.npz"
REPLAY = ("replay", HOP, "--no-open")
SOLVED, UNSOLVED, CANCELLED = 0, 1, 130
ANY = (SOLVED, UNSOLVED, CANCELLED)
# Presses at so many calls of Python, evenly over a command, beside those at moments with names.
SPREAD = 6
NEVER = 10**9
# Seconds that one command may take; the first that hangs ends the test.
EACH = LIMIT / 2


@dataclass(frozen=True)
class Moment:
    """A call of a function of the main thread, or its return, and the exit statuses that are allowed."""

    module: str
    name: str
    statuses: tuple[int, ...]
    event: str = "call"
    count: int = 1


def at(name: str, *statuses: int, event: str = "call", count: int = 1) -> Moment:
    """The moment of ``module:qualified name``."""
    module, _, function = name.partition(":")
    return Moment(module=module, name=function, statuses=statuses, event=event, count=count)


def outcomes(arguments: Sequence[object], moments: Sequence[Moment], folder: Path) -> list[dict]:
    """What became of a command at each moment; no process of any is left."""
    marker = uuid.uuid4().hex
    known = environment(folder, **{"MARKER": marker, CACHE_VARIABLE: str(folder / "cache")})
    asked = {
        "arguments": list(map(str, arguments)),
        "moments": [[one.module, one.name, one.event, one.count] for one in moments],
        "limit": EACH,
    }
    done = run(
        sys.executable, "-m", "tests.support.pressing_ctrl_c",
        cwd=folder, input=json.dumps(asked) + "\n", stdin=None,
        env={name: value for name, value in known.items() if name not in ("DISPLAY", "BROWSER")},
        timeout=2 * LIMIT,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert processes(marker) == {}
    return [json.loads(line) for line in done.stdout.splitlines()]


def assert_ends(arguments: Sequence[object], moments: Sequence[Moment], folder: Path) -> None:
    """Every moment comes, and the command ends with a status that is allowed and without a traceback."""
    results = outcomes(arguments, moments, folder)
    wrong = [
        f"{moment.module}:{moment.name} {moment.event} {moment.count}: {one['status']}, {one['seen'][-500:]}"
        for moment, one in zip(moments, results, strict=False)
        if one["status"] not in moment.statuses or "Traceback" in one["seen"] or "ignored" in one["seen"]
    ]
    assert wrong == []
    assert [bool(one["calls"]) for one in results] == [True] * len(moments), [one.name for one in moments]


def spread(arguments: Sequence[object], folder: Path) -> list[Moment]:
    """`SPREAD` calls, evenly over a command that is left to itself."""
    (alone,) = outcomes(arguments, [Moment("", "", ANY, count=NEVER)], folder)
    assert alone["status"] == SOLVED, alone["seen"][-500:]
    return [Moment("", "", ANY, count=(2 * k + 1) * alone["calls"] // (2 * SPREAD)) for k in range(SPREAD)]


COMMANDS: dict[str, tuple[tuple[object, ...], list[Moment]]] = {
    "solve --watch, before": (
        WATCH,
        [
            at("solve:solve_command", CANCELLED),
            at("show:_started", CANCELLED),
            at("viewer:Viewer.__init__", CANCELLED, event="return"),
            at("panel:ConvergencePanel.__enter__", CANCELLED),
            at("transcription:transcribe", CANCELLED),
            at("viewer:Viewer.flush", CANCELLED),
        ],
    ),
    "solve --watch, while": (
        WATCH,
        [
            at("progress:SolveControl.__call__", CANCELLED),
            at("progress:SolveControl.__call__", UNSOLVED, count=3),
            at("extraction:extract", *ANY),
            at("progress:SolveControl.settle", SOLVED),
            at("panel:ConvergencePanel.__exit__", CANCELLED, event="return"),
        ],
    ),
    "solve --watch, after": (
        WATCH,
        [
            at("solve:_checked", CANCELLED),
            at("viewer:Viewer.show", SOLVED),
            at("viewer:Viewer.flush", SOLVED, count=2),
            at("viewer:Viewer.wait", SOLVED),
        ],
    ),
    "solve while functions are compiled": (
        ("solve", *SMALL, "--hessian", "gauss-newton", "--output", "x.npz"),
        [
            at("compilation:_Compiler._tape", CANCELLED),
            at("compilation:_Compiler._tape", CANCELLED, count=3),
            at("cache:write_entry", CANCELLED),
        ],
    ),
    "continue": (
        ("continue", *SMALL, "--vary", "distance=0.1:0.2:2", "--output-dir", "out"),
        [
            at("progress:SolveControl.__call__", CANCELLED, count=2),
            at("solving:prepare", CANCELLED, count=2),
            at("solution:Solution.save", CANCELLED),
        ],
    ),
    "replay": (
        REPLAY,
        [
            at("show:_started", CANCELLED),
            at("show:LiveWindow.show", CANCELLED),
            at("show:replay", CANCELLED, event="return"),
            at("show:serve", SOLVED),
            at("show:LiveWindow.ended", SOLVED, count=2),
        ],
    ),
    "suite": (
        ("bench", "suite", "--problems", "t-reach,t-hanging", "--jobs", "2"),
        [
            at("engine:run_suite", CANCELLED),
            at("tasks:Workers.run", CANCELLED, event="return"),
            at("engine:SuiteRecords.add", CANCELLED),
        ],
    ),
    "sweep": (
        ("bench", "sweep", "s-reach", *SWEPT, "--output-dir", "swept"),
        [
            at("processes:ProcessPerTaskExecutor.submit", CANCELLED),
            at("records:SweepRecords.add", CANCELLED, event="return"),
            at("processes:ProcessPerTaskExecutor.__exit__", SOLVED, count=2),
        ],
    ),
}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a solution and the tests' own families, in which the commands run."""
    place = tmp_path_factory.mktemp("moments")
    install(suite_problems, place)
    install(sweep_problems, place)
    solve(hop(), intervals=8).save(place / HOP)
    return place


@pytest.mark.parametrize("name", COMMANDS)
def test_ctrl_c_ends_a_command_at_every_moment(name: str, folder: Path) -> None:
    assert_ends(*COMMANDS[name], folder)
    assert [path.name for path in folder.rglob(".*")] == []  # half-written files, unfinished compilations


@pytest.mark.parametrize("arguments", [WATCH, REPLAY], ids=["solve", "replay"])
def test_ctrl_c_ends_a_command_wherever_it_is(arguments: tuple[str, ...], folder: Path) -> None:
    assert_ends(arguments, spread(arguments, folder), folder)
