"""One horizon: the NLP of a pattern of contact modes, built once and updated at each tick.

The structure is fixed; durations of phases, the start, the reference and heights of footholds are numbers in
it. Each entry of the collocation map is proportional to a power of the step h of its interval
(docs/mathematics.md, section 2), so the entries for other durations are those for the nominal ones times that
power of the ratio of durations.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from types import MappingProxyType

import numpy as np

from trajopt import _engine
from trajopt.problem.problem import Problem
from trajopt.robot.robot import Robot
from trajopt.robot.units import Units
from trajopt.schedule.schedule import Phase, Schedule
from trajopt.terms.interfaces import PointConstraint, Term
from trajopt.terrain.flat import FlatGround
from trajopt.transcription.compilation import compile_points, entry_key
from trajopt.transcription.guess import initial_guess
from trajopt.transcription.layout import Layout
from trajopt.transcription.mesh import Mesh, PhaseMesh
from trajopt.transcription.nlp import Nlp, assemble
from trajopt.transcription.transcription import Transcription, transcribe

# Compliance of rows that may be violated, by name: one over the weight of the squared violation.
COMPLIANCE: Mapping[str, float] = MappingProxyType(
    {
        "near_links": 1e-4,
        "contact_landing": 1e-4,
        "velocity_limits": 1e-6,
        "position_limits": 1e-6,
        "torque_limits": 1e-7,
        "friction_pyramid": 1e-7,
        "sole_cone": 1e-7,
    }
)


# Largest compliance of the rows of a landing.
SOFTEST = 1.0
# Step of the finite differences of durations, as a fraction of the shortest one.
DIFFERENCE = 1e-4
# Powers of the step h, from 0 to 4: an entry of the Hessian has two positions, each with h^2.
POWERS = 5


@dataclass(frozen=True)
class Pattern:
    """The fixed structure of a horizon: contacts and number of intervals of each phase."""

    contacts: tuple[tuple[str, ...], ...]
    intervals: tuple[int, ...]


@dataclass(frozen=True)
class Numbers:
    """A named parameter of terms, of ``size`` numbers, which a horizon sets at each tick; zero at first."""

    name: str
    size: int

    def __call__(self, time: float) -> np.ndarray:
        """Zeros (size,)."""
        return np.zeros(self.size)


@dataclass(frozen=True)
class _Entries:
    """Entries for nominal durations, and the index of each one's factor in `powers_of`."""

    base: np.ndarray
    place: np.ndarray

    @classmethod
    def of(cls, base: np.ndarray, doubled: np.ndarray, phase: np.ndarray | int) -> _Entries:
        """The monomials from their values at nominal and at doubled durations."""
        with np.errstate(divide="ignore", invalid="ignore"):
            power = np.where(base == 0, 0.0, np.rint(np.log2(np.abs(doubled / base))))
        return cls(base, phase * POWERS + np.nan_to_num(power).astype(int))

    def at(self, powers: np.ndarray) -> np.ndarray:
        """Entries for `powers_of` ratios of durations over the nominal ones."""
        return np.asarray(self.base * powers[self.place])


def powers_of(ratio: np.ndarray) -> np.ndarray:
    """The powers 0 to 4 of ratios (n_phases,), phase by phase."""
    return np.asarray(ratio[:, None] ** np.arange(POWERS)).ravel()


class Horizon:
    """The NLP of a pattern.

    Args:
        robot: the robot.
        pattern: pattern of its contacts.
        terms: costs and constraints, with `Numbers` as varying parameters.
        friction: Coulomb's coefficient of the ground for the transcription, > 0; see `set_friction`.
        scheme: scheme of the transcription.
        nominal: duration of each phase for the transcription, s; see `set_durations`.
        balance: rows that replace `BaseDynamics`.
    """

    def __init__(
        self,
        robot: Robot,
        pattern: Pattern,
        terms: Sequence[Term],
        *,
        friction: float = 0.7,
        scheme: str = "legendre:2",
        nominal: float = 0.1,
        balance: PointConstraint | None = None,
    ) -> None:
        self.robot, self.pattern, self.nominal, self._friction = robot, pattern, nominal, friction
        build = [self._transcription(terms, factor, scheme, balance) for factor in (1.0, 2.0)]
        self.transcription: Transcription = build[0]
        points = {**build[0].points, **build[1].points}
        compiled, self.compilation = compile_points(points.values())
        known = {key: compiled[entry_key(point)] for key, point in points.items()}
        self.nlp, doubled = (assemble(each, known) for each in build)
        t = self.transcription
        self.lower_x, self.upper_x = t.lower_x.copy(), t.upper_x.copy()
        self.lower_g, self.upper_g = t.lower_g.copy(), t.upper_g.copy()
        self.durations = np.full(len(pattern.contacts), nominal)
        self._find_numbers(self.nlp, doubled)
        names = np.array([COMPLIANCE.get(name, 0.0) for name in t.rows.names])
        self.compliance = names[t.rows.block]
        self.solver = _engine.InteriorPoint(self.nlp.engine, *self.bounds, t.layout.stage_numbers)
        self.unequal = np.flatnonzero(t.lower_g != t.upper_g)

    def _transcription(
        self, terms: Sequence[Term], factor: float, scheme: str, balance: PointConstraint | None
    ) -> Transcription:
        """The transcription for ``factor`` times the nominal durations and friction."""
        robot, pattern = self.robot, self.pattern
        phases = tuple(
            Phase(name=f"phase_{i}", duration=factor * self.nominal, contacts=contacts)
            for i, contacts in enumerate(pattern.contacts)
        )
        problem = Problem(
            name="horizon",
            robot=robot,
            schedule=Schedule(phases),
            terrain=FlatGround(friction=factor * self._friction),
            terms=tuple(terms),
            guess=lambda _: robot.reference,
        )
        if balance is not None:
            problem = replace(problem, dynamics=(balance, *problem.motion_rows[1:]))
        meshes = [PhaseMesh.uniform(scheme, count) for count in pattern.intervals]
        return transcribe(problem, mesh=Mesh(phases=tuple(meshes)))

    def _find_numbers(self, nlp: Nlp, doubled: Nlp) -> None:
        """Find how entries depend on the durations of phases, and which parameters scale with friction."""
        layout, t = self.layout, self.transcription
        of_stage = np.append(layout.phase_of, layout.phase_of[-1])
        self._groups: list[dict[str, _Entries]] = []
        self._of_friction: list[np.ndarray] = []
        for group, one, two in zip(t.groups, nlp.parts["groups"], doubled.parts["groups"], strict=True):
            phase = int(of_stage[group.stages[0]])
            names = ("gather_data", "cost_weight", "jac_coef", "hess_coef")
            self._groups.append({name: _Entries.of(one[name], two[name], phase) for name in names})
            self._of_friction.append(one["p"] != two["p"])
        linear, rows = t.linear, t.rows.stage
        self._linear = _Entries.of(linear.data, doubled.parts["a_data"], of_stage[rows[linear.row]])
        constant, twice = nlp.parts["jac_const"], doubled.parts["jac_const"]
        self._constant = _Entries.of(constant, twice, of_stage[rows[nlp.row]])
        self._parameters = [group.parameters.copy() for group in t.groups]

    @property
    def layout(self) -> Layout:
        """Layout of the variables."""
        return self.transcription.layout

    @property
    def bounds(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Scaled lower and upper bounds of the variables, then of the rows."""
        return self.lower_x, self.upper_x, self.lower_g, self.upper_g

    @cached_property
    def units(self) -> Units:
        """Natural units of the robot."""
        return Units(self.robot)

    @cached_property
    def places(self) -> dict[str, list[tuple[int, np.ndarray, float, slice]]]:
        """Places of `Numbers` by name: group, its stages, fraction of the interval, columns."""
        result: dict[str, list[tuple[int, np.ndarray, float, slice]]] = {}
        for number, group in enumerate(self.transcription.groups):
            for function, columns in group.varying:
                if isinstance(function, Numbers):
                    place = number, group.stages, group.fraction, columns
                    result.setdefault(function.name, []).append(place)
        return result

    @cached_property
    def landings(self) -> list[tuple[int, np.ndarray]]:
        """For each landing, its phase and the rows of its contacts' heights, in the order of the contacts."""
        rows = self.transcription.rows
        name = rows.names.index("contact_landing") if "contact_landing" in rows.names else -1
        result = []
        for phase in range(1, len(self.pattern.contacts)):
            new = self.new_contacts(phase)
            stage = int(self.layout.intervals_of(phase)[0])
            at = np.flatnonzero((rows.block == name) & (rows.stage == stage))
            if new:
                result.append((phase, at[: len(new)]))
        return result

    @cached_property
    def first_landing(self) -> np.ndarray:
        """Rows of the landing at the start of the second phase; none if nothing lands there."""
        rows = self.transcription.rows
        if len(self.pattern.contacts) < 2 or "contact_landing" not in rows.names:
            return np.zeros(0, dtype=int)
        stage = int(self.layout.intervals_of(1)[0])
        return np.flatnonzero((rows.block == rows.names.index("contact_landing")) & (rows.stage == stage))

    def set_durations(self, durations: np.ndarray) -> None:
        """Set the durations (n_phases,) of the phases, s, and hand all numbers to the engine."""
        self.durations = np.array(durations, dtype=float)
        powers = powers_of(self.durations / self.nominal)
        for number, numbers in enumerate(self._groups):
            given = {name: entries.at(powers) for name, entries in numbers.items()}
            self.nlp.engine.set_group(number, p=self._parameters[number].ravel(), **given)
        self.nlp.engine.set_linear(self._linear.at(powers), self._constant.at(powers))

    def duration_gradient(self, x: np.ndarray, y: np.ndarray) -> float:
        """Derivative of the optimal cost when time moves from the last phase to the first, 1/s.

        By the envelope theorem it is that of the Lagrangian, here by central differences at an optimum with
        scaled variables x (n_unknowns,) and multipliers y (n_rows,).
        """
        durations, engine, values = self.durations, self.nlp.engine, []
        moved = DIFFERENCE * durations.min()
        for sign in (1, -1):
            changed = durations.copy()
            changed[[0, -1]] += sign * moved * np.array([1, -1])
            self.set_durations(changed)
            values.append(engine.f(x) + float(y @ engine.g(x)))
        self.set_durations(durations)
        return (values[0] - values[1]) / (2 * moved)

    @property
    def steps(self) -> np.ndarray:
        """Duration of each interval, s."""
        return (self.durations / np.array(self.pattern.intervals))[self.layout.phase_of]

    @property
    def node_times(self) -> np.ndarray:
        """Time of each node from the start, s."""
        return np.concatenate([[0.0], np.cumsum(self.steps)])

    def point_times(self, name: str) -> np.ndarray:
        """Times (n,) of all points at which the `Numbers` of that name act, s from the start."""
        begin, step = self.node_times, self.steps
        return np.concatenate([begin[at] + part * step[at] for _, at, part, _ in self.places[name]])

    def set_numbers(self, name: str, rows: np.ndarray) -> None:
        """Set `Numbers` (n, size) at the times of `point_times`; they take effect with `set_durations`."""
        first = 0
        for number, stages, _, columns in self.places[name]:
            self._parameters[number][:, columns] = rows[first : first + len(stages)]
            first += len(stages)

    def set_friction(self, friction: float) -> None:
        """Set Coulomb's coefficient of the ground, > 0; it takes effect with `set_durations`."""
        groups = zip(self.transcription.groups, self._parameters, self._of_friction, strict=True)
        for group, own, places in groups:
            own[places] = group.parameters[places] * (friction / self._friction)

    def set_start(self, state: np.ndarray) -> None:
        """Fix the state of the first node, unscaled."""
        node = self.layout.node(0)
        self.lower_x[node] = self.upper_x[node] = state / self.transcription.scale[node]

    def set_heights(self, heights: Sequence[Mapping[str, float]]) -> None:
        """Set the heights of the frames of landing contacts, m, by name, for each of `landings`."""
        for (phase, rows), named in zip(self.landings, heights, strict=True):
            given = np.array([named[name] for name in self.new_contacts(phase)])
            self.lower_g[rows] = self.upper_g[rows] = given / self.units.length

    def new_contacts(self, phase: int) -> tuple[str, ...]:
        """Contacts that land at the start of a phase."""
        return self.transcription.problem.schedule.new_contacts(phase)

    def soften_landing(self, share: float) -> None:
        """Soften the rows of the first landing if ``share`` < 1: their compliance grows with 1 / share^3."""
        usual = COMPLIANCE["contact_landing"]
        self.compliance[self.first_landing] = min(usual * max(1.0, 1.0 / share) ** 3, SOFTEST)

    def violations(self, x: np.ndarray) -> dict[str, float]:
        """Largest scaled violation of rows by name, at scaled variables x (n_unknowns,)."""
        rows, g = self.transcription.rows, self.nlp.engine.g(x)
        beyond = np.maximum(np.maximum(self.lower_g - g, g - self.upper_g), 0.0)
        worst = np.zeros(len(rows.names))
        np.maximum.at(worst, rows.block, beyond)
        return dict(zip(rows.names, worst.tolist(), strict=True))

    def guess(self) -> np.ndarray:
        """Scaled variables of the robot at rest in its reference posture."""
        return initial_guess(self.transcription)
