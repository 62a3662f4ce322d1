"""Models, bases and goals of one problem against each other, and the range of the jump."""

import itertools
import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import partial

import click
import numpy as np
import pinocchio as pin

from scripts.measure.shared import NOISE, PASSES, head, row, sizes, solver_option, verdict
from trajopt import Problem, Schedule, Solution, solve
from trajopt.dynamics.base_joint import virtual_order
from trajopt.dynamics.virtual_base import to_free_flyer
from trajopt.motion.energy_use import cost_of_transport
from trajopt.reduced.base_conversion import with_virtual_base
from trajopt.terms import Cost, PowerCost, TimeCost
from trajopt.terms.objectives import REST_OF_LINEAR
from trajopt_library import problems

ORDERS = ("ZYX", "YXZ")
# What is compared, which model of it, and a function that builds its problem.
Model = tuple[str, str, Callable[[], Problem]]
SEEDS = (0, 1, 2)
RESTS = (0.3, REST_OF_LINEAR, 0.03, 0.01)
ROUNDINGS = (0.3, 0.1, 0.03, 0.01)
# Of the arm: goal, payload in kg, rotors over links.
TRANSFERS = (
    ("effort", 8.0, 0.75),
    ("effort", 0.0, 0.75),
    ("time", 8.0, 0.75),
    ("time", 0.0, 0.75),
    ("time", 8.0, 0.5),
    ("time", 8.0, 1.0),
)
# Of the jump: m, m, degrees.
DISTANCES, HEIGHTS, TURNS = (0.0, 0.1, 0.2, 0.3, 0.4, 0.5), (0.0, 0.1, 0.2), (0.0, 22.5, 45.0)


def all_models() -> Iterator[Model]:
    """Every pair of models of docs/modelling/comparisons.md."""
    yield from _family("actuators (UR5 reach)", "ur5-reach", {
        "torque source": {},
        "acceleration source": {"actuation": "acceleration"},
        "velocity source": {"actuation": "velocity"},
    })  # fmt: skip
    yield from _family("torque-speed envelope (Solo12 jump)", "solo12-jump", {
        "no motors": {}, "motors at 24 V": {"voltage": 24}, "motors at 6 V": {"voltage": 6},
    })  # fmt: skip
    yield from _bases("base (Solo12 jump, yaw 0.6)", "solo12-jump", ORDERS, distance=0.2, yaw=0.6)
    yield from _bases("base (Solo12 half flip)", "solo12-flip", ORDERS[:1])
    yield from _family("coordinates (planar hopper)", "hopper-hop", {
        "excess": {},
        "minimal": {"coordinates": "minimal"},
        "excess impact": {"touchdown": "impact"},
        "minimal impact": {"touchdown": "impact", "coordinates": "minimal"},
    })  # fmt: skip
    yield from _family("touchdown (Solo12 jump)", "solo12-jump", {
        "zero velocity": {}, "impact": {"touchdown": "impact"},
    })  # fmt: skip
    yield from _family("durations (Solo12 jump)", "solo12-jump", {"given": {}})
    yield "durations (Solo12 jump)", "free", lambda: free_durations("solo12-jump", 0.5)
    yield from _family("goal (IRB 1600 transfer)", "irb1600-transfer", {
        "minimum effort": {}, "minimum time": {"goal": "time"},
    })  # fmt: skip


def _family(what: str, name: str, variants: dict[str, dict[str, object]]) -> Iterator[Model]:
    for model, parameters in variants.items():
        yield what, model, partial(problems.load, name, **parameters)


def _bases(what: str, name: str, orders: Sequence[str], **parameters: object) -> Iterator[Model]:
    yield what, "quaternion", partial(problems.load, name, **parameters)
    for order in orders:
        made = partial(lambda order: with_virtual_base(problems.load(name, **parameters), order), order)
        yield what, f"virtual joints {order}", made


def free_durations(name: str, share: float) -> Problem:
    """The problem with every duration free between ``share`` and 1/share of its own, and time priced."""
    problem = problems.load(name)
    phases = tuple(
        replace(phase, duration_bounds=(share * phase.duration, phase.duration / share))
        for phase in problem.schedule.phases
    )
    return replace(problem, schedule=Schedule(phases), terms=(*problem.terms, TimeCost(weight=0.02)))


@click.command()
@click.option("--only", default="", help="Rows whose first column has this text.")
@solver_option
def models(only: str, solver: str) -> None:
    """Every pair of models on its problem's own mesh: size, iterations, time, optimum, check."""
    head("compared", "model", "variables", "rows", "iterations", "solver s", "objective", "check")
    for what, model, build in all_models():
        if only.lower() in what.lower():
            found = solve(build(), solver=solver, fixed_mesh=True)
            objective = f"{found.statistics.objective:.5g}" if found.converged else found.statistics.status
            row(what, model, *sizes(found), objective, verdict(found))


@click.command()
@click.option("--yaw", default=0.6, show_default=True, help="Turn of the jump, rad.")
@click.option("--transcription", default="legendre:2", show_default=True)
@click.option("--intervals", default=40, show_default=True)
@solver_option
def bases(yaw: float, transcription: str, intervals: int, solver: str) -> None:
    """A jump and half a flip on a quaternion and on virtual joints: gimbal margin, condition, distance."""
    titles = ("variables", "rows", "iterations", "solver s", "objective", "margin", "cond M", "base path m")
    head("problem", "base", *titles, "status")
    for name, parameters in (("solo12-jump", {"distance": 0.2, "yaw": yaw}), ("solo12-flip", {})):
        paths: list[np.ndarray] = []
        for _, base, build in _bases(name, name, ORDERS, **parameters):
            found = solve(
                build(), transcription=transcription, intervals=intervals, solver=solver, max_iterations=300
            )
            paths.append(base_path(found))
            apart = np.linalg.norm(paths[-1] - paths[0], axis=1).max()
            margin = found.statistics.gimbal_margin
            figures = [f"{found.statistics.objective:.6f}", "" if margin is None else f"{margin:.3f}"]
            row(name, base, *sizes(found), *figures, f"{condition(found):.1e}", f"{apart:.1e}",
                found.statistics.status)  # fmt: skip


def condition(solution: Solution) -> float:
    """Worst condition number over samples of the joint-space inertia."""
    model, data = solution.model, solution.model.createData()
    return float(max(np.linalg.cond(pin.crba(model, data, q)) for q in solution.q))


def base_path(solution: Solution) -> np.ndarray:
    """Positions (K, 3) of the base, m."""
    model, still = solution.model, np.zeros(solution.model.nv)
    if virtual_order(model) is None:
        return solution.q[:, :3]
    return np.array([to_free_flyer(model, q, still, still)[0][:3] for q in solution.q])


@click.command()
def goals() -> None:
    """The effect of the remaining effort cost, on the hopper, to the grade; iterations of all meshes."""
    head("goal", "rest of effort", "reached", "root mean square torque, N m", "check", "iterations")
    for goal in ("height", "distance", "time"):
        for rest in RESTS:
            found = _solutions(with_rest(problems.load("hopper-hop", goal=goal), rest), fixed_mesh=False)
            torque = np.sqrt((found[0].tau ** 2).mean())
            figures = f"{rest:g}", reached(goal, found[0]), f"{torque:.0f}", verdict(found[0])
            row(goal, *figures, _counts(found))


@click.command()
def smoothing() -> None:
    """Cost of transport against the smoothing of power, on the hopper; in the first line of least effort."""
    head("smoothing s", "cost of transport", "iterations")
    least = solve(problems.load("hopper-gait"), fixed_mesh=True)
    row("least effort", f"{cost_of_transport(least):.3f}", least.statistics.iterations)
    for rounding in ROUNDINGS:
        found = _solutions(rounded(problems.load("hopper-gait", goal="transport"), rounding), fixed_mesh=True)
        row(f"{rounding:g}", ", ".join(f"{cost_of_transport(own):.3f}" for own in found), _counts(found))


@click.command()
def transfers() -> None:
    """Transfers of the IRB 1600: largest torques and speeds over their limits, by axis."""
    head("goal", "payload", "motor inertia", "mesh", "iterations", "duration", "torques", "speeds", "check")
    for goal, payload, inertia in TRANSFERS:
        found = solve(problems.load("irb1600-transfer", goal=goal, payload=payload, motor_inertia=inertia))
        limits = problems.load("irb1600-transfer", motor_inertia=inertia).robot
        shares = (
            np.abs(found.tau).max(axis=0) / limits.torque_limit,
            np.abs(found.v).max(axis=0) / limits.velocity_limit,
        )
        mesh = f"`{found.statistics.transcription}`, {found.n_intervals}"
        figures = (" ".join(f"{share:.2f}" for share in each) for each in shares)
        case = goal, f"{payload:g} kg", inertia
        row(*case, mesh, _counts([found]), f"{found.t[-1]:.3f} s", *figures, verdict(found))


def with_rest(problem: Problem, rest: float) -> Problem:
    """A problem with a linear goal and another part of the costs of effort."""
    share = rest / REST_OF_LINEAR
    terms = (
        replace(term, weight=share * term.weight)
        if isinstance(term, Cost) and not isinstance(term, TimeCost)
        else term
        for term in problem.terms
    )
    return replace(problem, terms=tuple(terms))


def rounded(problem: Problem, smoothing: float) -> Problem:
    """The problem with power rounded over another width."""
    terms = (replace(t, smoothing=smoothing) if isinstance(t, PowerCost) else t for t in problem.terms)
    return replace(problem, terms=tuple(terms))


def _solutions(problem: Problem, *, fixed_mesh: bool) -> list[Solution]:
    """From the default guess, then from perturbed ones."""
    starts = ({}, *({"perturb": NOISE, "seed": seed} for seed in SEEDS))
    return [solve(problem, fixed_mesh=fixed_mesh, **start) for start in starts]


def _counts(found: Sequence[Solution]) -> str:
    """Iterations of every start on all its meshes; in brackets where the solver did not converge."""
    counts = (sum(each.iterations for each in s.statistics.rounds) for s in found)
    return ", ".join(f"{n}" if s.converged else f"({n})" for n, s in zip(counts, found, strict=True))


def reached(goal: str, solution: Solution) -> str:
    """The result of a hop: the base's rise or the distance, m; or the time, s."""
    rise, way = solution.q[:, 1].max() - solution.q[0, 1], solution.q[-1, 0] - solution.q[0, 0]
    return {"height": f"{rise:.2f} m", "distance": f"{way:.2f} m", "time": f"{solution.t[-1]:.2f} s"}[goal]


@click.command("range")
@solver_option
def jump_range(solver: str) -> None:
    """Solo12's jump over its range of distances, heights and turns."""
    head("distance m", "height m", "yaw deg", "status", "iterations", "objective", "check")
    cases, passed = list(itertools.product(DISTANCES, HEIGHTS, TURNS)), 0
    for distance, height, turn in cases:
        yaw = math.radians(turn)
        found = solve(problems.load("solo12-jump", distance=distance, height=height, yaw=yaw), solver=solver)
        statistics, said = found.statistics, verdict(found)
        passed += found.success and said == PASSES
        figures = statistics.status, statistics.iterations, f"{statistics.objective:.4f}", said
        row(distance, height, turn, *figures)
    click.echo(f"\n{passed} of {len(cases)} are solved and pass the check")
