"""The linear part of the transcription: variable scales, gather matrices, and linear defect terms."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from trajopt.robot.units import Units
from trajopt.transcription.layout import Layout
from trajopt.transcription.sparse_maps import SparseMatrix
from trajopt.transcription.timeline import NodeLayout, StageKind


@dataclass(frozen=True)
class Collocation:
    """Linear maps of a layout's collocation schemes, over variables scaled by natural units.

    Args:
        layout: layout of the variables.
        units: natural units of each node form's robot, keyed by ``id(robot)``.
    """

    layout: Layout
    units: dict[int, Units]

    def units_of(self, form: NodeLayout) -> Units:
        """Natural units of the robot whose coordinates a node's form uses."""
        return self.units[id(form.robot)]

    def node_scale(self, form: NodeLayout) -> np.ndarray:
        """Natural unit of each entry of a node (size,)."""
        units = self.units_of(form)
        additive = units.position[form.coordinates.additive_index]
        rates, second = units.velocity[: len(form.rates)], units.acceleration[: len(form.accelerations)]
        return np.concatenate(
            [np.ones(len(form.rotations)), additive, rates, second, np.ones(form.n_time_scales)]
        )

    def window_scale(self, k: int) -> np.ndarray:
        """Natural unit of each variable in stage k's window; the contacts share the robot's weight."""
        layout, stage, form = self.layout, self.layout.stages[k], self.layout.forms[k]
        units, node = self.units_of(form), self.node_scale(form)
        if stage.kind is StageKind.CHANGE:
            return node
        impact = stage.kind is StageKind.IMPACT
        contacts = (layout.touching if impact else layout.contacts)[stage.phase]
        share = units.wrench / max(1, len(contacts))
        wrench = np.concatenate([np.zeros(0), *[share[list(contact.rows)] for contact in contacts]])
        if impact:
            return np.concatenate([node, units.velocity, wrench * units.time])
        derivative = (units.velocity, units.acceleration, units.jerk)[layout.order - 1]
        return np.concatenate(
            [node, *[np.concatenate([derivative, wrench])] * layout.scheme_of(stage.phase).s]
        )

    @cached_property
    def scale(self) -> np.ndarray:
        """Natural unit of each variable (n_unknowns,)."""
        windows = [self.window_scale(k) for k in range(self.layout.n_stages)]
        return np.concatenate([*windows, self.node_scale(self.layout.forms[-1])])

    def point_gather(self, stage: int, i: int) -> SparseMatrix:
        """Return the matrix to z at point i, see `Context`."""
        layout, phase = self.layout, int(self.layout.phase_of[stage])
        scheme, form = layout.scheme_of(phase), layout.form_of(phase)
        weights = [matrix[i] for matrix in scheme.points_of(layout.order)]
        lower = self._lower_derivatives(stage, scheme.c[i], weights)
        eye = np.eye(layout.window_size(stage))
        highest = eye[layout.local_derivative(phase, i)]
        wrench = [eye[layout.local_wrench(phase, i)], *self._wrench_rates(stage, scheme.c[i], eye)]
        rows = [eye[form.rotations], *lower, highest, *wrench]
        return SparseMatrix.of(np.vstack([*rows, self._time_scale(eye, form)]) * self.window_scale(stage))

    def moment_gather(self, stage: int, fraction: float, loads: tuple[str, ...]) -> SparseMatrix:
        """Return the matrix to z at a fraction of an interval, with the wrenches of contacts ``loads``."""
        layout, phase = self.layout, int(self.layout.phase_of[stage])
        key = phase, float(layout.steps[stage]), fraction, loads
        if key not in self._moment_gathers:
            self._moment_gathers[key] = self._moment_gather(stage, fraction, loads)
        return self._moment_gathers[key]

    @cached_property
    def _moment_gathers(self) -> dict[tuple[int, float, float, tuple[str, ...]], SparseMatrix]:
        """Cache of the matrices at moments: many pairs of bodies share one."""
        return {}

    def _moment_gather(self, stage: int, fraction: float, loads: tuple[str, ...]) -> SparseMatrix:
        layout, phase = self.layout, int(self.layout.phase_of[stage])
        scheme, form = layout.scheme_of(phase), layout.form_of(phase)
        lower = self._lower_derivatives(stage, fraction, scheme.lower_at(fraction)[: layout.order])
        eye = np.eye(layout.window_size(stage))
        contacts = layout.contacts[phase]
        loaded = np.repeat([c.name in loads for c in contacts], [c.dimension for c in contacts]).astype(bool)
        weights = scheme.interpolation(np.array([fraction]))[0]
        places = [(layout.local_derivative(phase, j), layout.local_wrench(phase, j)) for j in range(scheme.s)]
        highest = np.einsum("j,jin->in", weights, np.array([eye[derivative] for derivative, _ in places]))
        wrench = np.einsum("j,jin->in", weights, np.array([eye[derivative] for _, derivative in places]))
        changes = [rate[loaded] for rate in self._wrench_rates(stage, fraction, eye)]
        rows = [eye[form.rotations], *lower, highest, wrench[loaded], *changes]
        return SparseMatrix.of(np.vstack([*rows, self._time_scale(eye, form)]) * self.window_scale(stage))

    def _wrench_rates(self, stage: int, fraction: float, eye: np.ndarray) -> list[np.ndarray]:
        """Matrix (n_wrench, window) to the wrenches' rates in nominal time, where jerks are the input."""
        layout, phase = self.layout, int(self.layout.phase_of[stage])
        if layout.order < 3:
            return []
        scheme = layout.scheme_of(phase)
        weights = scheme.interpolation_rate(np.array([fraction]))[0] / layout.steps[stage]
        wrenches = np.array([eye[layout.local_wrench(phase, j)] for j in range(scheme.s)])
        return [np.tensordot(weights, wrenches, axes=1)]

    def impact_gather(self, k: int) -> SparseMatrix:
        """Return the matrix to z at an impact: rotations, xi, rates, their jump, impulses, time scale."""
        layout, form = self.layout, self.layout.forms[k]
        eye = np.eye(layout.window_size(k))
        jump, impulse = eye[layout.local_jump(k)], eye[layout.local_impulse(k)]
        rows = [eye[form.rotations], self._positions(eye, form), eye[form.rates], jump, impulse]
        return SparseMatrix.of(np.vstack([*rows, self._time_scale(eye, form)]) * self.window_scale(k))

    def node_gather(self, form: NodeLayout) -> SparseMatrix:
        """Return the matrix to z at a node, which holds the node's own variables."""
        return SparseMatrix.of(np.diag(self.node_scale(form)))

    def end_gather(self, stage: int) -> SparseMatrix:
        """Return the matrix to z at an interval's end: rotations, theta, and theta' if there are rates."""
        layout, form = self.layout, self.layout.forms[stage]
        rotation = form.coordinates.rotation_index
        eye = np.eye(layout.window_size(stage))
        ends = [matrix[rotation] for matrix in self._end_derivatives(stage)]
        return SparseMatrix.of(np.vstack([eye[form.rotations], *ends]) * self.window_scale(stage))

    def linear_part(
        self,
        gap_rows: list[np.ndarray],
        others: list[tuple[np.ndarray, SparseMatrix]],
        n_rows: int,
    ) -> SparseMatrix:
        """Linear part of all rows (n_rows, n_unknowns): the next node minus the linear map to it.

        ``others`` holds further linear rows: (row indices, coefficients over all variables).
        """
        layout = self.layout
        rows = [numbers[matrix.row] for numbers, matrix in others]
        columns = [matrix.indices for _, matrix in others]
        values = [matrix.data for _, matrix in others]
        for k in range(layout.n_stages):
            block = self._linear_map(k)
            scaled = block * self.window_scale(k) / self.node_scale(layout.forms[k + 1])[:, None]
            local = np.nonzero(scaled)
            rows.append(gap_rows[k][local[0]])
            columns.append(layout.node_offset[k] + local[1])
            values.append(-scaled[local])
            node = layout.node(k + 1)
            rows.append(gap_rows[k])
            columns.append(np.arange(node.start, node.stop))
            values.append(np.ones(node.stop - node.start))
        entries = (np.concatenate(part) for part in (rows, columns, values))
        return SparseMatrix.of_entries((n_rows, layout.n_unknowns), *entries)

    def _linear_map(self, k: int) -> np.ndarray:
        """Unscaled linear part (size, window) of the map from stage k's window to the next node."""
        layout, form, kind = self.layout, self.layout.forms[k], self.layout.stages[k].kind
        eye = np.eye(layout.window_size(k))
        block = np.zeros((layout.forms[k + 1].size, layout.window_size(k)))
        if kind is StageKind.CHANGE:
            return block
        block[form.time_scales] = eye[form.time_scales]
        if kind is StageKind.IMPACT:
            block[: form.size] = eye[: form.size]
            block[form.rates] += eye[layout.local_jump(k)]
            return block
        additive = form.coordinates.additive_index
        position, *further = self._end_derivatives(k)
        block[form.additive] = position[additive]
        for entries, matrix in zip((form.rates, form.accelerations), further, strict=False):
            block[entries[additive]] = matrix[additive]
        return block

    def _end_derivatives(self, k: int) -> list[np.ndarray]:
        scheme = self.layout.scheme_of(int(self.layout.phase_of[k]))
        return self._lower_derivatives(k, 1.0, scheme.ends_of(self.layout.order))

    def _lower_derivatives(self, k: int, c: float, weights: Sequence[np.ndarray]) -> list[np.ndarray]:
        """Matrices (nv, window) to xi, xi', ... below the highest derivative, at fraction c of interval k.

        ``weights`` are those (s,) of the first, second, ... integral of the highest derivative.
        """
        layout, form = self.layout, self.layout.forms[k]
        phase, h = layout.stages[k].phase, layout.steps[k]
        eye = np.eye(layout.window_size(k))
        unknown = np.array([eye[layout.local_derivative(phase, j)] for j in range(len(weights[0]))])
        stated = (form.rates, form.accelerations)[: layout.order - 1]
        starts = [self._positions(eye, form), *(eye[part] for part in stated)]
        lower = []
        for derivative in range(layout.order):
            above = layout.order - derivative
            taylor = [starts[derivative + m] * (h * c) ** m / math.factorial(m) for m in range(above)]
            lower.append(sum(taylor) + h**above * np.tensordot(weights[above - 1], unknown, axes=1))
        return lower

    @staticmethod
    def _positions(eye: np.ndarray, form: NodeLayout) -> np.ndarray:
        """Matrix (nv, window) to xi at a node: the additive positions, and zero for rotations."""
        position = np.zeros((form.coordinates.nv, eye.shape[1]))
        position[form.coordinates.additive_index] = eye[form.additive]
        return position

    @staticmethod
    def _time_scale(eye: np.ndarray, form: NodeLayout) -> np.ndarray:
        return eye[form.time_scales[[] if form.time_scale is None else [form.time_scale]]]
