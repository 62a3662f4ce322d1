"""Tasks in processes of their own: results, losses, limits, cores, what they tell; records and display."""

import os
import pty
import re
import signal
import subprocess
import sys
import threading
import time
from collections import deque
from collections.abc import Callable
from concurrent.futures import CancelledError, Executor, Future, ThreadPoolExecutor
from pathlib import Path
from typing import Any

import pytest

from tests.support.processes import environment, needs_proc
from trajopt import InputError
from trajopt.study.display import TaskDisplay
from trajopt.study.processes import (
    LOST,
    REFUSED,
    TIME_LIMIT,
    LostTaskError,
    ProcessPerTaskExecutor,
    RefusedTaskError,
    TaskError,
    TaskTimeoutError,
    limit_time,
)
from trajopt.study.records import JsonLines
from trajopt.study.tasks import DONE, NOT_RUN, NotRunError, TimedCall, Workers, limited

# Seconds that any task here may take; none takes one unless it hangs.
WAIT = 120.0
# Seconds until a task that hangs is killed.
SHORT = 0.5


def product(a: int, *, b: int) -> int:
    return a * b


def refuse() -> None:
    raise InputError("the goal is on the moon", "allowed: on earth")


def fail() -> None:
    raise RuntimeError("first line\nsecond line")


def run_out_of_memory() -> None:
    raise MemoryError


def end_by(number: int) -> None:
    os.kill(os.getpid(), number)


def leave() -> None:
    """What a library does that ends the process by itself."""
    print("kept for the developer", flush=True)
    os.write(1, b"nothing works\n")
    os._exit(3)


def unpicklable() -> Callable[[], None]:
    return lambda: None


def hang(pids: Path) -> None:
    """Hang in no Python code, beside a process like a compiler's."""
    child = subprocess.Popen(["sleep", "3600"])
    pids.write_text(f"{os.getpid()} {child.pid}")
    limit_time(SHORT)
    threading.Event().wait(WAIT)


def wait(pids: Path) -> None:
    child = subprocess.Popen(["sleep", "3600"])
    pids.write_text(f"{os.getpid()} {child.pid}")
    time.sleep(3600)


def end_server() -> str:
    os.kill(os.getppid(), signal.SIGKILL)
    return "alive"


def surroundings() -> tuple[set[int], str, int]:
    return os.sched_getaffinity(0), os.environ["OMP_NUM_THREADS"], os.getpid()


def gone(pids: Path) -> bool:
    """Whether all processes are, within the time."""
    deadline = time.monotonic() + WAIT
    while time.monotonic() < deadline:
        if not any(_runs(pid) for pid in pids.read_text().split()):
            return True
        time.sleep(0.05)
    return False


def _runs(pid: str) -> bool:
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


def written(file: Path) -> Path:
    deadline = time.monotonic() + WAIT
    while not (file.exists() and file.read_text()):
        assert time.monotonic() < deadline
        time.sleep(0.01)
    return file


# Tasks


def test_it_is_an_executor():
    with ProcessPerTaskExecutor(2) as executor:
        assert isinstance(executor, Executor)
        assert executor.submit(product, 2, b=3).result(WAIT) == 6
        assert list(executor.map(abs, [-1, -2, -3], timeout=WAIT)) == [1, 2, 3]
    with pytest.raises(RuntimeError):
        executor.submit(abs, 1)


@pytest.mark.long
@pytest.mark.parametrize(
    ("function", "arguments", "kind", "text"),
    [
        (refuse, (), RefusedTaskError, "the goal is on the moon; allowed: on earth"),
        (fail, (), LostTaskError, "crash: RuntimeError: first line second line"),
        (run_out_of_memory, (), LostTaskError, "crash: out of memory"),
        (end_by, (signal.SIGSEGV,), LostTaskError, "crash: SIGSEGV"),
        (end_by, (signal.SIGKILL,), LostTaskError, "crash: SIGKILL (out of memory?)"),
        (leave, (), LostTaskError, "crash: exit status 3: nothing works"),
        (unpicklable, (), LostTaskError, "crash: AttributeError: Can't pickle local object"),
    ],
)
def test_a_task_without_result_says_why(
    function: Callable[..., Any], arguments: tuple[Any, ...], kind: type[TaskError], text: str
):
    with ProcessPerTaskExecutor(1) as executor:
        error = executor.submit(function, *arguments).exception(WAIT)
        assert type(error) is kind
        assert str(error).startswith(text)
        assert executor.submit(abs, -1).result(WAIT) == 1


@needs_proc
def test_a_task_that_hangs_ends_with_all_it_started(tmp_path: Path):
    with ProcessPerTaskExecutor(1) as executor:
        with pytest.raises(TaskTimeoutError, match=r"^killed after 0\.5 s$"):
            executor.submit(hang, tmp_path / "pids").result(WAIT)
        assert gone(tmp_path / "pids")


def test_a_limited_task_is_ended():
    with ProcessPerTaskExecutor(1) as executor:
        assert executor.submit(limited, WAIT, abs, -1).result(WAIT) == 1
        with pytest.raises(TaskTimeoutError, match=r"^killed after 0\.5 s$"):
            executor.submit(limited, SHORT, time.sleep, 3600).result(WAIT)


def test_a_limit_here_ends_nothing():
    assert limited(1e-3, time.sleep, 0.05) is None


@pytest.mark.long
def test_tasks_are_pinned_and_have_one_thread_and_a_process_of_their_own():
    cores = sorted(os.sched_getaffinity(0))
    with ProcessPerTaskExecutor(len(cores), cores=cores) as executor:
        found = [executor.submit(surroundings).result(WAIT) for _ in range(3)]
    assert all(len(own) == 1 and own <= set(cores) and threads == "1" for own, threads, _ in found)
    assert len({pid for _, _, pid in found}) == 3
    with ProcessPerTaskExecutor(1) as executor:
        assert executor.submit(surroundings).result(WAIT)[0] == set(cores)


@needs_proc
def test_a_process_does_several_tasks_as_long_as_they_end_well():
    with ProcessPerTaskExecutor(1, most_tasks=3) as executor:
        pids = [executor.submit(os.getpid).result(WAIT) for _ in range(4)]
        assert pids[0] == pids[1] == pids[2] != pids[3]
        assert executor.submit(limited, SHORT, os.getpid).result(WAIT) == pids[3]
        time.sleep(1.5 * SHORT)  # the limit was that of the task, not of the process
        assert executor.submit(os.getpid).result(WAIT) == pids[3]
        assert type(executor.submit(end_by, signal.SIGSEGV).exception(WAIT)) is LostTaskError
        last = executor.submit(os.getpid).result(WAIT)
        assert last != pids[3]
        os.kill(last, signal.SIGKILL)  # while it waits for a task
        while Path(f"/proc/{last}/cmdline").exists() and Path(f"/proc/{last}/cmdline").read_text():
            time.sleep(0.01)
        assert executor.submit(abs, -1).result(WAIT) == 1


@pytest.mark.long
def test_a_server_that_dies_is_replaced():
    with ProcessPerTaskExecutor(1) as executor:
        assert executor.submit(end_server).result(WAIT) == "alive"
        assert executor.submit(abs, -1).result(WAIT) == 1


@needs_proc
def test_an_exception_ends_all_processes(tmp_path: Path):
    futures: list[Future[Any]] = []

    def interrupted() -> None:
        with ProcessPerTaskExecutor(1) as executor:
            futures.append(executor.submit(wait, tmp_path / "pids"))
            futures.append(executor.submit(abs, -1))
            written(tmp_path / "pids")
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        interrupted()
    assert gone(tmp_path / "pids")
    assert isinstance(futures[0].exception(WAIT), LostTaskError)
    with pytest.raises(CancelledError):
        futures[1].result(WAIT)


ORPHANED = """
import sys
from pathlib import Path
from tests.study import test_workers
from trajopt.study.processes import ProcessPerTaskExecutor
if __name__ == "__main__":
    with ProcessPerTaskExecutor(1) as executor:
        executor.submit(test_workers.wait, Path(sys.argv[1])).result()
"""


@needs_proc
def test_no_task_outlives_the_process_that_waits(tmp_path: Path):
    script = tmp_path / "script.py"
    script.write_text(ORPHANED)
    process = subprocess.Popen([sys.executable, str(script), str(tmp_path / "pids")], env=environment())
    written(tmp_path / "pids")
    process.kill()
    process.wait(WAIT)
    assert gone(tmp_path / "pids")


# The loop


def made(name: str) -> TimedCall:
    """A task by what becomes of it."""
    functions = {"refuse": refuse, "fail": fail, "hang": time.sleep, "left out": abs}
    if name == "left out":
        raise NotRunError("not wanted")
    args = (3600,) if name == "hang" else () if name in functions else (-1,)
    limit = SHORT if name == "hang" else WAIT
    return TimedCall(name=name, limit=limit, function=functions.get(name, abs), args=args)


@pytest.mark.parametrize("make", [lambda: ProcessPerTaskExecutor(2), lambda: ThreadPoolExecutor(2)])
def test_every_task_ends_once_and_more_may_follow(make: Callable[[], Executor]):
    waiting, ended = deque(["value", "refuse", "fail", "hang", "left out"]), {}
    with make() as executor:
        workers = Workers(executor=executor, window=lambda: 2)
        for one in workers.run(waiting, made, attempts=2):
            assert one.key not in ended
            ended[one.key] = (one.kind, one.value, one.detail, one.attempts)
            if one.key == "value":
                waiting.append("another")
    assert ended == {
        "value": (DONE, 1, "", 1),
        "another": (DONE, 1, "", 1),
        "refuse": (REFUSED, None, "the goal is on the moon; allowed: on earth", 1),
        "fail": (LOST, None, "crash: RuntimeError: first line second line", 2),
        "hang": (TIME_LIMIT, None, "killed after 0.5 s", 1),
        "left out": (NOT_RUN, None, "not wanted", 1),
    }


def test_an_exception_of_the_check_ends_the_loop():
    def interrupt() -> None:
        raise KeyboardInterrupt

    with ProcessPerTaskExecutor(1) as executor:
        workers = Workers(executor=executor, window=lambda: 1, checks=(interrupt,))
        with pytest.raises(KeyboardInterrupt):
            list(workers.run(deque(["value"]), made))


# Records


def test_lines_are_read_back_but_for_damaged_ones(tmp_path: Path):
    lines = JsonLines(tmp_path / "new" / "lines.jsonl")
    assert lines.open(resume=True) == []
    lines.append({"a": 1})
    with lines.path.open("a") as stream:
        stream.write('[1]\nno json\n{"b": 2}\n{"c": ')  # the machine stopped here
    assert lines.open(resume=True) == [{"a": 1}, {"b": 2}]
    lines.append({"d": 4})
    assert lines.read() == [{"a": 1}, {"b": 2}, {"d": 4}]
    assert lines.open(resume=False) == []
    lines.remove()
    assert lines.read() == []


def test_lines_go_nowhere_without_a_path():
    lines = JsonLines(None)
    assert lines.open(resume=False) == []
    lines.append({"a": 1})
    lines.remove()
    assert lines.read() == []


# Display


def show() -> None:
    with TaskDisplay("all", total=2) as display:
        display.show(["first", "second"])
        display.more()
        display.show(["second"])
        display.finished("first: solved")
        display.note("a note")


def test_without_a_terminal_only_lines_are_shown(capsys: pytest.CaptureFixture[str]):
    show()
    assert capsys.readouterr() == ("", "first: solved\na note\n")


def test_a_terminal_shows_what_runs_and_keeps_the_lines():
    mine, end = pty.openpty()
    code = "from tests.study import test_workers; test_workers.show()"
    known = environment(TERM="xterm", COLUMNS="80")
    subprocess.run([sys.executable, "-c", code], stderr=end, env=known, timeout=WAIT, check=True)
    os.close(end)
    seen = os.read(mine, 65536).decode()
    os.close(mine)
    plain = re.sub(r"\x1b\[[?0-9;]*[A-Za-z]", "", seen)
    assert "all" in plain
    assert "0/2" in plain or "1/3" in plain
    assert "first: solved" in plain
    assert "a note" in plain


UNGUARDED = """
import trajopt
from trajopt.study.discovery import discover
from trajopt.study import batch_cases

{call}
"""


@pytest.mark.parametrize(
    "call",
    [
        'trajopt.batch(batch_cases("hopper-hop", vary=["distance=0.2,0.3"]), "out", jobs=2)',
        'discover(trajopt.load("hopper-hop"), jobs=2, most=1, keep=1)',
    ],
    ids=["batch", "discover"],
)
def test_a_script_without_a_main_guard_ends_in_one_line(call: str, tmp_path: Path) -> None:
    script = tmp_path / "script.py"
    script.write_text(UNGUARDED.format(call=call), encoding="utf-8")
    command = [sys.executable, str(script)]
    ended = subprocess.run(
        command, cwd=tmp_path, env=environment(), capture_output=True, text=True, timeout=WAIT
    )
    assert ended.returncode == 1
    assert len(ended.stderr.splitlines()) == 1
    assert ended.stderr.strip().endswith('allowed: start them below `if __name__ == "__main__":`')
