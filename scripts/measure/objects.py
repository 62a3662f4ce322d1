"""A block that two arms lift or one arm pushes, planned and checked (docs/discovery.md, Objects)."""

import click
import numpy as np

from scripts.measure.object_check import Judge
from scripts.measure.object_motions import OUT, Plan, Scene, Task
from scripts.measure.shared import head, median, row
from trajopt.study.discovery.modes import LOADED
from trajopt.study.discovery.relaxation import SLACKS

TASKS = {
    "lift": lambda arm: Scene(arm, sides=(-1, 1), goal=(0, 0, 0.3), lifted=True),
    "push": lambda arm: Scene(arm, sides=(-1,), goal=(0.3, 0, 0.1), lifted=False),
}
# Slack down to which a motion must be solved to be a proposal.
PROPOSED = 0.01
ARM, COUNT = "z1", 28  # of what is found
CASES = [(task, arm, count) for task in TASKS for arm in OUT for count in (28, 56)]


def found(task: Task, seed: int) -> tuple[list[int], float | None, Plan]:
    """Iterations of the solves with complementarity, the least slack that was solved, the last motion."""
    start, iterations, reached = task.still(seed), [], None
    for slack in SLACKS:
        plan = task.solve(start, slack)
        iterations.append(plan.iterations)
        if not plan.solved:
            break
        start, reached, last = plan.states, slack, plan
    return iterations, reached, plan if reached is None else last


def first_touch(task: Task, plan: Plan) -> int | None:
    """The first interval in which all fingers bear load, None without one."""
    at = task.scene.model.nq + task.scene.model.nv
    loads = np.array([np.linalg.norm(f.reshape(-1, 3), axis=1) for f in plan.states[:-1, at:-4]])
    loaded = np.flatnonzero((loads > LOADED).all(axis=1))
    return int(loaded[0]) if len(loaded) else None


@click.command("objects")
@click.option("--only", default="", metavar="WORD", help="Tasks or arms with this in their name.")
@click.option("--starts", default=3, show_default=True, help="Of each task; all but the first with noise.")
def objects(only: str, starts: int) -> None:
    """A block that two arms lift or one arm pushes, where it is given when fingers touch."""
    costs = ("task", "arm", "intervals", "variables", "solved", "iterations, median")
    rows = ("block's rows at points, over the weight", "between", "torque over limit", "finger's drift [m]")
    ends = ("least margin of friction", "block alone, end [m]", "open loop, end [m]", "with feedback [m]")
    head(*costs, *rows, *ends)
    for name, arm, count in (case for case in CASES if only in " ".join(map(str, case))):
        task = Task(TASKS[name](arm), count)
        plans = [task.solve(task.still(seed), None) for seed in range(starts)]
        good = [plan for plan in plans if plan.solved]
        judged = [Judge(plan).figures() for plan in good]
        least = {kind: min if kind == "friction" else max for kind in (judged[0] if good else ())}
        worst = [f"{of(figures[kind] for figures in judged):.2g}" for kind, of in least.items()]
        counts = median([plan.iterations for plan in good])
        row(name, arm, count, task.variables, f"{len(good)} of {starts}", f"{counts:.0f}", *worst)


@click.command("objects-found")
@click.option("--starts", default=3, show_default=True, help="Of each task; all but the first with noise.")
def objects_found(starts: int) -> None:
    """The same for one kind of arm with complementarity instead, then with the touch that was found."""
    hard = ("then with hard contacts", "finger's drift [m]", "with feedback [m]")
    head("task", "start", "iterations by slack", "least slack", "touch found [s]", *hard)
    for name in TASKS:
        for seed in range(starts):
            task = Task(TASKS[name](ARM), COUNT)
            iterations, reached, plan = found(task, seed)
            cells = [name, seed, ", ".join(map(str, iterations)), reached or "none"]
            touch = first_touch(task, plan) if reached and reached <= PROPOSED else None
            if not touch:
                row(*cells, "", "no proposal", "", "")
                continue
            task.touched = touch
            plan = task.solve(plan.states, None)
            cells += [f"{touch * task.step:.2f}", f"{plan.status}, {plan.iterations} iterations"]
            judged = Judge(plan).figures() if plan.solved else {}
            row(*cells, *(f"{judged[k]:.2g}" if judged else "" for k in ("drift", "tracked")))
