"""From a problem and a mesh to the NLP's structure: rows, bounds, scales, groups of point functions.

Rows of stage k, in order: the gap rows ``x_(k+1) - F(x_k, u_k) = 0`` with an identity block in
x_(k+1); the rows of each collocation point, or of an impact; the rows at node k. Every row and every variable
is measured in its natural unit, so that one tolerance means the same everywhere.
"""

import itertools
from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from trajopt.errors import InputError, shown
from trajopt.problem.periodicity import closing_map
from trajopt.problem.problem import Problem
from trajopt.robot.units import Units
from trajopt.terms.context_symbols import ORDERS
from trajopt.terms.moments import MomentConstraint
from trajopt.transcription.collocation import Collocation
from trajopt.transcription.layout import Layout
from trajopt.transcription.mesh import Mesh
from trajopt.transcription.row_collection import LinearRows, RowCollection, RowInfo, over_unknowns
from trajopt.transcription.schemes import Scheme
from trajopt.transcription.sparse_maps import SparseMatrix
from trajopt.transcription.stage_functions import PointFunction
from trajopt.transcription.term_functions import StageTerms, TermFunctions
from trajopt.transcription.timeline import StageKind
from trajopt.transcription.variable_bounds import scaled_rate_limits, variable_bounds

# A moment this close to a node, as a fraction of an interval, is at the node.
AT_NODE = 1e-9
# Fractions of intervals that agree to this many digits share a function group.
DIGITS = 12


@dataclass(frozen=True)
class MomentPlace:
    """Moment number ``index`` of term number ``term``: at a ``fraction`` of the interval ``stage``."""

    term: int
    index: int
    stage: int
    fraction: float


def moments_by_stage(problem: Problem, layout: Layout) -> Mapping[int, list[MomentPlace]]:
    """Moments of a problem's terms by the interval in which they lie, in the order of the terms.

    A node between two intervals of a phase belongs to the later one. Moments at a fixed start are left out,
    because nothing moves there.
    """
    by_stage: defaultdict[int, list[MomentPlace]] = defaultdict(list)
    for number, term in enumerate(problem.moment_constraints):
        for index, (stage, fraction) in enumerate(_places(problem, layout, term)):
            if not (stage == 0 and fraction == 0.0 and problem.periodicity is None):
                by_stage[stage].append(MomentPlace(number, index, stage, fraction))
    return by_stage


def _places(problem: Problem, layout: Layout, term: MomentConstraint) -> list[tuple[int, float]]:
    phase = problem.schedule.names.index(term.during)
    edges, stages = np.array(layout.mesh.phases[phase].fractions), layout.intervals_of(phase)
    numbers = np.clip(np.searchsorted(edges, term.fractions + AT_NODE, side="right") - 1, 0, len(stages) - 1)
    local = (term.fractions - edges[numbers]) / (edges[numbers + 1] - edges[numbers])
    local[np.abs(local) < AT_NODE], local[np.abs(local - 1) < AT_NODE] = 0.0, 1.0
    return [(int(stages[n]), round(float(c), DIGITS)) for n, c in zip(numbers, local, strict=True)]


def alike(layout: Layout, moments: Mapping[int, list[MomentPlace]]) -> list[list[MomentPlace]]:
    """Group the moments of a term at equal fractions of equally wide intervals, which share their gather."""
    groups: defaultdict[tuple[int, float, float], list[MomentPlace]] = defaultdict(list)
    for stage, places in moments.items():
        for moment in places:
            groups[moment.term, moment.fraction, float(layout.steps[stage])].append(moment)
    return list(groups.values())


@dataclass(frozen=True, kw_only=True)
class FunctionGroup:
    """One point function at the same place of several stages.

    Args:
        point: the point function.
        gather: matrix (n_z, window) from a window's scaled variables to z.
        stages: intervals or nodes (n,).
        rows: row indices in the NLP (n, n_rows).
        row_scale: factors of the rows (n_rows,).
        parameters: parameter values (n, n_p).
        cost_weight: weights of the costs (n,).
        fraction: fraction of the intervals at which the points lie.
        varying: functions of time among the parameters, and their columns.
    """

    point: PointFunction
    gather: SparseMatrix
    stages: np.ndarray
    rows: np.ndarray
    row_scale: np.ndarray
    parameters: np.ndarray
    cost_weight: np.ndarray
    fraction: float = 0.0
    varying: tuple[tuple[Callable[[float], np.ndarray], slice], ...] = ()


@dataclass(frozen=True, kw_only=True)
class Transcription:
    """The NLP's structure: variables, rows, groups, linear part and bounds, all in scaled units.

    ``linear`` (n_rows, n_unknowns) is the part of all rows that is linear in the variables, and ``gap_rows``
    holds the row indices of each stage's defect. ``scale`` (n_unknowns,) turns scaled variables into SI
    units. ``redundant`` names, by phase, the contact rows that depend on others (see ``redundancy``). The
    groups' costs are divided by ``objective_unit``, see `objective_unit`.
    """

    problem: Problem
    layout: Layout
    collocation: Collocation
    groups: tuple[FunctionGroup, ...]
    rows: RowInfo
    n_rows: int
    linear: SparseMatrix
    lower_g: np.ndarray
    upper_g: np.ndarray
    lower_x: np.ndarray
    upper_x: np.ndarray
    scale: np.ndarray
    gap_rows: tuple[np.ndarray, ...]
    redundant: Mapping[str, list[str]]
    objective_unit: float

    @property
    def points(self) -> dict[int, PointFunction]:
        """The distinct point functions of the groups, by identity."""
        return {id(group.point): group.point for group in self.groups}


@dataclass(frozen=True)
class _Numbers:
    """Row indices of the gaps, of interval k at point i, of impacts, of nodes and of moments."""

    gap: list[np.ndarray]
    point: dict[int, list[np.ndarray]]
    impact: dict[int, np.ndarray]
    node: dict[int, np.ndarray]
    moment: dict[MomentPlace, int]


class Transcriber:
    """Builds a Transcription step by step; ``build()`` reads top to bottom."""

    def __init__(self, problem: Problem, mesh: Mesh) -> None:
        order = ORDERS[problem.actuation]
        self.problem = problem
        self.layout = Layout(
            problem.robot,
            problem.schedule,
            mesh,
            order,
            dict(problem.modes),
            closed=problem.periodicity is not None,
        )
        robots = {id(form.robot): form.robot for form in self.layout.forms}
        units = {key: Units(robot, problem.robot) for key, robot in robots.items()}
        self.collocation = Collocation(self.layout, units)
        self.functions = TermFunctions(problem, self.layout, units)
        self.moments = moments_by_stage(problem, self.layout)
        self.time = units[id(self.layout.forms[0].robot)].time
        self.linear_rows: list[tuple[np.ndarray, SparseMatrix]] = []
        self.rows = RowCollection()
        self.groups: list[FunctionGroup] = []

    def build(self) -> Transcription:
        """Return the transcription."""
        phases = range(len(self.layout.intervals))
        point_terms = [self.functions.point(phase) for phase in phases]
        impacts = {k: self.functions.impact(k) for k in self.layout.transitions_of(StageKind.IMPACT)}
        nodes = self.functions.nodes()
        moment_terms = [self.functions.moment(term) for term in self.problem.moment_constraints]
        self.functions.require_effects()
        numbers = self._number_rows(point_terms, impacts, nodes, moment_terms)
        for phase in phases:
            self._add_point_groups(phase, point_terms[phase], numbers.point)
            self._add_end_group(phase, numbers.gap)
        for k, terms in impacts.items():
            self._add_impact_group(k, terms, numbers.impact[k])
        for k in self.layout.transitions_of(StageKind.CHANGE):
            self._add_change_group(k, numbers.gap[k])
        self._add_node_groups(nodes, numbers.node)
        self._add_moment_groups(moment_terms, numbers.moment)
        lower_x, upper_x = variable_bounds(self.problem, self.layout, self.collocation)
        return Transcription(
            problem=self.problem,
            layout=self.layout,
            collocation=self.collocation,
            groups=tuple(
                replace(group, cost_weight=group.cost_weight / objective_unit(self.problem))
                for group in self.groups
            ),
            rows=self.rows.info(),
            n_rows=self.rows.count,
            linear=self.collocation.linear_part(numbers.gap, self.linear_rows, self.rows.count),
            lower_g=np.concatenate(self.rows.lower),
            upper_g=np.concatenate(self.rows.upper),
            lower_x=lower_x,
            upper_x=upper_x,
            scale=self.collocation.scale,
            gap_rows=tuple(numbers.gap),
            redundant=self.functions.redundant(),
            objective_unit=objective_unit(self.problem),
        )

    # Rows

    def _number_rows(
        self,
        point_terms: Sequence[StageTerms],
        impacts: dict[int, StageTerms],
        nodes: dict[int, StageTerms],
        moment_terms: Sequence[StageTerms],
    ) -> _Numbers:
        numbers = _Numbers([], {}, {}, {}, {})
        layout = self.layout
        given = (self.problem, layout, self.collocation)
        linear = (*scaled_rate_limits(*given), *schedule_rows(*given))
        for k in range(layout.n_stages + 1):
            if k < layout.n_stages:
                zero = np.zeros(layout.forms[k + 1].size)
                numbers.gap.append(self.rows.add("defect", k, -1, zero, zero))
                if layout.stages[k].kind is StageKind.INTERVAL:
                    blocks = point_terms[layout.phase_of[k]].blocks
                    numbers.point[k] = [
                        self.rows.add_blocks(blocks, k, i)
                        for i in range(layout.scheme_of(layout.stages[k].phase).s)
                    ]
            for term, places in itertools.groupby(self.moments.get(k, ()), key=lambda place: place.term):
                members = list(places)
                ((name, row),) = moment_terms[term].blocks
                bounds = (np.repeat(bound / row.unit, len(members)) for bound in (row.lower, row.upper))
                added = self.rows.add(name, k, -1, *bounds).tolist()
                numbers.moment.update(zip(members, added, strict=True))
            if k in impacts:
                numbers.impact[k] = self.rows.add_blocks(impacts[k].blocks, k, -1)
            if k in nodes:
                numbers.node[k] = self.rows.add_blocks(nodes[k].blocks, k, -1)
            for part in linear:
                if part.node == k:
                    rows = self.rows.add(part.name, k, -1, part.lower, part.upper)
                    self.linear_rows.append((rows, part.coefficients))
        return numbers

    # Groups

    def _add_point_groups(
        self, phase: int, terms: StageTerms, point_rows: dict[int, list[np.ndarray]]
    ) -> None:
        method = self.layout.scheme_of(phase)
        for stages in self._alike(phase):
            for i in range(method.s):
                self.groups.append(
                    FunctionGroup(
                        point=terms.function,
                        gather=self.collocation.point_gather(int(stages[0]), i),
                        stages=stages,
                        rows=np.array([point_rows[k][i] for k in stages]),
                        row_scale=terms.row_scale,
                        parameters=self._parameters(terms, stages, method.c[i]),
                        cost_weight=self.layout.steps[stages] * method.b1[i] / self.time,
                        fraction=float(method.c[i]),
                        varying=terms.varying,
                    )
                )

    def _alike(self, phase: int) -> Iterator[np.ndarray]:
        """Groups of a phase's intervals of equal width, which share the collocation map."""
        stages = self.layout.intervals_of(phase)
        steps = self.layout.steps[stages]
        for step in np.unique(steps):
            yield stages[steps == step]

    def _parameters(self, terms: StageTerms, stages: np.ndarray, fraction: float = 0.0) -> np.ndarray:
        """Parameter values (n, n_p) at a fraction of the stages."""
        times = self.layout.node_times[stages]
        if fraction:
            times = times + fraction * self.layout.steps[stages]
        return np.array([terms.parameters_at(float(t)) for t in times])

    def _add_end_group(self, phase: int, gap_rows: list[np.ndarray]) -> None:
        form = self.layout.form_of(phase)
        end = self.functions.end(form)
        if end is None:
            return
        rotating = [
            part[form.coordinates.rotation_index]
            for part in (form.rates, form.accelerations)[: form.order - 1]
        ]
        local = np.concatenate([form.rotations, *rotating])
        for stages in self._alike(phase):
            self.groups.append(
                _gap_group(
                    end,
                    self.collocation.end_gather(int(stages[0])),
                    stages,
                    np.array([gap_rows[k][local] for k in stages]),
                    self.collocation.node_scale(form)[local],
                )
            )

    def _add_impact_group(self, k: int, terms: StageTerms, rows: np.ndarray) -> None:
        self.groups.append(
            FunctionGroup(
                point=terms.function,
                gather=self.collocation.impact_gather(k),
                stages=np.array([k]),
                rows=rows[None, :],
                row_scale=terms.row_scale,
                parameters=self._parameters(terms, np.array([k])),
                cost_weight=np.ones(1),
            )
        )

    def _add_change_group(self, k: int, gap_rows: np.ndarray) -> None:
        scale = self.collocation.node_scale(self.layout.forms[k + 1])
        gather = self.collocation.node_gather(self.layout.forms[k])
        self.groups.append(
            _gap_group(self.functions.change(k), gather, np.array([k]), gap_rows[None, :], scale)
        )

    def _add_node_groups(self, nodes: dict[int, StageTerms], node_rows: dict[int, np.ndarray]) -> None:
        by_function: dict[int, list[int]] = {}
        for k, terms in nodes.items():
            by_function.setdefault(id(terms.function), []).append(k)
        for members in by_function.values():
            first = nodes[members[0]]
            self.groups.append(
                FunctionGroup(
                    point=first.function,
                    gather=self.collocation.node_gather(self.layout.forms[members[0]]),
                    stages=np.array(members),
                    rows=np.array([node_rows[k] for k in members]),
                    row_scale=first.row_scale,
                    parameters=np.vstack([self._parameters(nodes[k], np.array([k])) for k in members]),
                    cost_weight=np.ones(len(members)),
                )
            )

    def _add_moment_groups(self, terms: Sequence[StageTerms], numbers: dict[MomentPlace, int]) -> None:
        constraints = self.problem.moment_constraints
        for members in alike(self.layout, self.moments):
            first, constraint = members[0], constraints[members[0].term]
            self.groups.append(
                FunctionGroup(
                    point=terms[first.term].function,
                    gather=self.collocation.moment_gather(first.stage, first.fraction, constraint.loads),
                    stages=np.array([moment.stage for moment in members]),
                    rows=np.array([[numbers[moment]] for moment in members]),
                    row_scale=terms[first.term].row_scale,
                    parameters=constraint.parameters[[moment.index for moment in members]],
                    cost_weight=np.zeros(len(members)),
                )
            )


def objective_unit(problem: Problem) -> float:
    """The largest weight of a cost, by which the solver's objective is divided; 1 without costs.

    Only the ratios of weights matter, but a solver's tolerance is absolute: with weights of 1e-9 it would
    accept any feasible point as optimal, and with 1e9 none.
    """
    weights = [term.weight for term in (*problem.costs, *problem.impact_costs)]
    weights += [term.weight for term in problem.node_costs]
    return max(weights, default=0.0) or 1.0


def _gap_group(
    point: PointFunction, gather: SparseMatrix, stages: np.ndarray, rows: np.ndarray, scale: np.ndarray
) -> FunctionGroup:
    """Group of the nonlinear part of x_next - F = 0; ``scale`` holds the units of the rows' entries."""
    return FunctionGroup(
        point=point,
        gather=gather,
        stages=stages,
        rows=rows,
        row_scale=-1 / scale,
        parameters=np.zeros((len(stages), 0)),
        cost_weight=np.zeros(len(stages)),
    )


def transcribe(
    problem: Problem,
    transcription: str | None = None,
    intervals: int | None = None,
    mesh: Mesh | None = None,
) -> Transcription:
    """Transcribe a problem.

    Args:
        problem: what to transcribe.
        transcription: a scheme by name for all phases, or one for each, separated by commas.
        intervals: number of intervals over the whole schedule.
        mesh: scheme and intervals of each phase, instead of the two arguments above.

    Raises:
        InputError: for an unknown scheme, fewer intervals than phases, or a mesh that does not fit.
    """
    chosen = chosen_mesh(problem, transcription, intervals, mesh)
    phases = problem.schedule.phases
    if len(chosen.phases) != len(phases):
        raise InputError(
            f"the mesh has {len(chosen.phases)} phases, problem '{problem.name}' {len(phases)}",
            "allowed: as many",
        )
    for method in (phase.method for phase in chosen.phases):
        if problem.actuation == "velocity" and problem.robot.n_unactuated and 0.0 in method.c:
            raise InputError(
                f"transcription '{method.name}' states the balance of a velocity source twice at every node",
                "allowed for a free base: schemes without a point at the start, such as legendre or radau",
            )
        if problem.actuation == "jerk":
            _require_points(problem, method)
    return Transcriber(problem, chosen).build()


def _require_points(problem: Problem, method: Scheme) -> None:
    """Raise `InputError` for a scheme that does not determine a motion whose input is the jerk.

    Rows at points alone leave the state at nodes free: with contacts, their accelerations would ring. Forces
    through one point would be constant in a phase.
    """
    moving = problem.robot.base != "fixed"
    if method.A3 is None or (moving and (method.s < 2 or method.c[-1] < 1)):
        allowed = "radau:2 to radau:4" if moving else "legendre:1 to legendre:4, radau:1 to radau:4"
        raise InputError(
            f"transcription '{method.name}' of problem '{problem.name}', whose input is the jerk",
            f"allowed{' with a moving base' if moving else ''}: {allowed}",
        )


def chosen_mesh(
    problem: Problem,
    transcription: str | None = None,
    intervals: int | None = None,
    mesh: Mesh | None = None,
) -> Mesh:
    """The mesh to use, by default the problem's own; arguments and errors are those of `transcribe`."""
    if mesh is not None:
        if transcription is not None or intervals is not None:
            raise InputError("a mesh is given with a transcription or intervals", "allowed: one of them")
        return mesh
    total = problem.default_intervals if intervals is None else intervals
    if not isinstance(total, (int, np.integer)) or isinstance(total, bool):
        raise InputError(f"intervals is {shown(total)}", "allowed: a whole number")
    name = problem.default_transcription if transcription is None else transcription
    return Mesh.uniform(name, problem.schedule.intervals(total))


def schedule_rows(problem: Problem, layout: Layout, collocation: Collocation) -> Iterator[LinearRows]:
    """Rows of a problem's periodicity and of the bounds on its total duration, if it has them."""
    if problem.periodicity is not None:
        yield _closing(problem, layout, collocation)
    if problem.duration_bounds is not None and layout.forms[0].n_time_scales:
        yield _duration(problem, layout, collocation)
    if layout.order == 3:
        for before, after in itertools.pairwise(layout.interval_stages.tolist()):
            phase = layout.stages[before].phase
            if phase == layout.stages[after].phase and layout.n_wrench(phase):
                yield _continuous(layout, before, after)


def _continuous(layout: Layout, before: int, after: int) -> LinearRows:
    """Rows by which the polynomials of the wrenches of two intervals of a phase meet at their node."""
    phase = layout.stages[before].phase
    scheme, n = layout.scheme_of(phase), layout.n_wrench(phase)
    blocks = []
    for stage, fraction, sign in ((before, 1.0, 1.0), (after, 0.0, -1.0)):
        block = np.zeros((n, layout.window_size(stage)))
        for i, weight in enumerate(scheme.interpolation(np.array([fraction]))[0]):
            block[np.arange(n), layout.local_wrench(phase, i)] = sign * weight
        blocks.append((stage, block))
    zero = np.zeros(n)
    return LinearRows("force_continuity", after, over_unknowns(layout, blocks), zero, zero)


def _closing(problem: Problem, layout: Layout, collocation: Collocation) -> LinearRows:
    """Rows left z_N - right z_0 - velocity * duration = constant, each in the unit of its entries."""
    assert problem.periodicity is not None
    made = closing_map(problem.robot, problem.periodicity, problem.initial_q, layout.order)
    form, last = layout.forms[0], layout.forms[-1]
    scale = collocation.node_scale(form)
    state = np.setdiff1d(np.arange(form.size), form.time_scales)
    rotations = len(made.left) - (len(state) - len(form.rotations))
    unit = np.concatenate([np.ones(rotations), scale[state[len(form.rotations) :]]])
    first = np.zeros((len(unit), form.size))
    first[:, state] = -made.right
    fixed = made.constant + made.translated @ problem.periodicity.moved(_fixed_duration(layout))
    if problem.periodicity.velocity is not None:
        speed = made.translated @ np.array(problem.periodicity.velocity)
        first[:, form.time_scales] = -np.outer(speed, _free_durations(layout))
    final = np.zeros((len(unit), last.size))
    final[:, state] = made.left
    blocks = [(0, first * scale), (layout.n_stages, final * collocation.node_scale(last))]
    rows = over_unknowns(layout, [(node, block / unit[:, None]) for node, block in blocks])
    return LinearRows("periodicity", layout.n_stages, rows, fixed / unit, fixed / unit)


def _duration(problem: Problem, layout: Layout, collocation: Collocation) -> LinearRows:
    """Sum of the free durations over the time unit; the bounds are reduced by the fixed durations."""
    assert problem.duration_bounds is not None
    form = layout.forms[0]
    unit = collocation.units_of(form).time
    row = np.zeros((1, form.size))
    row[:, form.time_scales] = _free_durations(layout)
    lower, upper = (np.array([bound - _fixed_duration(layout)]) / unit for bound in problem.duration_bounds)
    return LinearRows("duration", 0, over_unknowns(layout, [(0, row / unit)]), lower, upper)


def _free_durations(layout: Layout) -> np.ndarray:
    """Nominal duration of every free phase, in the order of the time scales, s."""
    return np.array([phase.duration for phase in layout.schedule.phases if phase.duration_bounds is not None])


def _fixed_duration(layout: Layout) -> float:
    """Sum of the durations that are not free, s."""
    return float(sum(p.duration for p in layout.schedule.phases if p.duration_bounds is None))
