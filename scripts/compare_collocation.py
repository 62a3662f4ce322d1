# /// script
# requires-python = ">=3.11"
# dependencies = ["pin==4.1.0", "numpy>=2", "scipy>=1.14"]
# ///
"""Time to accuracy beside Drake, Dymos and opty: an arm, the acrobot, a cart-pole and a pendulum, in turns.

    uv run scripts/compare_collocation.py            # about eight minutes; a table on stdout
    uv run scripts/compare_collocation.py --write    # also into docs/peers.md, docs/peers/
    uv run scripts/compare_collocation.py --only-document    # run nothing: from docs/peers/collocation.csv

Each side is a process that answers requests: those of the peers in environments that uv makes for them
(`scripts/peers/drake_half.py`, `dymos_half.py`, `opty_half.py`), ours in the project's. One computes at a
time, on one thread. This process integrates the torques of all plans by one model.
"""

import os
import sys
from collections.abc import Iterator, Mapping
from itertools import zip_longest
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT))
os.environ["OMP_NUM_THREADS"] = "1"

from scripts.documents import write_sections  # noqa: E402
from scripts.peers import collocation_report as report  # noqa: E402
from scripts.peers.collocation_report import OURS, Measured  # noqa: E402
from scripts.peers.halves import Half, arguments  # noqa: E402

DOCUMENT = ROOT / "docs" / "peers.md"
TABLE = ROOT / "docs" / "peers" / "collocation.csv"
# Of each task: who solves it, too, how, and on how many intervals.
FEW = (10, 20, 40, 80)
FAST = (20, 40, 80)
SCHEMES = {"Radau": FEW, "GaussLobatto": FEW}
OPTIMISERS = {"SNOPT": FEW, "IPOPT": FEW}
RULES = dict.fromkeys(("DAE, backward euler", "DAE, midpoint", "angle, midpoint"), (50, 200, 750, 3000))
PEERS: dict[str, tuple[str, str, Mapping[str, tuple[int, ...]]]] = {
    "ur5": ("Drake", "drake_half", OPTIMISERS),
    "acrobot": ("Drake", "drake_half", dict.fromkeys(OPTIMISERS, FAST)),
    "cart-pole": ("Dymos", "dymos_half", SCHEMES),
    "pendulum": ("opty", "opty_half", RULES),
}
# Schemes of theirs, and of a higher order.
MESHES: Mapping[str, tuple[int, ...]] = {
    "hermite-simpson": FEW,
    "radau:3": FEW,
    "legendre:2": (10, 20, 40, 80, 160),
    "legendre:3": (5, 10, 20, 40, 80),
    "legendre:4": (5, 10, 20, 40),
}
# A solve that takes longer, s, is not repeated.
LONG = 5.0


def settings(task: str) -> Iterator[Measured]:
    """What is measured of a task, theirs and ours in turns."""
    side, _, methods = PEERS[task]
    theirs, ours = (
        [
            Measured(task=task, side=name, method=method, intervals=count)
            for method, counts in known.items()
            for count in counts
        ]
        for name, known in ((side, methods), (OURS, MESHES))
    )
    for pair in zip_longest(theirs, ours):
        yield from (setting for setting in pair if setting is not None)


def measure(task: str, repeats: int, ours: Half) -> list[Measured]:
    """All settings of a task, in rounds; the first solves each twice, and its first time does not count."""
    from scripts.peers.open_loop import measure as integrated

    described = ours.ask(do="describe", task=task)
    peer = Half(PEERS[task][0], f"uv run {ROOT}/scripts/peers/{PEERS[task][1]}.py")
    peer.ask(do="build", task=described)
    found = list(settings(task))
    for number in range(repeats):
        for m in found:
            if number and m.seconds[0] > LONG:
                continue
            what = {"do": "solve", "method": m.method, "intervals": m.intervals}
            half, about = (ours, {"task": task}) if m.side == OURS else (peer, {})
            plan = half.ask(**what, **about)
            if not number:
                m.build, m.solved = plan["build"], plan["solved"]
                for name, value in integrated(described, plan).items():
                    setattr(m, name, value)
                plan = half.ask(**what, **about) if plan["seconds"] < LONG else plan
            m.seconds.append(plan["seconds"])
            m.processor.append(plan["processor"])
        print(f"{task}: round {number + 1} of {repeats}", file=sys.stderr, flush=True)
    peer.close()
    return sorted(found, key=lambda m: (m.side == OURS, m.method))


def main() -> None:
    """Measure, print, and write."""
    given = arguments(__doc__.splitlines()[0], PEERS)
    if given.only_document:
        found = report.read_csv(TABLE)
    else:
        ours = Half("our half", f"{given.ours} -m scripts.peers.collocation_half")
        tasks = given.tasks or list(PEERS)
        found = [m for task in tasks for m in measure(task, given.repeats, ours)]
    table = "\n".join(report.summary(found))
    print(table)
    if given.write or given.only_document:
        TABLE.parent.mkdir(exist_ok=True)
        report.write_csv(found, TABLE)
        write_sections(DOCUMENT, {"collocation": table})


if __name__ == "__main__":
    main()
