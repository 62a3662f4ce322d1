"""Readable names of an NLP's variables and rows: owner, quantity, place, time and phase."""

import itertools
from collections import Counter, defaultdict
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Any

import casadi as ca
import numpy as np

from trajopt.robot.contact import Contact
from trajopt.robot.units import Units
from trajopt.terms.context_symbols import Place
from trajopt.terms.dynamics import ImpactDynamics
from trajopt.transcription.layout import Layout
from trajopt.transcription.nlp import Nlp
from trajopt.transcription.symbols import Label, SymbolNames, coordinate_labels, node_labels, wrench_labels
from trajopt.transcription.term_functions import TermFunctions
from trajopt.transcription.timeline import StageKind
from trajopt.transcription.transcription import Transcription

if TYPE_CHECKING:
    from scipy import sparse

# Name of the block of variable bounds.
BOUNDS = "bounds"
# A row with many subjects is named by at most two variables that make up most of its squared gradient.
MOST_UNKNOWNS, MAIN_SHARE = 2, 0.8


@dataclass(frozen=True, kw_only=True, order=True)
class StagePoint:
    """A place: ``stage`` is the index of the node or interval, ``point`` that of the point (-1 at a node)."""

    stage: int
    point: int


@dataclass(frozen=True, kw_only=True, order=True)
class RowName:
    """A row's name: its block, its subject in words (or its number within the block), and its place."""

    block: str
    about: str
    site: StagePoint

    @property
    def what(self) -> str:
        """Block and subject, without the place."""
        return f"{self.block} [{self.about}]"


@dataclass(frozen=True)
class NlpNames:
    """Names of an NLP's variables and rows, with times and derivatives at scaled variables ``x``.

    A row's subject is inferred from the symbols in its term's expression, so user-defined terms are named
    too. If there are many symbols, it is inferred from the row's derivatives.
    """

    nlp: Nlp
    x: np.ndarray
    _known: dict[tuple[Place, int], dict[str, list[str]]] = field(default_factory=dict, init=False)

    @property
    def transcription(self) -> Transcription:
        """The NLP's transcription."""
        return self.nlp.transcription

    @cached_property
    def times(self) -> np.ndarray:
        """Times (n_stages + 1,) of the nodes, s."""
        return self.transcription.layout.times(self.x * self.transcription.scale)

    @cached_property
    def _jacobian(self) -> "sparse.csr_matrix":
        return self.nlp.jacobian(self.x)

    # Places

    def phase_index(self, stage: int) -> int:
        """Phase index of a stage's rows and variables; the last node belongs to the last phase."""
        return self.layout.phase_at(stage)

    def phase(self, stage: int) -> str:
        """Name of a stage's phase."""
        return self.layout.schedule.phases[self.phase_index(stage)].name

    def time(self, site: StagePoint, times: np.ndarray | None = None) -> float:
        """Time of a place in s, with the nodes at ``times`` (n_stages + 1,), by default those at ``x``."""
        nodes = self.times if times is None else times
        start = float(nodes[site.stage])
        if site.point < 0:
            return start
        fraction = float(self.layout.scheme_of(self.phase_index(site.stage)).c[site.point])
        return start + fraction * (float(nodes[site.stage + 1]) - start)

    def place(self, site: StagePoint) -> str:
        """A place in words: ``node 12, t = 0.310 s, phase 'flight'``, or ``interval 12, point 0, ...``."""
        where = f"node {site.stage}"
        if site.point >= 0:
            where = f"interval {site.stage}, point {site.point}"
        elif site.stage < self.layout.n_stages and self.layout.stages[site.stage].step == 0:
            where = f"{self.layout.stages[site.stage].kind.value} at node {site.stage}"
        return f"{where}, t = {self.time(site):.3f} s, phase '{self.phase(site.stage)}'"

    @property
    def layout(self) -> Layout:
        """Layout of the variables."""
        return self.transcription.layout

    @cached_property
    def free_phases(self) -> tuple[str, ...]:
        """Phases of free duration, in the order of their time scales."""
        schedule = self.layout.schedule
        pairs = zip(schedule.phases, schedule.time_scales, strict=True)
        return tuple(phase.name for phase, index in pairs if index is not None)

    # Variables

    @cached_property
    def unknown_labels(self) -> list[Label]:
        """Label of every variable."""
        return [label for label, _ in self._unknowns]

    @cached_property
    def unknown_sites(self) -> list[StagePoint]:
        """Place of every variable."""
        return [site for _, site in self._unknowns]

    @cached_property
    def _unknowns(self) -> list[tuple[Label, StagePoint]]:
        layout = self.layout
        nothing = (Label(owner="", kind="", quantity=""), StagePoint(stage=0, point=-1))
        names = [nothing] * layout.n_unknowns
        every = np.arange(layout.n_unknowns)
        for k, form in enumerate(layout.forms):
            site = StagePoint(stage=k, point=-1)
            _put(names, every[layout.node(k)], node_labels(form, self.free_phases), site)
            if k == layout.n_stages:
                break
            window, stage = every[layout.window(k)], layout.stages[k]
            if stage.kind is StageKind.IMPACT:
                jumps = coordinate_labels(form.robot, form.coordinates, "jump")
                _put(names, window[layout.local_jump(k)], jumps, site)
                impulses = _wrenches(layout.touching[stage.phase], "impulse", "angular impulse")
                _put(names, window[layout.local_impulse(k)], impulses, site)
            elif stage.kind is StageKind.INTERVAL:
                self._name_interval(names, window, k)
        return names

    def _name_interval(self, names: list[tuple[Label, StagePoint]], window: np.ndarray, k: int) -> None:
        layout, form = self.layout, self.layout.forms[k]
        phase = layout.stages[k].phase
        kind = ("rate", "acceleration", "jerk")[layout.order - 1]
        labels = coordinate_labels(form.robot, form.coordinates, kind)
        forces = _wrenches(layout.contacts[phase], "force", "moment")
        for i in range(layout.scheme_of(phase).s):
            site = StagePoint(stage=k, point=i)
            _put(names, window[layout.local_derivative(phase, i)], labels, site)
            _put(names, window[layout.local_wrench(phase, i)], forces, site)

    # Rows

    @cached_property
    def sites(self) -> list[StagePoint]:
        """Place of every row, then of every variable."""
        rows = self.transcription.rows
        pairs = zip(rows.stage.tolist(), rows.point.tolist(), strict=True)
        return [*(StagePoint(stage=stage, point=point) for stage, point in pairs), *self.unknown_sites]

    @cached_property
    def row_numbers(self) -> list[int]:
        """Number of every row within its block at its place."""
        rows = self.transcription.rows
        numbers: defaultdict[tuple[int, int, int], Iterator[int]] = defaultdict(itertools.count)
        keys = zip(rows.block.tolist(), rows.stage.tolist(), rows.point.tolist(), strict=True)
        return [next(numbers[key]) for key in keys]

    def block(self, index: int) -> str:
        """Name of a row's block; indices beyond the rows are variables, whose bounds are one block."""
        rows = self.transcription.rows
        return rows.names[int(rows.block[index])] if index < len(rows.block) else BOUNDS

    def row(self, index: int) -> RowName:
        """Name of a row, or of the bound of a variable, numbered as in ``block``."""
        block, site = self.block(index), self.sites[index]
        if block == BOUNDS:
            label = self.unknown_labels[index - self.transcription.n_rows]
            return RowName(block=BOUNDS, about=str(label), site=site)
        number, about = self.row_numbers[index], ""
        if block == "defect":
            about = str(node_labels(self.layout.forms[site.stage + 1], self.free_phases)[number])
        else:
            subjects = self._subjects_at(site).get(block, [])
            about = subjects[number] if number < len(subjects) else ""
        if not about:
            about = ", ".join(part for part in (f"row {number}", self._by_weight(index)) if part)
        return RowName(block=block, about=about, site=site)

    def row_text(self, index: int) -> str:
        """A row in words, with its place, or a bound: ``bounds [FL_KFE rate, node 12, ...]``."""
        name, place = self.row(index), self.place(self.sites[index])
        return f"{BOUNDS} [{name.about}, {place}]" if name.block == BOUNDS else f"{name.what}, {place}"

    def _by_weight(self, index: int) -> str:
        """The variables with the largest coefficients in a row, if one or two dominate it."""
        weights: defaultdict[str, float] = defaultdict(float)
        row = self._jacobian[index]
        for column, value in zip(row.indices, row.data, strict=True):
            weights[str(self.unknown_labels[int(column)])] += float(value) ** 2
        largest = sorted(weights, key=lambda label: -weights[label])
        total = sum(weights.values())
        for count in range(1, MOST_UNKNOWNS + 1):
            if sum(weights[label] for label in largest[:count]) >= MAIN_SHARE * total > 0:
                return "mostly " + "; ".join(largest[:count])
        return ""

    def _subjects_at(self, site: StagePoint) -> dict[str, list[str]]:
        """Subjects, by block, of the rows at a point, or at an impact followed by those at its node."""
        layout, k = self.layout, site.stage
        if site.point >= 0:
            return self._subjects_of(int(layout.phase_of[k]), Place.POINT, k)
        rows: defaultdict[str, list[str]] = defaultdict(list)
        parts = []
        if k < layout.n_stages and layout.stages[k].kind is StageKind.IMPACT:
            parts.append(self._subjects_of(layout.stages[k].phase, Place.IMPACT, k))
        if layout.place(k) is not None:
            parts.append(self._subjects_of(layout.place_phase(k), Place.NODE, k))
        for name, subjects in itertools.chain.from_iterable(part.items() for part in parts):
            rows[name] += subjects
        return rows

    @cached_property
    def functions(self) -> TermFunctions:
        """Builder of this transcription's contexts."""
        problem, layout = self.transcription.problem, self.layout
        robots = {id(form.robot): form.robot for form in layout.forms}
        return TermFunctions(problem, layout, {key: Units(r, problem.robot) for key, r in robots.items()})

    def units_at(self, place: Place, k: int) -> Units:
        """Units of the terms at a place of stage k."""
        units = self.functions.units[id(self.layout.forms[k].robot)]
        return units.impulsive() if place is Place.IMPACT else units

    def acting_terms(self, phase: int, place: Place, k: int) -> list[Any]:
        """Costs and constraints that act at a place of stage k."""
        problem, at = self.transcription.problem, self.layout.place(k)
        if place is Place.NODE:
            candidates: tuple[Any, ...] = (*problem.node_constraints, *problem.node_costs)
            return [term for term in candidates if at is not None and term.acts_at(at)]
        name, impact = problem.schedule.phases[phase].name, place is Place.IMPACT
        costs = problem.impact_costs if impact else problem.costs
        acting: list[Any] = [t for t in (*costs, *problem.point_constraints) if t.acts_in(name)]
        return [ImpactDynamics(), *(t for t in acting if t.acts_at_impacts)] if impact else acting

    def _subjects_of(self, phase: int, place: Place, k: int) -> dict[str, list[str]]:
        """Subjects by block, cached per node, and per phase for points and impacts."""
        key = (place, k if place is Place.NODE else phase)
        if key not in self._known:
            self._known[key] = self._read_subjects(phase, place, k)
        return self._known[key]

    def _read_subjects(self, phase: int, place: Place, k: int) -> dict[str, list[str]]:
        """Subjects of the rows by block; rows of a block with the same subject are numbered."""
        form, at = self.layout.forms[k], (self.layout.place(k),) if place is Place.NODE else ()
        context, units = self.functions.context(phase, form, place), self.units_at(place, k)
        constraints = [term for term in self.acting_terms(phase, place, k) if hasattr(term, "rows")]
        blocks = [(term.name, term.rows(context, units, *at)) for term in constraints]
        names = SymbolNames(context, form, self.free_phases)  # of all symbols that the rows have used so far
        columns: defaultdict[str, list[str]] = defaultdict(list)
        for block, rows in blocks:
            if rows is not None and rows.expression.numel():
                columns[block] += [names.row(entry) for entry in ca.vertsplit(rows.expression)]
        return {block: _with_numbers(subjects) for block, subjects in columns.items()}


def _put(
    names: list[tuple[Label, StagePoint]], indices: np.ndarray, labels: Iterable[Label], site: StagePoint
) -> None:
    for index, label in zip(indices.tolist(), labels, strict=True):
        names[index] = (label, site)


def _wrenches(contacts: Iterable[Contact], linear: str, angular: str) -> list[Label]:
    return [
        label for contact in contacts for label in wrench_labels(contact.name, contact.rows, linear, angular)
    ]


def _with_numbers(subjects: list[str]) -> list[str]:
    count = Counter(subjects)
    numbers = {subject: itertools.count(1) for subject in count if subject and count[subject] > 1}
    return [f"{one} ({next(numbers[one])})" if one in numbers else one for one in subjects]
