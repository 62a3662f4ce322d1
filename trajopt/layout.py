"""Where every unknown sits: the only index arithmetic of the toolkit.

Unknowns are ordered in time: node 0, controls of interval 0, node 1, ..., node N. A node holds
(rotations, additive positions, rates); the controls of an interval hold, for each point, the second
derivative y (nv) of the local coordinates and the wrenches of the phase's contacts.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from trajopt.manifold import Coordinates
from trajopt.node_terms import NodePlace
from trajopt.robot import Contact, Robot
from trajopt.schedule import Schedule
from trajopt.schemes import Scheme


@dataclass(frozen=True)
class Layout:
    """Index ranges of one transcription; ``intervals`` is the number of intervals of each phase."""

    robot: Robot
    coordinates: Coordinates
    schedule: Schedule
    intervals: tuple[int, ...]
    scheme: Scheme

    @property
    def n_intervals(self) -> int:
        """Number of intervals over the whole schedule."""
        return sum(self.intervals)

    @cached_property
    def phase_of(self) -> np.ndarray:
        """Phase index of each interval (N,)."""
        return np.repeat(np.arange(len(self.intervals)), self.intervals)

    @cached_property
    def steps(self) -> np.ndarray:
        """Duration of each interval in s (N,)."""
        durations = [
            phase.duration / count for phase, count in zip(self.schedule.phases, self.intervals, strict=True)
        ]
        return np.array(durations)[self.phase_of]

    @cached_property
    def node_times(self) -> np.ndarray:
        """Time of each node in s (N + 1,)."""
        return np.concatenate([[0.0], np.cumsum(self.steps)])

    @cached_property
    def contacts(self) -> tuple[tuple[Contact, ...], ...]:
        """Active contacts of each phase."""
        return tuple(
            tuple(self.robot.contact(name) for name in phase.contacts) for phase in self.schedule.phases
        )

    def n_wrench(self, phase: int) -> int:
        """Size of all wrenches at a point of a phase."""
        return sum(contact.dimension for contact in self.contacts[phase])

    def n_control(self, phase: int) -> int:
        """Size of the controls of one interval of a phase."""
        return self.scheme.s * (self.coordinates.nv + self.n_wrench(phase))

    @cached_property
    def node_offset(self) -> np.ndarray:
        """First index of each node (N + 1,)."""
        widths = [self.coordinates.n_node + self.n_control(phase) for phase in self.phase_of]
        return np.concatenate([[0], np.cumsum(widths)]).astype(np.int32)

    @property
    def n_unknowns(self) -> int:
        """Number of unknowns."""
        return int(self.node_offset[-1]) + self.coordinates.n_node

    def node(self, k: int) -> slice:
        """Unknowns of node k."""
        start = int(self.node_offset[k])
        return slice(start, start + self.coordinates.n_node)

    @cached_property
    def local_rotations(self) -> np.ndarray:
        """Indices of the rotations within a node."""
        return np.arange(4 * self.coordinates.n_rotations)

    @cached_property
    def local_additive(self) -> np.ndarray:
        """Indices of the additive positions within a node."""
        return len(self.local_rotations) + np.arange(len(self.coordinates.additive_index))

    @cached_property
    def local_rates(self) -> np.ndarray:
        """Indices of the rates within a node."""
        return self.coordinates.n_node - self.coordinates.nv + np.arange(self.coordinates.nv)

    def local_acceleration(self, phase: int, i: int) -> np.ndarray:
        """Indices of y at point i, within the window (node, controls) of an interval."""
        width = self.coordinates.nv + self.n_wrench(phase)
        return self.coordinates.n_node + i * width + np.arange(self.coordinates.nv)

    def local_wrench(self, phase: int, i: int) -> np.ndarray:
        """Indices of the wrenches at point i, within the window of an interval."""
        width = self.n_wrench(phase)
        start = self.coordinates.n_node + i * (self.coordinates.nv + width) + self.coordinates.nv
        return start + np.arange(width)

    def window_size(self, phase: int) -> int:
        """Size of an interval's window: its start node and its controls."""
        return self.coordinates.n_node + self.n_control(phase)

    def intervals_of(self, phase: int) -> np.ndarray:
        """Indices of a phase's intervals."""
        return np.flatnonzero(self.phase_of == phase)

    def place(self, k: int) -> NodePlace:
        """Phase and fraction of node k; a node between two phases belongs to the later one."""
        last = k == self.n_intervals
        phase = int(self.phase_of[k - 1 if last else k])
        first = int(self.intervals_of(phase)[0])
        return NodePlace(self.schedule.phases[phase], k - first, self.intervals[phase], last)

    def window_scale(
        self, phase: int, node_scale: np.ndarray, y_scale: np.ndarray, w_scale: np.ndarray
    ) -> np.ndarray:
        """Scales of a window from those of a node, of y and of all wrenches at a point."""
        return np.concatenate([node_scale, *[np.concatenate([y_scale, w_scale])] * self.scheme.s])
