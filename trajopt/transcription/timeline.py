"""The stages of a schedule in time order: intervals of phases, and transitions between phases.

A stage leads from one node to the next. An *interval* is a stretch of motion with collocation points.
Between two phases there may be *transitions*, which take no time: an *impact* (velocities jump, the
configuration does not) and a *change* of coordinates or of the time scale that rates are measured in.

The rates and accelerations among the variables are measured in nominal time. A phase of free duration T has
the time scale s = T / T_nominal, so that x' = s v and x'' = s^2 a, and collocation stays linear in the
variables. Every node holds the time scales of all free phases, which are constant over time.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from enum import Enum
from functools import cached_property

import numpy as np

from trajopt.dynamics.manifold import Coordinates
from trajopt.robot.robot import Robot
from trajopt.robot.stance.minimal_coordinates import StanceMode
from trajopt.schedule.schedule import Schedule
from trajopt.transcription.mesh import Mesh


class StageKind(Enum):
    """What happens between a stage's node and the next."""

    INTERVAL = "interval"
    IMPACT = "impact"
    CHANGE = "change"


@dataclass(frozen=True, eq=False)
class NodeLayout:
    """Entries of a node: rotations, additive positions, rates, accelerations, time scales of all free phases.

    ``time_scale`` is the index of the time scale in which the rates are measured, None for true time. Nodes
    of ``order`` 1 (a velocity source) have no rates, and only those of order 3 have accelerations. The arrays
    are indices within the node.
    """

    robot: Robot
    coordinates: Coordinates
    time_scale: int | None
    n_time_scales: int
    order: int

    @cached_property
    def rotations(self) -> np.ndarray:
        """Indices of the rotations."""
        return np.arange(4 * self.coordinates.n_rotations)

    @cached_property
    def additive(self) -> np.ndarray:
        """Indices of the additive positions."""
        return len(self.rotations) + np.arange(len(self.coordinates.additive_index))

    @cached_property
    def rates(self) -> np.ndarray:
        """Indices of the rates (nv, or none)."""
        start = len(self.rotations) + len(self.additive)
        return start + np.arange(self.coordinates.nv if self.order >= 2 else 0)

    @cached_property
    def accelerations(self) -> np.ndarray:
        """Indices of the accelerations (nv, or none)."""
        start = len(self.rotations) + len(self.additive) + len(self.rates)
        return start + np.arange(self.coordinates.nv if self.order == 3 else 0)

    @cached_property
    def time_scales(self) -> np.ndarray:
        """Indices of the time scales."""
        return self.n_state + np.arange(self.n_time_scales)

    @cached_property
    def n_state(self) -> int:
        """Number of entries without the time scales."""
        return sum(map(len, (self.rotations, self.additive, self.rates, self.accelerations)))

    @property
    def size(self) -> int:
        """Number of entries."""
        return self.n_state + self.n_time_scales

    def state(self, node: np.ndarray) -> np.ndarray:
        """State (rotations, additive positions, rates) of a node or of several (n, size).

        Rates are in true time, and zero if the node has none.
        """
        rows = np.atleast_2d(np.asarray(node, dtype=float))
        rates = rows[:, self.rates] if self.order >= 2 else np.zeros((len(rows), self.coordinates.nv))
        if self.time_scale is not None:
            rates = rates / rows[:, self.time_scales[self.time_scale], None]
        return np.hstack([rows[:, self.rotations], rows[:, self.additive], rates])

    def node(
        self, state: np.ndarray, time_scales: np.ndarray, acceleration: np.ndarray | None = None
    ) -> np.ndarray:
        """The node (size,) of a state with rates in true time, at these time scales (n_time_scales,).

        ``acceleration`` (nv,) is the second derivative of the local coordinates in true time, default zero.
        """
        n, scale = len(self.rotations) + len(self.additive), self.scale_of(time_scales)
        second = np.zeros(self.coordinates.nv) if acceleration is None else acceleration * scale**2
        parts = (state[:n], (state[n:] * scale)[: len(self.rates)], second[: len(self.accelerations)])
        return np.concatenate([*parts, time_scales])

    def acceleration(self, node: np.ndarray) -> np.ndarray:
        """Second derivatives (nv,) of the local coordinates at a node of order 3, in true time."""
        return node[self.accelerations] / self.scale_of(node[self.time_scales]) ** 2

    def scale_of(self, time_scales: np.ndarray) -> float:
        """The time scale in which the rates are measured, among those of a node."""
        return 1.0 if self.time_scale is None else float(time_scales[self.time_scale])


@dataclass(frozen=True)
class Stage:
    """A stage of ``phase`` (the one it leads into, for a transition) of nominal duration ``step`` in s."""

    kind: StageKind
    phase: int
    step: float


@dataclass(frozen=True)
class Timeline:
    """Stages, and the form and place of every node, of which there is one more than stages.

    ``places[k]`` is (phase, index of the node within the phase), or None for a node between two
    transitions that repeats another.
    """

    stages: tuple[Stage, ...]
    forms: tuple[NodeLayout, ...]
    places: tuple[tuple[int, int] | None, ...]


class _Builder:
    def __init__(
        self, robot: Robot, schedule: Schedule, modes: Mapping[str, StanceMode], order: int, closed: bool
    ) -> None:
        self.schedule, self.order, self.closed = schedule, order, closed
        self.whole = (robot, Coordinates(robot.model))
        self.modes = [modes.get(phase.name) for phase in schedule.phases]
        made = {id(mode): (mode.robot, Coordinates(mode.robot.model)) for mode in self.modes if mode}
        self.of_phase = [made[id(mode)] if mode else self.whole for mode in self.modes]
        self.time_scales = schedule.time_scales
        self.n_time_scales = sum(index is not None for index in self.time_scales)
        self.known: dict[tuple[int, int | None], NodeLayout] = {}
        self.stages: list[Stage] = []
        self.forms: list[NodeLayout] = []
        self.places: list[tuple[int, int] | None] = []

    def form(self, pair: tuple[Robot, Coordinates], time_scale: int | None) -> NodeLayout:
        key = (id(pair[1]), time_scale)
        if key not in self.known:
            self.known[key] = NodeLayout(*pair, time_scale, self.n_time_scales, self.order)
        return self.known[key]

    def build(self, mesh: Mesh) -> Timeline:
        last = len(self.schedule.phases) - 1
        for phase, own_mesh in enumerate(mesh.phases):
            form = self.form(self.of_phase[phase], self.time_scales[phase])
            if phase == 0:
                self.begin(form)
            duration = self.schedule.phases[phase].duration
            for index, width in enumerate(own_mesh.widths, 1):
                self.stages.append(Stage(StageKind.INTERVAL, phase, duration * width))
                self.node(form, (phase, index))
            self.transitions(phase, phase + 1 if phase < last else None)
        return Timeline(tuple(self.stages), tuple(self.forms), tuple(self.places))

    def node(self, form: NodeLayout, place: tuple[int, int] | None) -> None:
        self.forms.append(form)
        self.places.append(place)

    def begin(self, form: NodeLayout) -> None:
        """Add the first node, for a closed motion in true time so that both ends can be compared."""
        if self.closed and form.time_scale is not None:
            self.node(self.form(self.of_phase[0], None), (0, 0))
            self.change(0, form)
        else:
            self.node(form, (0, 0))

    def transitions(self, before: int, after: int | None) -> None:
        """Add what is needed: change to the whole robot's coordinates, impact, change to the next phase's."""
        impact = after is not None and self.schedule.phases[after].impact
        same = after is not None and self.modes[after] is self.modes[before] and not impact
        lift = self.modes[before] is not None and not same
        here = before if after is None else after
        end = None if after is None and self.closed else self.time_scales[before]
        if lift or end is not self.time_scales[before]:
            self.change(here, self.form(self.whole, end))
        if after is None:
            if self.places[-1] is None:
                self.places[-2:] = [None, self.places[-2]]
            return
        if impact:
            self.stages.append(Stage(StageKind.IMPACT, after, 0.0))
            self.node(self.forms[-1], None)
        self.places[-1] = (after, 0)
        target = self.form(self.of_phase[after], self.time_scales[after])
        if target is not self.forms[-1]:
            self.change(after, target)

    def change(self, phase: int, form: NodeLayout) -> None:
        self.stages.append(Stage(StageKind.CHANGE, phase, 0.0))
        self.node(form, None)


def timeline(
    robot: Robot,
    schedule: Schedule,
    modes: Mapping[str, StanceMode],
    mesh: Mesh,
    order: int,
    closed: bool = False,
) -> Timeline:
    """Stages and nodes of a schedule on a mesh.

    If ``closed``, rates at the first and the last node are in true time, whatever the phases' time scales.
    """
    return _Builder(robot, schedule, modes, order, closed).build(mesh)
