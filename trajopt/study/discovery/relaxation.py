"""Relaxed contacts without phases: complementarity of force, height and speed within a decreasing slack.

With the gap g >= 0 of each contact (of each corner of a sole), its vertical force f >= 0 and its twist v, in
natural units,

    f g <= slack,    |f v| <= slack

hold at the collocation points of a single phase in which every contact may push. The first solve has a large
slack and lets feet push from where they are; each further one starts from the previous solution with a
smaller slack, as in Manchester, Doshi, Wood, Kuindersma, "Contact-implicit trajectory optimization using
variational integrators", IJRR 38 (2019), and Patel, Shield, Kazi, Johnson, Biegler, "Contact-implicit
trajectory optimization using orthogonal collocation", RA-L 4 (2019). The resulting motion is a proposal: hard
contacts decide.
"""

from dataclasses import dataclass, replace

import casadi as ca
import numpy as np
from typing_extensions import override

from trajopt.arguments import NonNegative, Positive
from trajopt.motion.solution import Solution
from trajopt.problem.problem import Problem
from trajopt.robot.kinematics import contact_positions
from trajopt.robot.units import Units
from trajopt.schedule.schedule import Phase, Schedule
from trajopt.solvers.result import StoppingCriteria
from trajopt.solving.solving import prepare, solve_prepared
from trajopt.study.discovery.modes import LOADED, ModeSequence, read_modes
from trajopt.study.discovery.task import ContactTask, gap, smooth_gap
from trajopt.terms.context import Context
from trajopt.terms.dynamics import BaseDynamics
from trajopt.terms.interfaces import NodeConstraint, NodePlace, PointConstraint, Rows, Term
from trajopt.terms.landing import contact_points
from trajopt.terms.terminal import TerminalRest, TerminalState, configuration_difference
from trajopt.terrain.terrain import Terrain
from trajopt.transcription.guess import perturbed
from trajopt.transcription.mesh import Mesh

# Slacks of consecutive solves.
SLACKS = (0.1, 0.03, 0.01, 0.003)
SCHEME = "legendre:2"
# Intervals per sqrt(l / g) of a motion, and their least and largest number. Except on a fine mesh, there are
# fewer where intervals times nv would exceed LARGE (Go2 with 24 intervals).
PER_UNIT, LEAST_INTERVALS, MOST_INTERVALS = 5, 12, 60
LARGE, PER_UNIT_LARGE = 432, 3
MOST_ITERATIONS = 300
# Modes shorter than this many intervals are not resolved.
SHORTEST = 1.5
# Standard deviation of the noise on the guess, scaled units.
NOISE = 0.1
PHASE = "all"


@dataclass(frozen=True, kw_only=True)
class RelaxedContacts(PointConstraint):
    """Contacts push only near the ground, where they hardly move; see the module."""

    slack: Positive
    terrain: Terrain

    @override
    def rows(self, context: Context, units: Units) -> Rows:
        gaps, products, speeds = [], [], []
        slack = context.parameter(self.slack)
        for contact in context.contacts:
            frame, force = context.frame(contact.frame), context.wrenches[contact.name][2] / units.force
            for point in contact_points(context, contact):
                height = smooth_gap(self.terrain, point, contact.radius, units.length, context.parameter)
                gaps.append(height / units.length)
                products.append(force * height / units.length / slack)
            held = list(context.held_rows(contact))
            twist = frame.velocity[held] / ca.DM(units.twist[held])
            speeds.append(force * twist / slack)
            gaps.append(force)
        above, near, still = (ca.vertcat(*parts) for parts in (gaps, products, speeds))
        n = near.numel(), still.numel()
        lower = np.concatenate([np.zeros(above.numel()), np.full(n[0], -np.inf), np.full(n[1], -1.0)])
        upper = np.concatenate([np.full(above.numel(), np.inf), np.ones(n[0] + n[1])])
        return Rows.create(ca.vertcat(above, near, still), lower, upper, 1.0)


@dataclass(frozen=True, kw_only=True)
class WholeEnd(NodeConstraint):
    """The motion ends at ``q`` (nq,), or at rest if None, in all directions, as no contact holds it."""

    q: np.ndarray | None

    @override
    def rows(self, context: Context, units: Units, place: NodePlace) -> Rows:
        if self.q is None:
            return Rows.create(context.dxi / units.velocity, 0, 0, 1.0)
        return Rows.create(configuration_difference(context, self.q) / units.position, 0, 0, 1.0)


@dataclass(frozen=True, kw_only=True, eq=False)
class Relaxation:
    """A motion without phases, the modes read from it, and the cost of its solves.

    Args:
        solution, slack: of the smallest slack that was solved; None if none was.
        stages: slack, status, iterations and objective of each solve.
        seconds, effort: solver time, s, and iterations times variables.
    """

    solution: Solution | None
    modes: ModeSequence | None
    slack: float | None
    stages: tuple[tuple[float, str, int, float | None], ...]
    seconds: float
    effort: float


def relaxed_motion(
    task: ContactTask,
    *,
    seed: NonNegative = 0,
    intervals: int | None = None,
    max_time: float = 60.0,
    fine: bool = False,
) -> Relaxation:
    """Solve a task with relaxed contacts from `ContactTask.still`, with noise if ``seed`` is not 0."""
    solution, reached = None, None
    stages, seconds, effort = [], 0.0, 0.0
    count = intervals or intervals_of(task, fine)
    for slack in SLACKS:
        left = max_time - seconds
        if left <= 0:
            break
        prepared = prepare(_relaxed(task, slack), mesh=Mesh.uniform(SCHEME, (count,)), start=solution)
        start = prepared.guess
        if seed and solution is None:
            start = perturbed(prepared.transcription, start, int(seed), NOISE)
        stop = StoppingCriteria(max_iterations=MOST_ITERATIONS, max_time=left)
        tightened = solve_prepared(prepared, start, origin={}, judge=False, stop=stop)
        figures = tightened.statistics
        seconds, effort = seconds + figures.wall_time_s, effort + figures.iterations * figures.variables
        stages.append((slack, figures.status, figures.iterations, figures.objective))
        if not tightened.converged:
            break
        solution, reached = tightened, slack
    modes = None if solution is None else modes_of(task, solution, count)
    return Relaxation(
        solution=solution,
        modes=modes,
        slack=reached,
        stages=tuple(stages),
        seconds=seconds,
        effort=effort,
    )


def modes_of(task: ContactTask, solution: Solution, intervals: int) -> ModeSequence:
    """Read the modes of a relaxed motion; a cycle is shifted to begin at a touchdown."""
    robot, rows = task.robot, solution.collocation
    q, duration = solution.q[rows], float(solution.t[-1])
    places = np.array([list(contact_positions(robot, each).values()) for each in q])
    radii = [contact.radius for contact in robot.contacts]
    gaps = [
        [gap(task.problem.terrain, place, radius) for place, radius in zip(feet, radii, strict=True)]
        for feet in places
    ]
    standing = None
    if not task.periodic:
        last = q[-1] if task.end is None else task.end
        standing = task.standing(solution.q[0]), task.standing(last)
    modes = read_modes(
        [contact.name for contact in robot.contacts],
        solution.t[rows],
        duration,
        solution.f[rows][:, :, 2] > LOADED * robot.weight,
        np.array(gaps),
        places,
        length=robot.length,
        cycle=task.travel(solution.q[0], solution.q[-1]) if task.periodic else None,
        ends=standing,
    ).without_short(SHORTEST * duration / intervals, task.periodic)
    return modes.from_touchdown() if task.periodic else modes


def intervals_of(task: ContactTask, fine: bool) -> int:
    """Number of intervals of a relaxed motion."""
    units = task.duration / Units(task.robot).time
    wanted = PER_UNIT * units
    if not fine:
        wanted = max(PER_UNIT_LARGE * units, min(wanted, LARGE / task.robot.nv))
    return int(np.clip(round(wanted), LEAST_INTERVALS, MOST_INTERVALS))


def _relaxed(task: ContactTask, slack: float) -> Problem:
    low, high = task.duration_range
    names = tuple(contact.name for contact in task.robot.contacts)
    free = (low, high) if high > low else None
    schedule = Schedule((Phase(name=PHASE, duration=task.duration, contacts=names, duration_bounds=free),))
    terms = [_everywhere(term) for term in task.terms]
    centres = [replace(contact, rolling=False) for contact in task.robot.contacts]
    return replace(
        task.problem,
        robot=replace(task.robot, contacts=tuple(centres)),
        name=f"{task.problem.name}-relaxed",
        schedule=schedule,
        dynamics=(BaseDynamics(),),
        terms=(*terms, RelaxedContacts(slack=slack, terrain=task.problem.terrain)),
        guess=task.still,
        duration_bounds=None,
    )


def _everywhere(term: Term) -> Term:
    """Replace a terminal condition in the directions that contacts leave free by one in all directions."""
    if isinstance(term, TerminalState):
        return WholeEnd(q=term.q)
    return WholeEnd(q=None) if isinstance(term, TerminalRest) else term
