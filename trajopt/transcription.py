"""Problem + scheme -> rows, bounds, scales and groups of point functions: an NLP without numbers of its own.

Rows of stage k, in order: the gap rows ``x_(k+1) - F(x_k, u_k) = 0`` with an identity block in
x_(k+1); the rows of each collocation point; the rows at node k. Every row is divided by its natural
unit, every unknown is measured in its own, so that one tolerance means the same everywhere.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import casadi as ca
import numpy as np
from scipy import sparse

from trajopt.context import Context
from trajopt.errors import InputError
from trajopt.layout import Layout
from trajopt.manifold import Coordinates
from trajopt.node_terms import NodeConstraint
from trajopt.problem import Problem
from trajopt.schemes import Scheme, scheme
from trajopt.stage_functions import PointFunction, point_function
from trajopt.terms import BaseDynamics, ContactAcceleration, Rows
from trajopt.units import Units


@dataclass(frozen=True, kw_only=True)
class Group:
    """One point function at the same place of several stages.

    ``gather`` (n_z, window) maps a window's scaled unknowns to z; ``stages`` (n,) are the intervals or
    nodes; ``rows`` (n, n_rows) are row indices of the NLP; ``row_scale`` (n_rows,); ``parameters``
    (n, n_p); ``cost_weight`` (n,).
    """

    point: PointFunction
    gather: sparse.csr_matrix
    stages: np.ndarray
    rows: np.ndarray
    row_scale: np.ndarray
    parameters: np.ndarray
    cost_weight: np.ndarray


@dataclass(frozen=True, kw_only=True)
class RowInfo:
    """For every row: index of its block's name, stage, and point (-1 at a node or gap)."""

    names: tuple[str, ...]
    block: np.ndarray
    stage: np.ndarray
    point: np.ndarray


@dataclass
class _Rows:
    """Rows collected in order while transcribing."""

    names: list[str] = field(default_factory=list)
    block: list[np.ndarray] = field(default_factory=list)
    stage: list[np.ndarray] = field(default_factory=list)
    point: list[np.ndarray] = field(default_factory=list)
    lower: list[np.ndarray] = field(default_factory=list)
    upper: list[np.ndarray] = field(default_factory=list)
    count: int = 0

    def add(self, name: str, stage: int, point: int, lower: np.ndarray, upper: np.ndarray) -> np.ndarray:
        if name not in self.names:
            self.names.append(name)
        n = len(lower)
        for target, value in ((self.block, self.names.index(name)), (self.stage, stage), (self.point, point)):
            target.append(np.full(n, value, dtype=np.int32))
        self.lower.append(lower)
        self.upper.append(upper)
        first, self.count = self.count, self.count + n
        return np.arange(first, self.count, dtype=np.int32)


@dataclass(frozen=True, kw_only=True)
class Transcription:
    """The NLP's structure: unknowns, rows, groups, linear part, bounds; all in scaled units.

    ``gap_rows`` (N, n_node) and ``linear`` (n_rows, n_unknowns) are the defects' rows and the part of
    all rows that is linear in the unknowns. ``scale`` (n_unknowns,) turns a scaled unknown into SI.
    """

    problem: Problem
    layout: Layout
    groups: tuple[Group, ...]
    rows: RowInfo
    n_rows: int
    linear: sparse.csr_matrix
    lower_g: np.ndarray
    upper_g: np.ndarray
    lower_x: np.ndarray
    upper_x: np.ndarray
    scale: np.ndarray
    gap_rows: np.ndarray

    def stage_sizes(self) -> tuple[list[int], list[int], list[int]]:
        """Numbers of states, controls and path rows of each stage, as a stage-structured solver wants them."""
        layout, n = self.layout, self.layout.coordinates.n_node
        controls = [layout.n_control(int(phase)) for phase in layout.phase_of]
        rows = np.bincount(self.rows.stage, minlength=layout.n_intervals + 1)
        paths = [int(count) - n for count in rows[:-1]] + [int(rows[-1])]
        return [n] * (layout.n_intervals + 1), [*controls, 0], paths


@dataclass(frozen=True)
class _PointKind:
    """A phase's point function with its rows' names, bounds, units and parameters."""

    function: PointFunction
    blocks: tuple[tuple[str, Rows], ...]
    parameters: np.ndarray


class Transcriber:
    """Builds a Transcription step by step; ``build()`` reads top to bottom."""

    def __init__(self, problem: Problem, method: Scheme, intervals: Sequence[int]) -> None:
        self.problem, self.method = problem, method
        self.coordinates = Coordinates(problem.robot.model)
        self.units = Units(problem.robot)
        self.layout = Layout(problem.robot, self.coordinates, problem.schedule, tuple(intervals), method)
        self.rows = _Rows()
        self.groups: list[Group] = []

    def build(self) -> Transcription:
        phases = range(len(self.layout.intervals))
        kinds = [self._point_kind(phase) for phase in phases]
        end = self._end_function()
        nodes = self._node_kinds()
        gap_rows, point_rows, node_rows = self._number_rows(kinds, nodes)
        for phase in phases:
            self._add_point_groups(phase, kinds[phase], point_rows)
            self._add_end_group(phase, end, gap_rows)
        self._add_node_groups(nodes, node_rows)
        lower_x, upper_x = self._variable_bounds()
        rows = self.rows
        return Transcription(
            problem=self.problem,
            layout=self.layout,
            groups=tuple(self.groups),
            rows=RowInfo(
                names=tuple(rows.names),
                block=np.concatenate(rows.block),
                stage=np.concatenate(rows.stage),
                point=np.concatenate(rows.point),
            ),
            n_rows=rows.count,
            linear=self._linear_part(gap_rows),
            lower_g=np.concatenate(rows.lower),
            upper_g=np.concatenate(rows.upper),
            lower_x=lower_x,
            upper_x=upper_x,
            scale=self._scale(),
            gap_rows=gap_rows,
        )

    # Scales

    def _node_scale(self) -> np.ndarray:
        additive = self.units.position[self.coordinates.additive_index]
        return np.concatenate([np.ones(4 * self.coordinates.n_rotations), additive, self.units.velocity])

    def _window_scale(self, phase: int) -> np.ndarray:
        contacts = self.layout.contacts[phase]
        share = self.units.wrench / max(1, len(contacts))
        wrench = (
            np.concatenate([share[: contact.dimension] for contact in contacts]) if contacts else np.zeros(0)
        )
        return self.layout.window_scale(phase, self._node_scale(), self.units.acceleration, wrench)

    def _scale(self) -> np.ndarray:
        windows = [self._window_scale(phase) for phase in range(len(self.layout.intervals))]
        return np.concatenate([*[windows[phase] for phase in self.layout.phase_of], self._node_scale()])

    # Functions

    def _point_kind(self, phase: int) -> _PointKind:
        name, problem = self.problem.schedule.phases[phase].name, self.problem
        context = Context(problem.robot, self.coordinates, self.layout.contacts[phase], node=False)
        costs = [term.value(context, self.units) for term in problem.costs if term.acts_in(name)]
        blocks = []
        for term in (BaseDynamics(), ContactAcceleration(), *problem.point_constraints):
            rows = term.rows(context, self.units) if term.acts_in(name) else None
            if rows is not None:
                blocks.append((term.name, rows))
        function = point_function(
            name, context, sum(costs, ca.SX(0)), [rows.expression for _, rows in blocks]
        )
        return _PointKind(function, tuple(blocks), context.parameter_values)

    def _end_function(self) -> PointFunction | None:
        """Rotations and body rates at an interval's end from (rotations, theta, theta')."""
        n = self.coordinates.n_rotations
        if n == 0:
            return None
        z = ca.SX.sym("z", 10 * n)
        phi = ca.vertcat(*self.coordinates.next_rotations(z[: 4 * n], z[4 * n : 7 * n], z[7 * n :]))
        terms = ca.Function("terms", [z, ca.SX.sym("o", 0), ca.SX.sym("p", 0)], [ca.SX(0), ca.densify(phi)])
        return PointFunction("interval_end", (), terms)

    def _node_kinds(self) -> dict[int, tuple[PointFunction, list[tuple[str, Rows]], np.ndarray]]:
        """For each node with constraints: its function, named rows and parameter values."""
        functions: dict[tuple[object, ...], PointFunction] = {}
        kinds = {}
        for k in range(self.layout.n_intervals + 1):
            place = self.layout.place(k)
            acting = [term for term in self.problem.node_constraints if term.acts_at(place)]
            if not acting:
                continue
            context = Context(self.problem.robot, self.coordinates, (), node=True)
            blocks = [(term.name, term.rows(context, self.units, place)) for term in acting]
            blocks = [(name, rows) for name, rows in blocks if rows.expression.numel()]
            if not blocks:
                continue
            key = (place.phase.name, *(id(term) for term in acting))
            if key not in functions:
                expressions = [rows.expression for _, rows in blocks]
                functions[key] = point_function(f"node_{place.phase.name}", context, ca.SX(0), expressions)
            kinds[k] = (functions[key], blocks, context.parameter_values)
        return kinds

    # Rows

    def _number_rows(self, kinds, nodes):  # type: ignore[no-untyped-def]
        gap, point, node = [], [], {}
        zero = np.zeros(self.coordinates.n_node)
        for k in range(self.layout.n_intervals + 1):
            if k < self.layout.n_intervals:
                gap.append(self.rows.add("defect", k, -1, zero, zero))
                kind = kinds[self.layout.phase_of[k]]
                point.append([self._add_blocks(kind.blocks, k, i) for i in range(self.method.s)])
            if k in nodes:
                node[k] = self._add_blocks(nodes[k][1], k, -1)
        return np.array(gap), point, node

    def _add_blocks(self, blocks, stage: int, point: int) -> np.ndarray:  # type: ignore[no-untyped-def]
        parts = [
            self.rows.add(name, stage, point, rows.lower / rows.unit, rows.upper / rows.unit)
            for name, rows in blocks
        ]
        return np.concatenate(parts) if parts else np.zeros(0, dtype=np.int32)

    # Groups

    def _add_point_groups(self, phase: int, kind: _PointKind, point_rows) -> None:  # type: ignore[no-untyped-def]
        stages = self.layout.intervals_of(phase)
        row_scale = np.concatenate([1 / rows.unit for _, rows in kind.blocks]) if kind.blocks else np.zeros(0)
        for i in range(self.method.s):
            weight = self.layout.steps[stages] * self.method.b1[i] / self.units.time
            self.groups.append(
                Group(
                    point=kind.function,
                    gather=self._gather(phase, i),
                    stages=stages,
                    rows=np.array([point_rows[k][i] for k in stages]),
                    row_scale=row_scale,
                    parameters=np.tile(kind.parameters, (len(stages), 1)),
                    cost_weight=weight,
                )
            )

    def _collocation_matrix(
        self, phase: int, c: float, a1: np.ndarray, a2: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """(xi, xi') at fraction c from a window's unscaled unknowns: two matrices (nv, window)."""
        layout, nv = self.layout, self.coordinates.nv
        h = layout.steps[layout.intervals_of(phase)[0]]
        position, rate = np.zeros((2, nv, layout.window_size(phase)))
        every = np.arange(nv)
        position[self.coordinates.additive_index, layout.local_additive] = 1.0
        position[every, layout.local_rates] = h * c
        rate[every, layout.local_rates] = 1.0
        for j in range(self.method.s):
            columns = layout.local_acceleration(phase, j)
            position[every, columns] = h * h * a2[j]
            rate[every, columns] = h * a1[j]
        return position, rate

    def _gather(self, phase: int, i: int) -> sparse.csr_matrix:
        """z = (rotations, xi, xi', xi'', wrenches) at point i from a window's scaled unknowns."""
        layout, method, nv = self.layout, self.method, self.coordinates.nv
        position, rate = self._collocation_matrix(phase, method.c[i], method.A1[i], method.A2[i])
        eye = np.eye(layout.window_size(phase))
        z = np.vstack([
            eye[layout.local_rotations], position, rate,
            eye[layout.local_acceleration(phase, i)], eye[layout.local_wrench(phase, i)],
        ])  # fmt: skip
        assert z.shape[0] == 4 * self.coordinates.n_rotations + 3 * nv + layout.n_wrench(phase)
        return sparse.csr_matrix(z * self._window_scale(phase))

    def _add_end_group(self, phase: int, end: PointFunction | None, gap_rows: np.ndarray) -> None:
        if end is None:
            return
        layout, rotation = self.layout, self.coordinates.rotation_index
        position, rate = self._collocation_matrix(phase, 1.0, self.method.b1, self.method.b2)
        eye = np.eye(layout.window_size(phase))
        z = np.vstack([eye[layout.local_rotations], position[rotation], rate[rotation]])
        local = np.concatenate([layout.local_rotations, layout.local_rates[rotation]])
        stages = layout.intervals_of(phase)
        self.groups.append(
            Group(
                point=end,
                gather=sparse.csr_matrix(z * self._window_scale(phase)),
                stages=stages,
                rows=gap_rows[stages][:, local],
                row_scale=-1 / self._node_scale()[local],
                parameters=np.zeros((len(stages), 0)),
                cost_weight=np.zeros(len(stages)),
            )
        )

    def _add_node_groups(self, nodes, node_rows) -> None:  # type: ignore[no-untyped-def]
        gather = sparse.csr_matrix(np.diag(self._node_scale()))
        by_function: dict[int, list[int]] = {}
        for k, (function, _, _) in nodes.items():
            by_function.setdefault(id(function), []).append(k)
        for members in by_function.values():
            function, blocks, _ = nodes[members[0]]
            self.groups.append(
                Group(
                    point=function,
                    gather=gather,
                    stages=np.array(members),
                    rows=np.array([node_rows[k] for k in members]),
                    row_scale=np.concatenate([1 / rows.unit for _, rows in blocks]),
                    parameters=np.array([nodes[k][2] for k in members]),
                    cost_weight=np.zeros(len(members)),
                )
            )

    # Linear part and bounds

    def _linear_part(self, gap_rows: np.ndarray) -> sparse.csr_matrix:
        """Identity of the next node minus the collocation map of what is additive."""
        layout, scale = self.layout, self._node_scale()
        linear_rows = np.concatenate(
            [layout.local_additive, layout.local_rates[self.coordinates.additive_index]]
        )
        rows, columns, values = [], [], []
        for phase in range(len(layout.intervals)):
            position, rate = self._collocation_matrix(phase, 1.0, self.method.b1, self.method.b2)
            additive = self.coordinates.additive_index
            block = np.vstack([position[additive], rate[additive]]) * self._window_scale(phase)
            local = sparse.coo_matrix(-block / scale[linear_rows][:, None])
            for k in layout.intervals_of(phase):
                rows.append(gap_rows[k][linear_rows[local.row]])
                columns.append(layout.node_offset[k] + local.col)
                values.append(local.data)
        for k in range(layout.n_intervals):
            rows.append(gap_rows[k])
            columns.append(np.arange(layout.node(k + 1).start, layout.node(k + 1).stop))
            values.append(np.ones(self.coordinates.n_node))
        entries = (np.concatenate(values), (np.concatenate(rows), np.concatenate(columns)))
        return sparse.csr_matrix(entries, shape=(self.rows.count, layout.n_unknowns))

    def _variable_bounds(self) -> tuple[np.ndarray, np.ndarray]:
        """Bounds of nodes from the point constraints that have them, and the fixed start."""
        layout, scale = self.layout, self._node_scale()
        lower = np.full(layout.n_unknowns, -np.inf)
        upper = np.full(layout.n_unknowns, np.inf)
        additive = self.coordinates.additive_index
        for term in self.problem.point_constraints:
            bounds = term.node_bounds(self.problem.robot)
            if bounds is None:
                continue
            free = np.full(4 * self.coordinates.n_rotations, np.inf)
            low = np.concatenate([-free, bounds[0][additive], bounds[2]]) / scale
            high = np.concatenate([free, bounds[1][additive], bounds[3]]) / scale
            for k in range(1, layout.n_intervals + 1):
                lower[layout.node(k)] = np.maximum(lower[layout.node(k)], low)
                upper[layout.node(k)] = np.minimum(upper[layout.node(k)], high)
        start = self.coordinates.node_from_pinocchio(self.problem.initial_q, self.problem.initial_v) / scale
        lower[layout.node(0)] = upper[layout.node(0)] = start
        return lower, upper


def transcribe(
    problem: Problem, transcription: str | None = None, intervals: int | None = None
) -> Transcription:
    """Transcribe a problem with the scheme of that name on ``intervals`` over the whole schedule.

    Raises InputError for an unknown scheme or fewer intervals than phases.
    """
    method = scheme(problem.default_transcription if transcription is None else transcription)
    total = problem.default_intervals if intervals is None else intervals
    if not isinstance(total, (int, np.integer)) or isinstance(total, bool):
        raise InputError(f"intervals is {total!r}", "allowed: a whole number")
    return Transcriber(problem, method, problem.schedule.intervals(total)).build()
