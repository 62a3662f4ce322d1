"""A solution as the start of another solve: resampled onto another grid, scheme, durations, parameters.

Phases are matched one by one. Within a phase of the solution, of duration T_old, and of the problem, of
duration T, states at equal fractions of the phase are taken as equal configurations, so that

    q(t) = q_old(t T_old / T),    v = v_old T_old / T,    a = a_old (T_old / T)^2

Wrenches are those of the solution, impulses go with the rates. A free duration starts as the solution's,
within its bounds. The state at the start is the problem's own where that is fixed.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pinocchio as pin

from trajopt.dynamics.local_motion import local_from_pinocchio
from trajopt.errors import InputError
from trajopt.solution.motion import Sample, SolutionMotion
from trajopt.solution.solution import Solution
from trajopt.solving.multipliers import Multipliers, resampled_multipliers
from trajopt.transcription.guess import fill_impact, in_form, node_phase
from trajopt.transcription.layout import Layout
from trajopt.transcription.timeline import StageKind
from trajopt.transcription.transcription import Transcription
from trajopt.transcription.variable_bounds import start_of


@dataclass(frozen=True, kw_only=True)
class WarmStart:
    """Scaled unknowns ``x`` (n_unknowns,) and multipliers, None where the solution has none that fit."""

    x: np.ndarray
    multipliers: Multipliers | None


@dataclass(frozen=True, kw_only=True)
class _Source:
    """The solution's motion in the time of a layout.

    ``clocks`` (n_phases,): duration over nominal duration; ``stretch`` (n_phases,): duration over the
    solution's; ``columns``: the solution's column of a contact's frame; ``impulses`` (nc, 6) by phase.
    """

    layout: Layout
    motion: SolutionMotion
    clocks: np.ndarray
    stretch: np.ndarray
    columns: dict[str, int]
    impulses: dict[int, np.ndarray]

    def at(self, phase: int, t: float, towards: float) -> Sample:
        """Sample at nominal time ``t`` of a phase, at a node on the side of ``towards``, in its new time."""
        stages, times = self.layout.intervals_of(phase), self.layout.node_times
        start, end = float(times[stages[0]]), float(times[stages[-1] + 1])
        fraction, side = (t - start) / (end - start), (towards - start) / (end - start)
        found, stretch = self.motion.in_phase(phase, fraction, side), self.stretch[phase]
        return replace(found, v=found.v / stretch, a=found.a / stretch**2)


def warm_start(transcription: Transcription, solution: Solution) -> WarmStart:
    """Resample ``solution`` onto the unknowns of ``transcription``.

    On the grid, scheme and durations of the solution these are the solver's own unknowns, up to rounding and
    to the norm of quaternions, which a solution normalises. Raises InputError where the solution is of other
    joints, phases or contacts.
    """
    layout = transcription.layout
    _require_same_robot(layout, solution)
    _require_same_phases(layout, solution)
    source = _source(transcription, solution)
    x = np.zeros(layout.n_unknowns)
    _fill_nodes(transcription, source, x)
    for k, stage in enumerate(layout.stages):
        window = x[layout.window(k)]
        if stage.kind is StageKind.INTERVAL:
            _fill_interval(source, k, window)
        elif stage.kind is StageKind.IMPACT:
            _fill_impact(source, k, window, x[layout.node(k + 1)])
    x = x / transcription.scale
    fixed = transcription.lower_x == transcription.upper_x
    x[fixed] = transcription.lower_x[fixed]
    return WarmStart(x=x, multipliers=resampled_multipliers(transcription, solution))


def solution_of(start: Solution | str | Path) -> Solution:
    """The solution, or the one in that file; raises `InputError` for anything else."""
    if isinstance(start, Solution):
        return start
    if isinstance(start, str | Path):
        return Solution.load(start)
    raise InputError(f"start is {start!r}", "allowed: a Solution or the path of its file")


def _require_same_robot(layout: Layout, solution: Solution) -> None:
    own, other = layout.robot.model, solution.model
    joints = [[(name, joint.shortname()) for name, joint in _joints(model)] for model in (own, other)]
    if joints[0] != joints[1]:
        raise InputError(
            f"the solution's robot '{solution.meta['robot']}' has other joints than '{layout.robot.name}'",
            "allowed: a solution of a robot with the same joints, in the same coordinates of its base",
        )


def _joints(model: pin.Model) -> list[tuple[str, pin.JointModel]]:
    return list(zip(model.names, model.joints, strict=True))[1:]


def _require_same_phases(layout: Layout, solution: Solution) -> None:
    """As many phases, each with the same contacts; names are free."""
    frames = np.array(solution.contact_frames)
    found = [set(frames[solution.active[rows.start]].tolist()) for rows in solution.phases]
    wanted = [{contact.frame for contact in contacts} for contacts in layout.touching]
    if found != wanted:
        raise InputError(
            f"the solution's phases have the contacts {_in_words(found)}, the problem's {_in_words(wanted)}",
            "allowed: a solution with the same phases",
        )
    velocity = solution.meta.get("actuation") == "velocity"
    if velocity != (layout.order == 1):
        raise InputError(
            "one of solution and problem has velocity sources, whose nodes have no rates",
            "allowed: both or none",
        )


def _in_words(phases: list[set[str]]) -> str:
    return "; ".join(", ".join(sorted(contacts)) or "none" for contacts in phases)


def _source(transcription: Transcription, solution: Solution) -> _Source:
    layout, motion = transcription.layout, SolutionMotion(solution)
    phases = layout.schedule.phases
    spans = np.array([motion.span(i) for i in range(len(phases))])
    old = spans[:, 1] - spans[:, 0]
    clocks = np.ones(len(phases))
    for i, phase in enumerate(phases):
        if phase.duration_bounds is not None:
            clocks[i] = np.clip(old[i], *phase.duration_bounds) / phase.duration
    new = clocks * [phase.duration for phase in phases]
    impulses = {}
    if solution.impulse is not None and solution.impact_index is not None:
        impulses = dict(zip(solution.phase[solution.impact_index].tolist(), solution.impulse, strict=True))
    columns = {frame: i for i, frame in enumerate(solution.contact_frames)}
    return _Source(
        layout=layout, motion=motion, clocks=clocks, stretch=new / old, columns=columns, impulses=impulses
    )


def _fill_nodes(transcription: Transcription, source: _Source, x: np.ndarray) -> None:
    """States at nodes, quaternions and turns continued from the problem's start on."""
    layout = transcription.layout
    own_clocks = np.array(
        [s for s, clock in zip(source.clocks, layout.schedule.clocks, strict=True) if clock is not None]
    )
    first = layout.forms[0].coordinates
    previous = {id(first): first.node_from_pinocchio(*start_of(transcription.problem, layout))}
    for k, form in enumerate(layout.forms):
        phase = node_phase(layout, k)
        stages = layout.intervals_of(phase)
        middle = (layout.node_times[stages[0]] + layout.node_times[stages[-1] + 1]) / 2
        found = source.at(phase, float(layout.node_times[k]), float(middle))
        q, v, _ = in_form(layout, form, (found.q, found.v, found.a))
        state = form.coordinates.node_from_pinocchio(q, v)
        state = form.coordinates.continued(state, previous.get(id(form.coordinates), state))
        previous[id(form.coordinates)] = state
        x[layout.node(k)] = form.node(state, own_clocks)


def _fill_interval(source: _Source, k: int, window: np.ndarray) -> None:
    """Highest derivatives in nominal time relative to the interval's start, and wrenches, at the points."""
    layout, form, phase = source.layout, source.layout.forms[k], int(source.layout.phase_of[k])
    start, step, clock = layout.node_times[k], layout.steps[k], source.clocks[phase]
    for i, c in enumerate(layout.scheme_of(phase).c):
        found = source.at(phase, float(start + c * step), float(start + step / 2))
        q, v, a = in_form(layout, form, (found.q, found.v, found.a))
        local = local_from_pinocchio(form.coordinates, window[form.rotations], q, v, a)
        window[layout.local_derivative(phase, i)] = local[layout.order] * clock**layout.order
        rows = [found.f[source.columns[c.frame], list(c.rows)] for c in layout.contacts[phase]]
        window[layout.local_wrench(phase, i)] = np.concatenate([np.zeros(0), *rows])


def _fill_impact(source: _Source, k: int, window: np.ndarray, after: np.ndarray) -> None:
    """The jump between the rates of both nodes, and the solution's impulses, or the least that carry it."""
    layout, phase = source.layout, source.layout.stages[k].phase
    fill_impact(layout, k, window, after)
    if phase in source.impulses:
        impulse = source.impulses[phase] / source.stretch[phase]
        rows = [impulse[source.columns[c.frame], list(c.rows)] for c in layout.touching[phase]]
        window[layout.local_impulse(k)] = np.concatenate(rows)
