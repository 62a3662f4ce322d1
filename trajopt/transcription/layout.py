"""Index of every variable: the only index arithmetic in the library.

Variables are ordered in time: node 0, controls of stage 0, node 1, ..., node N. A node holds the entries of
its form (see ``timeline``). The controls of an interval hold, for each point, the highest derivative y (nv)
of the local coordinates and the wrenches of the phase's contacts; those of an impact, the jump of the rates
(nv) and the impulses. A change of coordinates has no controls.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from trajopt.dynamics.manifold import Coordinates
from trajopt.robot.contact import Contact
from trajopt.robot.robot import Robot
from trajopt.robot.stance.minimal_coordinates import StanceMode
from trajopt.schedule.schedule import Schedule
from trajopt.terms.interfaces import NodePlace
from trajopt.transcription.mesh import Mesh
from trajopt.transcription.schemes import Scheme
from trajopt.transcription.timeline import NodeLayout, Stage, StageKind, Timeline, timeline


@dataclass(frozen=True)
class AdjacentIntervals:
    """The intervals around a node (stage indices or None), and whether impacts lie between it and them."""

    before: int | None
    after: int | None
    impact_behind: bool
    impact_ahead: bool


@dataclass(frozen=True)
class Layout:
    """Index ranges of one transcription.

    Args:
        robot: the robot.
        schedule: contacts over time.
        mesh: scheme and intervals of each phase.
        order: highest derivative among the variables: 2, 3 for jerks, or 1 for a velocity source.
        modes: minimal coordinates of phases, by the phase's name.
        closed: whether the two ends are compared, so that their rates must be in true time.
    """

    robot: Robot
    schedule: Schedule
    mesh: Mesh
    order: int = 2
    modes: Mapping[str, StanceMode] = field(default_factory=dict)
    closed: bool = False

    @cached_property
    def timeline(self) -> Timeline:
        """Stages, and the form and place of every node."""
        return timeline(self.robot, self.schedule, self.modes, self.mesh, self.order, self.closed)

    @property
    def stages(self) -> tuple[Stage, ...]:
        """Stages in time order."""
        return self.timeline.stages

    @property
    def forms(self) -> tuple[NodeLayout, ...]:
        """Form of every node, one more than there are stages."""
        return self.timeline.forms

    @property
    def n_stages(self) -> int:
        """Number of stages; there is one more node."""
        return len(self.stages)

    @property
    def intervals(self) -> tuple[int, ...]:
        """Number of intervals of each phase."""
        return self.mesh.counts

    def scheme_of(self, phase: int) -> Scheme:
        """Scheme of a phase."""
        return self.mesh.phases[phase].method

    @property
    def n_intervals(self) -> int:
        """Number of intervals over the whole schedule."""
        return sum(self.intervals)

    @cached_property
    def interval_stages(self) -> np.ndarray:
        """Indices of the stages that are intervals, in time order (n_intervals,)."""
        return np.flatnonzero([stage.kind is StageKind.INTERVAL for stage in self.stages])

    def transitions_of(self, kind: StageKind) -> tuple[int, ...]:
        """Indices of the stages of a kind."""
        return tuple(k for k, stage in enumerate(self.stages) if stage.kind is kind)

    @cached_property
    def phase_of(self) -> np.ndarray:
        """Phase index of each stage (n_stages,)."""
        return np.array([stage.phase for stage in self.stages])

    @cached_property
    def steps(self) -> np.ndarray:
        """Nominal duration of each stage in s (n_stages,)."""
        return np.array([stage.step for stage in self.stages])

    @cached_property
    def node_times(self) -> np.ndarray:
        """Nominal time of each node in s (n_stages + 1,)."""
        return np.concatenate([[0.0], np.cumsum(self.steps)])

    @cached_property
    def contacts(self) -> tuple[tuple[Contact, ...], ...]:
        """Active contacts of each phase with wrench variables: those not embedded in its coordinates."""
        return tuple(
            tuple(
                self.form_of(i).robot.contact(name)
                for name in phase.contacts
                if phase.name not in self.modes or name != self.modes[phase.name].embedded.name
            )
            for i, phase in enumerate(self.schedule.phases)
        )

    @cached_property
    def touching(self) -> tuple[tuple[Contact, ...], ...]:
        """All active contacts of each phase, including those embedded in its coordinates."""
        return tuple(
            tuple(self.robot.contact(name) for name in phase.contacts) for phase in self.schedule.phases
        )

    def form_of(self, phase: int) -> NodeLayout:
        """Form of the nodes within a phase."""
        return self.forms[int(self.intervals_of(phase)[0])]

    def n_wrench(self, phase: int) -> int:
        """Number of wrench components at a point of a phase."""
        return sum(contact.dimension for contact in self.contacts[phase])

    def n_control(self, k: int) -> int:
        """Number of controls of stage k."""
        stage, nv = self.stages[k], self.forms[k].coordinates.nv
        if stage.kind is StageKind.INTERVAL:
            return self.scheme_of(stage.phase).s * (nv + self.n_wrench(stage.phase))
        if stage.kind is StageKind.IMPACT:
            return nv + sum(contact.dimension for contact in self.touching[stage.phase])
        return 0

    @cached_property
    def node_offset(self) -> np.ndarray:
        """First index of each node (n_stages + 1,)."""
        widths = [self.forms[k].size + self.n_control(k) for k in range(self.n_stages)]
        return np.concatenate([[0], np.cumsum(widths)]).astype(np.int32)

    @property
    def n_unknowns(self) -> int:
        """Number of variables."""
        return int(self.node_offset[-1]) + self.forms[-1].size

    @cached_property
    def stage_numbers(self) -> np.ndarray:
        """Owner of each variable (n_unknowns,): k for node k, -1 - k for the controls of stage k."""
        numbers = np.full(self.n_unknowns, self.n_stages, dtype=np.int32)
        for k in range(self.n_stages):
            numbers[self.window(k)] = -1 - k
            numbers[self.node(k)] = k
        return numbers

    def node(self, k: int) -> slice:
        """Variables of node k."""
        start = int(self.node_offset[k])
        return slice(start, start + self.forms[k].size)

    def window(self, k: int) -> slice:
        """Variables of stage k: its start node and its controls."""
        return slice(int(self.node_offset[k]), int(self.node_offset[k]) + self.window_size(k))

    def window_size(self, k: int) -> int:
        """Size of a stage's window: its start node and its controls."""
        return self.forms[k].size + self.n_control(k)

    def local_derivative(self, phase: int, i: int) -> np.ndarray:
        """Indices of y at point i, within the window (node, controls) of an interval."""
        form = self.form_of(phase)
        width = form.coordinates.nv + self.n_wrench(phase)
        return form.size + i * width + np.arange(form.coordinates.nv)

    def local_wrench(self, phase: int, i: int) -> np.ndarray:
        """Indices of the wrenches at point i, within the window of an interval."""
        form, width = self.form_of(phase), self.n_wrench(phase)
        return form.size + i * (form.coordinates.nv + width) + form.coordinates.nv + np.arange(width)

    def local_jump(self, k: int) -> np.ndarray:
        """Indices of the jump of the rates within the window of an impact."""
        return self.forms[k].size + np.arange(self.forms[k].coordinates.nv)

    def local_impulse(self, k: int) -> np.ndarray:
        """Indices of the impulses within the window of an impact."""
        start = self.forms[k].size + self.forms[k].coordinates.nv
        return np.arange(start, self.window_size(k))

    def intervals_of(self, phase: int) -> np.ndarray:
        """Indices of the stages that are a phase's intervals."""
        return self.interval_stages[self.phase_of[self.interval_stages] == phase]

    def in_coordinates_of(
        self, form: NodeLayout, q: np.ndarray, v: np.ndarray, a: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return a state (q, v, a) of the whole robot in the coordinates of a node's form."""
        mode = next((mode for mode in self.modes.values() if mode.robot is form.robot), None)
        if mode is not None:
            q, v, a, _ = mode.dropped(q, v, a)
        return q, v, a

    def place(self, k: int) -> NodePlace | None:
        """Phase and fraction of node k, the later phase's where two meet; None if it repeats another node."""
        place_layout = self.timeline.places[k]
        if place_layout is None:
            return None
        phase, index = place_layout
        mesh = self.mesh.phases[phase]
        final = phase == len(self.intervals) - 1
        last, before = final and index == mesh.count, None
        if index == 0 and phase > 0 and not self.schedule.phases[phase].impact:
            earlier = self.mesh.phases[phase - 1]
            before = NodePlace(self.schedule.phases[phase - 1], earlier.count, earlier.fractions, False)
        return NodePlace(self.schedule.phases[phase], index, mesh.fractions, last, before)

    def adjacent_intervals(self, k: int) -> AdjacentIntervals:
        """Return the intervals around node k, across transitions."""
        stages, before, after = self.stages, k - 1, k
        while before >= 0 and stages[before].kind is not StageKind.INTERVAL:
            before -= 1
        while after < len(stages) and stages[after].kind is not StageKind.INTERVAL:
            after += 1
        return AdjacentIntervals(
            before=before if before >= 0 else None,
            after=after if after < len(stages) else None,
            impact_behind=any(stage.kind is StageKind.IMPACT for stage in stages[before + 1 : k]),
            impact_ahead=any(stage.kind is StageKind.IMPACT for stage in stages[k:after]),
        )

    def times(self, unknowns: np.ndarray) -> np.ndarray:
        """Time of each node in s (n_stages + 1,), from unscaled variables."""
        return np.concatenate([[0.0], np.cumsum(self.steps * self.time_scales(unknowns)[self.phase_of])])

    def place_phase(self, k: int) -> int:
        """Phase index of ``place(k)``, -1 where there is none."""
        location = self.timeline.places[k]
        return -1 if location is None else location[0]

    def phase_at(self, k: int) -> int:
        """Phase index of node k: that of the stage that begins there, or of the last stage."""
        return int(self.phase_of[min(k, self.n_stages - 1)])

    @property
    def coordinates(self) -> Coordinates:
        """Coordinates of the first node."""
        return self.forms[0].coordinates

    def time_scales(self, unknowns: np.ndarray) -> np.ndarray:
        """Duration over nominal duration of every phase, (n_phases,), from unscaled variables."""
        values = unknowns[self.node(0)][self.forms[0].time_scales]
        return np.array([1.0 if index is None else values[index] for index in self.schedule.time_scales])
