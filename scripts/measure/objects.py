"""A block that two arms lift or one arm pushes, planned and checked (docs/discovery.md, Objects)."""

import click
import numpy as np

from scripts.measure.object_check import Judge
from scripts.measure.object_motions import OUT, Plan, Scene, Task
from scripts.measure.shared import head, median, row
from trajopt.discovery.modes import LOADED
from trajopt.discovery.relaxation import SLACKS

TASKS = {
    "lift": lambda arm: Scene(arm, sides=(-1, 1), goal=(0, 0, 0.3), lifted=True),
    "push": lambda arm: Scene(arm, sides=(-1,), goal=(0.3, 0, 0.1), lifted=False),
}
# Slack down to which a motion must be solved to be a proposal.
PROPOSED = 0.01
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
@click.option(
    "--starts", default=3, show_default=True, help="Starts of each task; all but the first with noise."
)
def objects(only: str, starts: int) -> None:
    """A block that two arms lift or one arm pushes: with a given touch, and with complementarity."""
    chosen = [case for case in CASES if only in " ".join(map(str, case))]
    costs = ("task", "arm", "intervals", "variables", "solved", "iterations, median")
    rows = ("block's rows at points, over the weight", "between", "torque over limit", "finger's drift [m]")
    ends = (
        "friction, least margin over the weight",
        "block alone, end [m]",
        "open loop, end [m]",
        "with feedback [m]",
    )
    head(*costs, *rows, *ends)
    for name, arm, count in chosen:
        task = Task(TASKS[name](arm), count)
        plans = [task.solve(task.still(seed), None) for seed in range(starts)]
        good = [plan for plan in plans if plan.solved]
        judged = [Judge(plan).figures() for plan in good]
        worst = (
            [f"{(min if k == 'friction' else max)(j[k] for j in judged):.2g}" for k in judged[0]]
            if good
            else []
        )
        counts = median([plan.iterations for plan in good])
        row(name, arm, count, task.variables, f"{len(good)} of {starts}", f"{counts:.0f}", *worst)
    click.echo()
    head("task", "start", "iterations by slack", "least slack", "touch found [s]", "then with hard contacts")
    for name, arm, count in (case for case in chosen if case[1] == "z1" and case[2] == 28):
        task = Task(TASKS[name](arm), count)
        for seed in range(starts):
            iterations, reached, plan = found(task, seed)
            touch, hard = first_touch(task, plan) if reached and reached <= PROPOSED else None, "no proposal"
            if touch:
                task.touched = touch
                plan = task.solve(plan.states, None)
                hard = f"{'solved' if plan.solved else plan.status}, {plan.iterations} iterations"
            shown = "" if touch is None else f"{touch * task.step:.2f}"
            row(name, seed, ", ".join(map(str, iterations)), reached or "none", shown, hard)
