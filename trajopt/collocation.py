"""What is linear in the unknowns: scales, gathers of points and of ends, and the additive defects."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy import sparse

from trajopt.layout import Layout
from trajopt.units import Units


@dataclass(frozen=True)
class Collocation:
    """The collocation map of a layout's scheme between scaled unknowns, in the robot's units."""

    layout: Layout
    units: Units

    @cached_property
    def node_scale(self) -> np.ndarray:
        """Natural unit of each entry of a node (n_node,)."""
        coordinates = self.layout.coordinates
        additive = self.units.position[coordinates.additive_index]
        return np.concatenate([np.ones(4 * coordinates.n_rotations), additive, self.units.velocity])

    def window_scale(self, phase: int) -> np.ndarray:
        """Natural unit of each entry of a window (node, controls); contacts share the weight."""
        contacts = self.layout.contacts[phase]
        share = self.units.wrench / max(1, len(contacts))
        wrench = np.concatenate([np.zeros(0), *[share[: contact.dimension] for contact in contacts]])
        return self.layout.window_scale(phase, self.node_scale, self.units.acceleration, wrench)

    def scale(self) -> np.ndarray:
        """Natural unit of each unknown (n_unknowns,)."""
        windows = [self.window_scale(phase) for phase in range(len(self.layout.intervals))]
        return np.concatenate([*[windows[phase] for phase in self.layout.phase_of], self.node_scale])

    def point_gather(self, phase: int, i: int) -> sparse.csr_matrix:
        """z = (rotations, xi, xi', xi'', wrenches) at point i from a window's scaled unknowns."""
        layout, scheme = self.layout, self.layout.scheme
        position, rate = self._matrix(phase, scheme.c[i], scheme.A1[i], scheme.A2[i])
        eye = np.eye(layout.window_size(phase))
        acceleration = eye[layout.local_acceleration(phase, i)]
        wrenches = eye[layout.local_wrench(phase, i)]
        z = np.vstack([eye[layout.local_rotations], position, rate, acceleration, wrenches])
        coordinates = layout.coordinates
        assert len(z) == 4 * coordinates.n_rotations + 3 * coordinates.nv + layout.n_wrench(phase)
        return sparse.csr_matrix(z * self.window_scale(phase))

    def end_gather(self, phase: int) -> sparse.csr_matrix:
        """z = (rotations, theta, theta') at an interval's end from a window's scaled unknowns."""
        rotation = self.layout.coordinates.rotation_index
        position, rate = self._end_matrix(phase)
        eye = np.eye(self.layout.window_size(phase))
        z = np.vstack([eye[self.layout.local_rotations], position[rotation], rate[rotation]])
        return sparse.csr_matrix(z * self.window_scale(phase))

    def linear_part(self, gap_rows: np.ndarray, n_rows: int) -> sparse.csr_matrix:
        """Rows (n_rows, n_unknowns): identity of the next node minus the map of what is additive."""
        layout = self.layout
        additive = layout.coordinates.additive_index
        linear_rows = np.concatenate([layout.local_additive, layout.local_rates[additive]])
        rows, columns, values = [], [], []
        for phase in range(len(layout.intervals)):
            position, rate = self._end_matrix(phase)
            block = np.vstack([position[additive], rate[additive]]) * self.window_scale(phase)
            local = sparse.coo_matrix(-block / self.node_scale[linear_rows][:, None])
            for k in layout.intervals_of(phase):
                rows.append(gap_rows[k][linear_rows[local.row]])
                columns.append(layout.node_offset[k] + local.col)
                values.append(local.data)
        for k in range(layout.n_intervals):
            rows.append(gap_rows[k])
            columns.append(np.arange(layout.node(k + 1).start, layout.node(k + 1).stop))
            values.append(np.ones(layout.coordinates.n_node))
        entries = (np.concatenate(values), (np.concatenate(rows), np.concatenate(columns)))
        return sparse.csr_matrix(entries, shape=(n_rows, layout.n_unknowns))

    def _end_matrix(self, phase: int) -> tuple[np.ndarray, np.ndarray]:
        return self._matrix(phase, 1.0, self.layout.scheme.b1, self.layout.scheme.b2)

    def _matrix(self, phase: int, c: float, a1: np.ndarray, a2: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(xi, xi') at fraction c from a window's unscaled unknowns: two matrices (nv, window)."""
        layout, nv = self.layout, self.layout.coordinates.nv
        h = layout.steps[layout.intervals_of(phase)[0]]
        position, rate = np.zeros((2, nv, layout.window_size(phase)))
        every = np.arange(nv)
        position[layout.coordinates.additive_index, layout.local_additive] = 1.0
        position[every, layout.local_rates] = h * c
        rate[every, layout.local_rates] = 1.0
        for j in range(layout.scheme.s):
            columns = layout.local_acceleration(phase, j)
            position[every, columns] = h * h * a2[j]
            rate[every, columns] = h * a1[j]
        return position, rate
