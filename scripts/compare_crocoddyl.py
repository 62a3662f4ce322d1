# /// script
# requires-python = ">=3.11"
# dependencies = [
#     "crocoddyl==3.2.1",
#     "pin==4.0.0",
#     "mim-solvers==0.3.0",
#     "example-robot-data==5.0.0",
#     "numpy>=2",
#     "matplotlib>=3.9",
# ]
# ///
"""Time to accuracy beside Crocoddyl: its five gaits of ANYmal, and a jump of Solo12, solved by both in turns.

    uv run scripts/compare_crocoddyl.py            # about 15 minutes; tables on stdout
    uv run scripts/compare_crocoddyl.py --write    # also into docs/peers.md, docs/peers/
    uv run scripts/compare_crocoddyl.py --only-document    # run nothing: from docs/peers/crocoddyl.csv

uv makes an environment with Crocoddyl for this script alone; ours runs beside it in the project's own
environment, as a process that answers requests (`scripts/peers/serve.py`). One of both computes at a time,
on one thread unless said. A time is that of the solver: problems are built, and functions compiled, before.
"""

import os
import sys
from collections.abc import Iterator
from itertools import zip_longest
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT))
os.environ["OMP_NUM_THREADS"] = "1"  # before Crocoddyl loads OpenMP; problems state their own number

from scripts.documents import write_sections  # noqa: E402
from scripts.peers import crocoddyl_half as theirs  # noqa: E402
from scripts.peers import report  # noqa: E402
from scripts.peers.halves import Half, arguments  # noqa: E402
from scripts.peers.report import CROCODDYL, EXAMPLE, MUMPS, OURS, STAGES, TWO, Measured, Setting  # noqa: E402
from scripts.peers.tasks import SOLO_JUMP, TASKS  # noqa: E402

DOCUMENT = ROOT / "docs" / "peers.md"
FOLDER = ROOT / "docs" / "peers"
STEPS = (20.0, 10.0, 5.0, 2.5)
MESHES = {
    "legendre:1": (4, 8),
    "legendre:2": (2, 3, 4, 8),
    "legendre:3": (2, 3, 4, 5, 6),
    "legendre:4": (2, 3, 4),
}
# Meshes solved with MUMPS, too, and schemes solved on two threads, too.
BOTH = (("legendre:3", 4), ("legendre:4", 3))
ACCURATE = ("legendre:3", "legendre:4")
# Most iterations, of the examples and of the jump of Solo12.
MOST, MOST_OF_SOLO = 100, 1000
# A solve that takes longer, s, is not repeated.
LONG = 5.0


class Ours(Half):
    """Our half, a process that answers requests."""

    def __init__(self, command: str) -> None:
        super().__init__("our half", f"{command} -m scripts.peers.serve")

    def measure(self, measured: Measured) -> None:
        """Solve once; after the first time, which warms up, measure the errors, too."""
        s = measured.setting
        what = {
            "task": s.task,
            "scheme": s.method,
            "intervals": int(s.size),
            "linear_solver": MUMPS if s.detail == MUMPS else STAGES,
            "threads": 2 if s.detail == TWO else 1,
        }
        if not measured.seconds:
            self.ask(do="solve", **what)
        found = self.ask(do="solve", **what)
        measured.seconds.append(found["seconds"])
        measured.iterations, measured.solved = found["iterations"], found["solved"]
        if len(measured.seconds) == 1:
            for name, value in self.ask(do="open-loop", **what).items():
                setattr(measured, name, value)


def measure_theirs(measured: Measured) -> None:
    """Solve once; the first time, measure the errors, too."""
    s, task = measured.setting, TASKS[measured.setting.task]
    problem = theirs.build(task, s.size / 1000)
    most = MOST_OF_SOLO if task is SOLO_JUMP else MOST
    found = theirs.solve(problem, s.method, int(s.detail), most)
    measured.seconds.append(found.seconds)
    measured.iterations, measured.solved = found.iterations, found.converged
    if len(measured.seconds) == 1:
        for name, value in theirs.errors(problem, found).items():
            setattr(measured, name, value)


def settings(task: str) -> Iterator[Setting]:
    """What is measured of a task, theirs and ours in turns."""
    few, many = {"task": task, "side": CROCODDYL}, {"task": task, "side": OURS}
    methods = ("FDDP", "BoxFDDP", "mim SQP") if TASKS[task] is SOLO_JUMP else ("FDDP", "mim SQP")
    steps = STEPS[1:2] if TASKS[task] is SOLO_JUMP else STEPS
    known = [Setting(**few, method=EXAMPLE, size=step, detail="1") for step in steps]
    known += [Setting(**few, method=method, size=STEPS[1], detail="1") for method in methods[1:]]
    known += [
        Setting(**few, method=EXAMPLE, size=STEPS[1], detail=f"{threads}")
        for threads in range(2, (os.cpu_count() or 1) + 1)
        if TASKS[task] is not SOLO_JUMP
    ]
    own = [
        Setting(**many, method=scheme, size=count, detail=detail)
        for scheme, counts in MESHES.items()
        for count in counts
        for detail in (STAGES, TWO, MUMPS)
        if detail == STAGES or (scheme in ACCURATE and (detail == TWO or (scheme, count) in BOTH))
    ]
    for pair in zip_longest(own, known):
        yield from (setting for setting in pair if setting is not None)


def measure(tasks: list[str], repeats: int, command: str) -> list[Measured]:
    """All settings of these tasks, in rounds."""
    ours = Ours(command)
    for task in tasks:
        theirs.adopt(TASKS[task], ours.ask(do="describe", task=task))
    found = [Measured(setting=setting) for task in tasks for setting in settings(task)]
    for number in range(repeats):
        for measured in found:
            if number and measured.seconds[0] > LONG:
                continue
            if measured.setting.side == OURS:
                ours.measure(measured)
            else:
                measure_theirs(measured)
        print(f"round {number + 1} of {repeats}", file=sys.stderr, flush=True)
    return found


def main() -> None:
    """Measure, print, and write."""
    given = arguments(__doc__.splitlines()[0], TASKS)
    tasks = given.tasks or list(TASKS)
    table = FOLDER / "crocoddyl.csv"
    found = report.read_csv(table) if given.only_document else measure(tasks, given.repeats, given.ours)
    parts = {"summary": report.summary, "knots": report.knots}
    tables = {marker: "\n".join(lines(found, tasks)) for marker, lines in parts.items()}
    print("\n\n".join(tables.values()))
    if given.write or given.only_document:
        FOLDER.mkdir(exist_ok=True)
        report.write_csv(found, table)
        report.draw(found, tasks, FOLDER / "crocoddyl.png")
        write_sections(DOCUMENT, tables)


if __name__ == "__main__":
    main()
