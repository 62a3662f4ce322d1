"""Batches on a Dask cluster: the results of this machine, and what is lost when its parts are killed."""

import json
import os
import signal
import socket
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from tests.support import batch_problems
from tests.support.batch_problems import HELD, runs
from tests.support.command_lines import invoke
from tests.support.packages import offered
from tests.support.processes import TRAJOPT, Running, environment, needs_proc, no_task_process_left, until
from trajopt.study.batch.batch import dataset

pytest.importorskip("distributed")
pytestmark = [pytest.mark.slow, needs_proc]

# Columns that are measured.
TIMES = ["solver_time_s", "case_time_s"]
# The scheduler is in the process of the script, its two workers are processes of their own.
CLUSTER = """
import json, os, sys, time
from distributed import LocalCluster
if __name__ == "__main__":
    settings = {"n_workers": 2, "threads_per_worker": 1, "dashboard_address": "127.0.0.1:0"}
    with LocalCluster(**settings, processes=True, host="127.0.0.1", scheduler_port=0) as cluster:
        pids = [worker.pid for worker in cluster.workers.values()]
        with open(sys.argv[1] + ".part", "w") as stream:
            json.dump({"address": cluster.scheduler_address, "workers": pids}, stream)
        os.rename(sys.argv[1] + ".part", sys.argv[1])
        time.sleep(3600)
"""
package = offered(batch_problems)


class RunningCluster:
    """A cluster: its ``process``, the ``address`` of its scheduler, process ids of its ``workers``."""

    def __init__(self, process: Running, file: Path) -> None:
        known = json.loads(file.read_text())
        self.process, self.address = process, known["address"]
        self.workers: list[int] = known["workers"]


@contextmanager
def running_cluster(package: Path, folder: Path) -> Iterator[RunningCluster]:
    script, file = folder / "cluster.py", folder / "cluster.json"
    script.write_text(CLUSTER)
    log = (folder / "cluster.log").open("w")
    process = Running(
        *(TRAJOPT[0], script, file), env=environment(package, OMP_NUM_THREADS="1"), stdout=log, stderr=log
    )
    with log, process:
        assert until(lambda: file.exists() or process.popen.poll() is not None)
        yield RunningCluster(process, file)
        process.kill()
    assert no_task_process_left(package)


def fates(noted: Path, words: str, numbers: str) -> tuple[str, ...]:
    return ("t-fated", "--robots", f"{noted}", "--vary", f"fate={words}", "--vary", f"number={numbers}")


def test_a_cluster_gives_the_results_of_this_machine(package: Path, noted: Path, tmp_path: Path):
    swings = ("t-swing", "--vary", "goal=0.2,0.4,1.4", "--vary", "duration=0.4,0.8", "--vary")
    groups = (*swings, "cost=acceleration,torque")
    lost = fates(noted, "solved,hang,killed,killed-once,refused,broken", "1,2")
    with running_cluster(package, tmp_path) as cluster:
        for name, arguments in (("swings", groups), ("lost", lost)):
            far, here = tmp_path / f"{name}-far", tmp_path / f"{name}-here"
            result = invoke("batch", *arguments, "--scheduler", cluster.address, "--out", far)
            assert result.exit_code == 1, result.stderr
            for path in noted.iterdir():
                path.unlink()
            assert invoke("batch", *arguments, "--jobs", "2", "--out", here).exit_code == 1
            tables = [dataset(out).index.drop_columns(TIMES).to_pylist() for out in (far, here)]
            assert tables[0] == tables[1]


def running_batch(package: Path, noted: Path, out: Path, address: str) -> Running:
    """A batch on a cluster, in a process of its own, while two of its cases are held."""
    (noted / HELD).touch()
    arguments = (*fates(noted, "solved,hold", "1:6:6"), "--start", "default", "--out", out)
    process = Running(*TRAJOPT, "batch", *arguments, "--scheduler", address, env=environment(package))
    assert until(
        lambda: process.popen.poll() is not None or sum(n.startswith("hold") for n in runs(noted)) > 1
    )
    assert process.popen.poll() is None, process.finish()
    return process


def done(out: Path) -> int:
    return dataset(out).index.num_rows if (out / "batch.json").exists() else 0


def test_a_worker_that_is_killed_loses_no_case(package: Path, noted: Path, tmp_path: Path):
    out = tmp_path / "out"
    with (
        running_cluster(package, tmp_path) as cluster,
        running_batch(package, noted, out, cluster.address) as process,
    ):
        os.kill(cluster.workers[0], signal.SIGKILL)
        (noted / HELD).unlink()
        status, output, errors = process.finish()
    assert (status, errors.count("Traceback")) == (0, 0), errors
    assert output.startswith("12 of 12 cases done: 12 solved\n")
    assert dataset(out).index["status"].to_pylist() == ["solved"] * 12


def test_a_scheduler_that_is_killed_ends_the_batch_in_one_line(package: Path, noted: Path, tmp_path: Path):
    out = tmp_path / "out"
    with (
        running_cluster(package, tmp_path) as cluster,
        running_batch(package, noted, out, cluster.address) as process,
    ):
        before = until(lambda: done(out))
        assert before
        cluster.process.kill()
        status, output, errors = process.finish()
    assert (status, output) == (2, "")
    told = [line for line in errors.splitlines() if " cases, " not in line]
    assert len(told) == 1, errors
    assert told[0].startswith("trajopt: ")
    assert told[0].endswith("--resume")
    counts, kept = runs(noted), dataset(out).index.to_pylist()
    assert len(kept) >= before
    (noted / HELD).unlink()
    again = invoke("batch", "--resume", "--jobs", "2", "--out", out)
    assert again.exit_code == 0, again.stderr
    assert again.stdout.startswith("12 of 12 cases done: 12 solved\n")
    rows = dataset(out).index.to_pylist()
    assert all(row in rows for row in kept)
    names = {f"{row['fate']}-{row['number']:g}" for row in kept}
    assert {name: runs(noted)[name] for name in names} == {name: counts[name] for name in names}


@pytest.mark.parametrize(
    "address", ["tcp://127.0.0.1:{port}", "nonsense", "127.0.0.1", "http://127.0.0.1:{port}", ""]
)
def test_no_scheduler_is_one_line(address: str, package: Path, tmp_path: Path):
    with socket.socket() as held:  # bound, and does not listen: nobody answers
        held.bind(("127.0.0.1", 0))
        place = address.format(port=held.getsockname()[1])
        process = Running(
            *TRAJOPT,
            "batch",
            "t-swing",
            "--scheduler",
            place,
            "--out",
            tmp_path / "out",
            env=environment(package),
        )
        with process:
            status, output, errors = process.finish()
    assert (status, output, errors.count("\n")) == (2, "", 1), errors
    assert errors.startswith("trajopt: no scheduler answers at ")
    assert place in errors
    assert not (tmp_path / "out").exists()
