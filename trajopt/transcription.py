"""Problem + scheme -> rows, bounds, scales and groups of point functions: an NLP without numbers of its own.

Rows of stage k, in order: the gap rows ``x_(k+1) - F(x_k, u_k) = 0`` with an identity block in
x_(k+1); the rows of each collocation point; the rows at node k. Every row is divided by its natural
unit, every unknown is measured in its own, so that one tolerance means the same everywhere.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import casadi as ca
import numpy as np
from scipy import sparse

from trajopt.collocation import Collocation
from trajopt.context import Context
from trajopt.errors import InputError
from trajopt.layout import Layout
from trajopt.manifold import Coordinates
from trajopt.problem import Problem
from trajopt.row_collection import RowCollection, RowInfo
from trajopt.schemes import Scheme, scheme
from trajopt.stage_functions import PointFunction, point_function
from trajopt.term_interfaces import Rows
from trajopt.units import Units
from trajopt.variable_bounds import variable_bounds


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
        """Numbers of states, controls and path rows of each stage, as structured solvers want them."""
        layout, n = self.layout, self.layout.coordinates.n_node
        controls = [layout.n_control(int(phase)) for phase in layout.phase_of]
        rows = np.bincount(self.rows.stage, minlength=layout.n_intervals + 1)
        paths = [int(count) - n for count in rows[:-1]] + [int(rows[-1])]
        return [n] * (layout.n_intervals + 1), [*controls, 0], paths


@dataclass(frozen=True)
class _Kind:
    """Function of a phase's points, or of a node, with its rows' names, bounds, units and parameters."""

    function: PointFunction
    blocks: tuple[tuple[str, Rows], ...]
    parameters: np.ndarray

    @property
    def row_scale(self) -> np.ndarray:
        return np.concatenate([np.zeros(0), *[1 / rows.unit for _, rows in self.blocks]])


@dataclass(frozen=True)
class _Numbers:
    """Row indices: of the gaps (N, n_node), of interval k at point i, of the nodes that have rows."""

    gap: np.ndarray
    point: list[list[np.ndarray]]
    node: dict[int, np.ndarray]


class Transcriber:
    """Builds a Transcription step by step; ``build()`` reads top to bottom."""

    def __init__(self, problem: Problem, method: Scheme, intervals: Sequence[int]) -> None:
        self.problem, self.method = problem, method
        self.coordinates = Coordinates(problem.robot.model)
        self.units = Units(problem.robot)
        self.layout = Layout(problem.robot, self.coordinates, problem.schedule, tuple(intervals), method)
        self.collocation = Collocation(self.layout, self.units)
        self.rows = RowCollection()
        self.groups: list[Group] = []

    def build(self) -> Transcription:
        phases = range(len(self.layout.intervals))
        kinds = [self._point_kind(phase) for phase in phases]
        end = self._end_function()
        nodes = self._node_kinds()
        numbers = self._number_rows(kinds, nodes)
        for phase in phases:
            self._add_point_groups(phase, kinds[phase], numbers.point)
            self._add_end_group(phase, end, numbers.gap)
        self._add_node_groups(nodes, numbers.node)
        lower_x, upper_x = variable_bounds(self.problem, self.layout, self.collocation.node_scale)
        return Transcription(
            problem=self.problem,
            layout=self.layout,
            groups=tuple(self.groups),
            rows=self.rows.info(),
            n_rows=self.rows.count,
            linear=self.collocation.linear_part(numbers.gap, self.rows.count),
            lower_g=np.concatenate(self.rows.lower),
            upper_g=np.concatenate(self.rows.upper),
            lower_x=lower_x,
            upper_x=upper_x,
            scale=self.collocation.scale(),
            gap_rows=numbers.gap,
        )

    # Functions

    def _point_kind(self, phase: int) -> _Kind:
        name, problem = self.problem.schedule.phases[phase].name, self.problem
        context = Context(problem.robot, self.coordinates, self.layout.contacts[phase], node=False)
        costs = [term.value(context, self.units) for term in problem.costs if term.acts_in(name)]
        blocks = []
        for term in problem.point_constraints:
            rows = term.rows(context, self.units) if term.acts_in(name) else None
            if rows is not None:
                blocks.append((term.name, rows))
        expressions = [rows.expression for _, rows in blocks]
        function = point_function(name, context, sum(costs, ca.SX(0)), expressions)
        return _Kind(function, tuple(blocks), context.parameter_values)

    def _end_function(self) -> PointFunction | None:
        """Rotations and body rates at an interval's end from (rotations, theta, theta')."""
        n = self.coordinates.n_rotations
        if n == 0:
            return None
        z = ca.SX.sym("z", 10 * n)
        phi = ca.vertcat(*self.coordinates.next_rotations(z[: 4 * n], z[4 * n : 7 * n], z[7 * n :]))
        terms = ca.Function("terms", [z, ca.SX.sym("o", 0), ca.SX.sym("p", 0)], [ca.SX(0), ca.densify(phi)])
        return PointFunction("interval_end", (), terms)

    def _node_kinds(self) -> dict[int, _Kind]:
        """For each node with constraints: its function, named rows and parameter values."""
        functions: dict[tuple[object, ...], PointFunction] = {}
        kinds = {}
        for k in range(self.layout.n_intervals + 1):
            place = self.layout.place(k)
            acting = [term for term in self.problem.node_constraints if term.acts_at(place)]
            if not acting:
                continue
            context = Context(self.problem.robot, self.coordinates, (), node=True)
            named = [(term.name, term.rows(context, self.units, place)) for term in acting]
            blocks = tuple((name, rows) for name, rows in named if rows.expression.numel())
            if not blocks:
                continue
            key = (place.phase.name, *(id(term) for term in acting))
            if key not in functions:
                expressions = [rows.expression for _, rows in blocks]
                functions[key] = point_function(f"node_{place.phase.name}", context, ca.SX(0), expressions)
            kinds[k] = _Kind(functions[key], blocks, context.parameter_values)
        return kinds

    # Rows

    def _number_rows(self, kinds: Sequence[_Kind], nodes: dict[int, _Kind]) -> _Numbers:
        gap, point, node = [], [], {}
        zero = np.zeros(self.coordinates.n_node)
        for k in range(self.layout.n_intervals + 1):
            if k < self.layout.n_intervals:
                gap.append(self.rows.add("defect", k, -1, zero, zero))
                kind = kinds[self.layout.phase_of[k]]
                point.append([self.rows.add_blocks(kind.blocks, k, i) for i in range(self.method.s)])
            if k in nodes:
                node[k] = self.rows.add_blocks(nodes[k].blocks, k, -1)
        return _Numbers(np.array(gap), point, node)

    # Groups

    def _add_point_groups(self, phase: int, kind: _Kind, point_rows: list[list[np.ndarray]]) -> None:
        stages = self.layout.intervals_of(phase)
        for i in range(self.method.s):
            self.groups.append(
                Group(
                    point=kind.function,
                    gather=self.collocation.point_gather(phase, i),
                    stages=stages,
                    rows=np.array([point_rows[k][i] for k in stages]),
                    row_scale=kind.row_scale,
                    parameters=np.tile(kind.parameters, (len(stages), 1)),
                    cost_weight=self.layout.steps[stages] * self.method.b1[i] / self.units.time,
                )
            )

    def _add_end_group(self, phase: int, end: PointFunction | None, gap_rows: np.ndarray) -> None:
        if end is None:
            return
        layout, rotation = self.layout, self.coordinates.rotation_index
        local = np.concatenate([layout.local_rotations, layout.local_rates[rotation]])
        stages = layout.intervals_of(phase)
        self.groups.append(
            Group(
                point=end,
                gather=self.collocation.end_gather(phase),
                stages=stages,
                rows=gap_rows[stages][:, local],
                row_scale=-1 / self.collocation.node_scale[local],
                parameters=np.zeros((len(stages), 0)),
                cost_weight=np.zeros(len(stages)),
            )
        )

    def _add_node_groups(self, nodes: dict[int, _Kind], node_rows: dict[int, np.ndarray]) -> None:
        gather = sparse.csr_matrix(np.diag(self.collocation.node_scale))
        by_function: dict[int, list[int]] = {}
        for k, kind in nodes.items():
            by_function.setdefault(id(kind.function), []).append(k)
        for members in by_function.values():
            first = nodes[members[0]]
            self.groups.append(
                Group(
                    point=first.function,
                    gather=gather,
                    stages=np.array(members),
                    rows=np.array([node_rows[k] for k in members]),
                    row_scale=first.row_scale,
                    parameters=np.array([nodes[k].parameters for k in members]),
                    cost_weight=np.zeros(len(members)),
                )
            )


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
