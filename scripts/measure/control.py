"""Ticks of the whole-body controller, and where its plans end (docs/control.md)."""

from typing import get_args

import click

import trajopt
from scripts.measure.shared import head, row
from trajopt.control.quadratic_programs import QpSolverName
from trajopt.control.tracker import Tracker
from trajopt.guesses import commanded_walk, walk_plan
from trajopt.robot import legs_only
from trajopt.simulation.settings import Controller
from trajopt.simulation.simulate import simulate

PLANS = (
    ("quadruped-trot", "go2", 3),
    ("quadruped-backflip", "go2", 1),
    ("biped-walk", "talos", 1),
    ("biped-walk", "g1", 1),
)

# Twenty steps of each: forward and to the left, m/s, and turning to the left, rad/s.
WALKS = ((0.3, 0.0, 0.0), (-0.2, 0.0, 0.0), (0.0, 0.05, 0.0), (0.3, 0.0, 0.4))

# Periodic gaits on level ground.
GAITS = {
    "solo12": "amble bound canter flying-trot gallop pace pronk rotary-gallop trot walk",
    "go2": "bound gallop pace pronk trot walk",
    "anymal_c": "bound gallop pace pronk trot walk",
}


@click.command("gaits")
@click.option("--cycles", default=10)
@click.option("--controller", "controllers", multiple=True, type=click.Choice(get_args(Controller)))
def gaits(cycles: int, controllers: tuple[Controller, ...]) -> None:
    """Some cycles of each gait in MuJoCo: how far the base is off at the end, mm."""
    wanted = controllers or get_args(Controller)
    head("gait", "robot", *wanted)
    for robot, names in GAITS.items():
        for name in names.split():
            plan = trajopt.solve(trajopt.load(f"quadruped-{name}", robot=robot))
            reports = [simulate(plan, cycles=cycles, controller=own).report for own in wanted]
            ends = [
                "fell"
                if report.fell or report.base_error_end is None
                else f"{1e3 * report.base_error_end:.1f}"
                for report in reports
            ]
            row(name, robot, *ends)


@click.command("ticks")
def ticks() -> None:
    """Time of a tick with each solver: mean and 99 %, on one core; run it with OMP_NUM_THREADS=1."""
    head("plan", "solver", "mean, ms", "99 %, ms", "iterations")
    for problem, robot, cycles in PLANS:
        plan = trajopt.solve(trajopt.load(problem, robot=robot))
        found = simulate(plan, cycles=cycles, controller="whole-body")
        for solver in get_args(QpSolverName):
            tracker = Tracker(plan, cycles=cycles, solver=solver)
            q = found.scene.coordinates.from_mujoco(found.record.qpos)
            v = found.scene.coordinates.rates_from_mujoco(found.record.qpos, found.record.qvel)
            for k, t in enumerate(tracker.reference.t[: found.reference.planned]):
                tracker.torque(float(t - tracker.reference.t[0]), q[k], v[k], tracker.reference.active[k])
            times = sorted(tracker.counts.times)
            mean, slow = sum(times) / len(times), times[int(0.99 * len(times))]
            steps = tracker.counts.iterations / tracker.counts.ticks
            row(f"{problem} {robot}", solver, f"{1e3 * mean:.2f}", f"{1e3 * slow:.2f}", f"{steps:.0f}")


@click.command("walks")
def walks() -> None:
    """Twenty steps of Talos and G1 in MuJoCo without a solve: how far the base is off."""
    head("robot", "forward, m/s", "aside, m/s", "turning, rad/s", "largest error, mm", "tracked")
    for robot in ("talos", "g1"):
        legs = legs_only(trajopt.robot(robot))
        for speed, side_speed, turn_rate in WALKS:
            walk = commanded_walk(legs, speed=speed, side_speed=side_speed, turn_rate=turn_rate)
            report = simulate(walk_plan(legs, walk), controller="whole-body").report
            most = 1e3 * (report.base_error_max or 0.0)
            passed = "yes" if report.passed else "no"
            row(robot, f"{speed:g}", f"{side_speed:g}", f"{turn_rate:g}", f"{most:.1f}", passed)
