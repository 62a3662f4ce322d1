"""Warm starts: resample a solution onto another mesh, with other durations or parameters.

Phases are matched one by one. Configurations are equal at equal fractions of a phase, which has the duration
T_old in the solution and T in the problem, so that

    q(t) = q_old(t T_old / T),    v = v_old T_old / T,    a = a_old (T_old / T)^2

Wrenches are those of the solution; impulses scale with the velocities. A free duration starts at the
solution's, clipped to its bounds. Variables that are fixed, such as the initial state, keep their values.
"""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import pinocchio as pin
from typing_extensions import override

from trajopt.errors import InputError
from trajopt.motion.configurations import SolutionMotion
from trajopt.motion.consistency import rows_of
from trajopt.motion.interpolation import MotionSample
from trajopt.motion.local_states import local_state
from trajopt.motion.solution import Solution
from trajopt.solvers.result import WarmMultipliers
from trajopt.solving.multipliers import resampled_multipliers
from trajopt.transcription.guess import MotionSource, node_phase, unknowns_from_motion
from trajopt.transcription.layout import Layout
from trajopt.transcription.timeline import StageKind
from trajopt.transcription.transcription import Transcription
from trajopt.transcription.variable_bounds import initial_state


@dataclass(frozen=True, kw_only=True)
class WarmStart:
    """Scaled variables ``x`` (n_unknowns,) and multipliers; None if the solution has none that fit."""

    x: np.ndarray
    multipliers: WarmMultipliers | None


@dataclass(frozen=True, kw_only=True)
class _Source(MotionSource):
    """The solution's motion in the time of a layout.

    ``time_scales`` and ``stretch`` (n_phases,) are durations over the nominal and the solution's durations,
    ``columns`` the solution's column of each contact frame, ``known_impulses`` (nc, 6) by phase.
    """

    layout: Layout
    motion: SolutionMotion
    time_scales: np.ndarray
    stretch: np.ndarray
    columns: dict[str, int]
    known_impulses: dict[int, np.ndarray]

    @override
    def node_state(self, k: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        layout = self.layout
        sample = rows_of(self._samples, k)
        return layout.in_coordinates_of(layout.forms[k], sample.q, sample.v, sample.a)

    @override
    def at_point(self, k: int, i: int, node: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        layout, form, phase = self.layout, self.layout.forms[k], self.layout.stages[k].phase
        sample = rows_of(self._samples, self._first_points[k] + i)
        origin = form.coordinates.node_to_pinocchio(form.state(node))[0][0]
        state = layout.in_coordinates_of(form, sample.q, sample.v, sample.a)
        derivative = min(layout.order, 2)
        value = local_state(form.robot.model, origin, *state)[derivative]
        wrenches = [sample.f[self.columns[c.frame], list(c.rows)] for c in layout.contacts[phase]]
        scale = self.time_scales[phase] ** derivative
        return value * scale, np.concatenate([np.zeros(0), *wrenches])

    @override
    def impulses(self, k: int) -> np.ndarray | None:
        phase = self.layout.stages[k].phase
        if phase not in self.known_impulses:
            return None
        impulse = self.known_impulses[phase] / self.stretch[phase]
        contacts = self.layout.touching[phase]
        return np.concatenate([impulse[self.columns[c.frame], list(c.rows)] for c in contacts])

    @cached_property
    def _first_points(self) -> np.ndarray:
        """The row of `_samples` of each stage's first collocation point."""
        stages = self.layout.stages
        points = [self.layout.scheme_of(each.phase).s * (each.kind is StageKind.INTERVAL) for each in stages]
        return len(self.layout.forms) + np.cumsum([0, *points])

    @cached_property
    def _samples(self) -> MotionSample:
        """The motion at all nodes, then at all collocation points, in the layout's time."""
        layout, times = self.layout, self.layout.node_times
        phases = [node_phase(layout, k) for k in range(len(layout.forms))]
        stages = [layout.intervals_of(phase) for phase in range(len(layout.schedule.phases))]
        spans = np.array([[times[each[0]], times[each[-1] + 1]] for each in stages])
        at, middles = list(times[: len(phases)]), list(spans[phases].mean(axis=1))
        for k, stage in enumerate(layout.stages):
            if stage.kind is StageKind.INTERVAL:
                nodes = layout.scheme_of(stage.phase).c
                phases += [stage.phase] * len(nodes)
                at += list(times[k] + nodes * layout.steps[k])
                middles += [times[k] + layout.steps[k] / 2] * len(nodes)
        start, end = spans[phases].T
        fractions, sides = ((np.array(each) - start) / (end - start) for each in (at, middles))
        sample, stretch = (
            self.motion.in_phase(np.array(phases), fractions, sides),
            self.stretch[phases, None],
        )
        return replace(sample, v=sample.v / stretch, a=sample.a / stretch**2)


def warm_start(transcription: Transcription, solution: Solution) -> WarmStart:
    """Resample ``solution`` onto the variables of ``transcription``.

    On the mesh and with the durations of the solution this recovers the solver's variables, up to rounding
    and the norm of quaternions, which a solution normalises. Raises InputError if the joints, phases or
    contacts differ.
    """
    layout = transcription.layout
    _require_same_robot(layout, solution)
    _require_same_phases(layout, solution)
    source = _source(transcription, solution)
    scales = source.time_scales[[index is not None for index in layout.schedule.time_scales]]
    near = layout.coordinates.node_from_pinocchio(*initial_state(transcription.problem, layout)[:2])
    x = unknowns_from_motion(layout, source, scales, near) / transcription.scale
    fixed = transcription.lower_x == transcription.upper_x
    x[fixed] = transcription.lower_x[fixed]
    return WarmStart(x=x, multipliers=resampled_multipliers(transcription, solution))


def _require_same_robot(layout: Layout, solution: Solution) -> None:
    def joints(model: pin.Model) -> list[tuple[str, str]]:
        return [(name, joint.shortname()) for name, joint in zip(model.names, model.joints, strict=True)][1:]

    if joints(layout.robot.model) != joints(solution.model):
        given = solution.description.robot
        raise InputError(
            f"the solution's robot '{given}' has other joints than '{layout.robot.name}'",
            "allowed: a solution of a robot with the same joints, in the same coordinates of its base",
        )


def _require_same_phases(layout: Layout, solution: Solution) -> None:
    """Require the same number of phases with the same contacts; names may differ."""
    frames = np.array(solution.contact_frames)
    solved = [set(frames[solution.active[rows.start]].tolist()) for rows in solution.phases]
    wanted = [{contact.frame for contact in contacts} for contacts in layout.touching]
    if solved != wanted:
        raise InputError(
            f"the solution's phases have the contacts {_in_words(solved)}, the problem's {_in_words(wanted)}",
            "allowed: a solution with the same phases",
        )
    if (solution.description.actuation == "velocity") != (layout.order == 1):
        raise InputError(
            "only one of solution and problem has velocity sources, whose nodes have no rates",
            "allowed: both or none",
        )


def _in_words(phases: list[set[str]]) -> str:
    return "; ".join(", ".join(sorted(contacts)) or "none" for contacts in phases)


def _source(transcription: Transcription, solution: Solution) -> _Source:
    layout, motion = transcription.layout, SolutionMotion(solution)
    phases = layout.schedule.phases
    old = np.diff(motion.spans, axis=1)[:, 0]
    time_scales = np.ones(len(phases))
    for i, phase in enumerate(phases):
        if phase.duration_bounds is not None:
            time_scales[i] = np.clip(old[i], *phase.duration_bounds) / phase.duration
    impulses = {}
    if solution.impulse is not None and solution.impact_index is not None:
        impulses = dict(zip(solution.phase[solution.impact_index].tolist(), solution.impulse, strict=True))
    return _Source(
        layout=layout,
        motion=motion,
        time_scales=time_scales,
        stretch=time_scales * [phase.duration for phase in phases] / old,
        columns={frame: i for i, frame in enumerate(solution.contact_frames)},
        known_impulses=impulses,
    )
