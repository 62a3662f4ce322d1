"""Exchange method for collision avoidance: add rows where a motion collides, until it no longer does.

A robot's links form hundreds of pairs that could collide, of which hardly any do. The motion is therefore
solved without collision rows and sampled along its whole length, also between collocation points. Pairs that
come too near get rows (see `trajopt.collision.planes`) at the moments where they are near, and the problem is
solved again from there, until the motion is clear. This is the exchange method for semi-infinite programs
(Blankenship and Falk, "Infinitely constrained optimization problems", 1976).
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
import pinocchio as pin

from trajopt.certify.report import PENETRATION
from trajopt.collision.joint_distance import JointDistances
from trajopt.collision.near import ShapePair
from trajopt.collision.planes import PlacedBody, SeparatingPlane
from trajopt.motion.configurations import SolutionMotion
from trajopt.motion.interpolation import collocation_fractions
from trajopt.motion.solution import Solution
from trajopt.problem.bodies import GAP_SLACK, ProblemBodies, bodies_of, contacts_by_shape
from trajopt.problem.problem import Problem
from trajopt.robot.contact import Contact
from trajopt.robot.kinematics import contact_poses
from trajopt.robot.units import Units
from trajopt.terms.moments import LinkDistance, MomentConstraint, PlaneSide, joint_row, plane_row

# A pair that is too near somewhere gets rows wherever its distance is below its margin plus REACH times its
# largest violation, clipped to these fractions of the robot's length: a motion that yields in one place may
# come near in another.
REACH, LEAST_BAND, BAND = 4.0, 0.005, 0.04
# Tolerance to which rows are met, m.
LEAST_SLACK = 2e-5
# Each interval is sampled at its collocation points and at this many even fractions between its nodes; more
# where a coordinate changes by more than LOOK_STEP between samples, in natural units (rad, robot lengths).
INTERVAL_LOOKS, LOOK_STEP = 5, 0.03
# If a pair that has rows is too near in this many looks, its distance is no longer fitted (MOST_MISSES) and
# it gets rows wherever it is too near, not only at local minima (MOST_SLIPS): a motion slips between those.
MOST_MISSES, MOST_SLIPS = 3, 4
# Moments are rounded to this many digits to compare them.
DIGITS = 12

# A phase and a fraction of its duration; and a motion that returns (K, nq) at K of these.
PhaseMoment = tuple[int, float]
PhaseMotion = Callable[[np.ndarray, np.ndarray], np.ndarray]


@dataclass(frozen=True, kw_only=True, eq=False)
class Look:
    """Distances (K, n_pairs) m along a motion at K moments; ``regular`` (K,) marks nodes and points."""

    distances: np.ndarray
    moments: tuple[PhaseMoment, ...]
    regular: np.ndarray


@dataclass
class Exchange:
    """Pairs of bodies with rows, their moments and their corners; these sets only grow from look to look.

    Args:
        problem: The problem without collision rows.
        moments: Moments at which each pair has rows.
        corners: Corners (n, 3) m by pair, moment, their frame and the body that carries the plane.
        shortfall: Largest violation of each pair's margin so far, m.
        misses: Number of looks in which a pair was too near although it had rows.
        beyond_feet: Whether planes are laid so that feet are beyond them, see `planes.beyond_foot`.

    Raises `InputError` for a problem whose bodies overlap at its start or at a goal.
    """

    problem: Problem
    moments: defaultdict[ShapePair, set[PhaseMoment]] = field(default_factory=lambda: defaultdict(set))
    corners: dict[tuple[ShapePair, PhaseMoment, str | None, str | None], np.ndarray] = field(
        default_factory=dict
    )
    shortfall: defaultdict[ShapePair, float] = field(default_factory=lambda: defaultdict(float))
    misses: defaultdict[ShapePair, int] = field(default_factory=lambda: defaultdict(int))
    beyond_feet: bool = False

    def __post_init__(self) -> None:
        self.bodies: ProblemBodies = bodies_of(self.problem)
        self.fits = JointDistances(self.bodies.scene)

    @property
    def band(self) -> float:
        """Largest distance beyond its margin at which a pair gets rows, m."""
        return BAND * self.problem.robot.length

    @cached_property
    def _least(self) -> np.ndarray:
        """Smallest allowed distance (n_pairs,) m: the margin less `GAP_SLACK`.

        The ground is penetrated by no more than the check allows.
        """
        margins = self.bodies.margins
        return np.minimum(np.maximum(margins - GAP_SLACK, -PENETRATION), margins - LEAST_SLACK)

    def moved_to(self, problem: Problem) -> Exchange:
        """Return the same pairs, moments and link corners for a problem with other parameters."""
        made = Exchange(problem, beyond_feet=self.beyond_feet)
        known = set(made.bodies.pairs)
        made.moments.update({pair: set(moments) for pair, moments in self.moments.items() if pair in known})
        made.corners |= {
            (pair, moment, frame, body): corners
            for (pair, moment, frame, body), corners in self.corners.items()
            if pair in known and frame is not None
        }
        return made

    def look(self, solution: Solution, times: Sequence[float] = ()) -> Look:
        """Sample the distances of all pairs along a solution, and at ``times`` s; exact within the band.

        The distance of a foot from the ground that its active contact touches counts as infinite: the contact
        holds it there, and further rows would be linearly dependent on the contact's. So does the distance of
        a body in phases that do not carry it.
        """
        plan = solution.normalized()
        units = Units(self.problem.robot).position
        numbers, fractions, regular = _moments_to_look_at(plan, units, times, self._ends(plan))
        q = plan.polynomials.at(numbers, fractions).q
        distances = self.bodies.scene.distances(q, self.band + self.bodies.widest)
        moments = _in_phases(plan, numbers, fractions)
        apart = self._apart[[phase for phase, _ in moments]]
        return Look(distances=np.where(apart, np.inf, distances), moments=moments, regular=regular)

    def _ends(self, plan: Solution) -> np.ndarray:
        """Return a mask of the intervals at whose end a carried body is put down, or the motion ends."""
        phases = plan.phase[[rows.start for rows in plan.intervals]]
        gone = (self.bodies.present[phases[:-1]] & ~self.bodies.present[phases[1:]]).any(axis=1)
        return np.append(gone, True)

    def missing(self, look: Look) -> tuple[ShapePair, ...]:
        """Return the pairs that are too near somewhere."""
        short = (look.distances - self._least).min(axis=0, initial=np.inf)
        return tuple(pair for pair, distance in zip(self.bodies.pairs, short, strict=True) if distance < 0)

    def depth(self, look: Look) -> float:
        """Return by how much the worst pair is too near, m; zero if none is."""
        return float((self._least - look.distances).max(initial=0.0))

    def sideless_depth(self, look: Look, known: bool) -> float:
        """Return `depth` over the pairs whose bodies may pass each other on several sides.

        This leaves out pairs with the ground and links whose distance is fitted, and unless ``known`` pairs
        that have rows.
        """
        n, pairs = self.bodies.scene.n_ground, self.bodies.pairs
        sided = [
            k for k, p in enumerate(pairs[n:], n) if (known or p not in self.moments) and not self._fitted(p)
        ]
        return float((self._least - look.distances)[:, sided].max(initial=0.0))

    def add(self, look: Look, kept: Sequence[ShapePair] = ()) -> bool:
        """Add moments where pairs are near that are or were too near; return whether any are new.

        The pairs in ``kept`` get rows where they are near as well.
        """
        before, length = sum(map(len, self.moments.values())), self.problem.robot.length
        missing = self.missing(look)
        wanted = {*missing, *self.moments, *kept}
        short = look.distances - self.bodies.margins
        for column, pair in enumerate(self.bodies.pairs):
            if pair in wanted:
                self.misses[pair] += pair in self.moments and pair in missing
                distances = short[:, column]
                missed = look.distances[:, column] < self._least[column]
                self.shortfall[pair] = max(self.shortfall[pair], -float(distances.min()))
                band = np.clip(REACH * self.shortfall[pair], LEAST_BAND * length, self.band)
                deepest = missed if self.misses[pair] > MOST_SLIPS else missed & _least_around(distances)
                near = (distances < band) & look.regular | deepest
                if near.any():
                    self.moments[pair] |= {look.moments[row] for row in np.flatnonzero(near)}
        return sum(map(len, self.moments.values())) > before

    def take_up(self, solution: Solution) -> None:
        """Add rows for the pairs that had rows in a given solution, where they are near in it."""
        known = set(solution.statistics.row_names)
        held = [pair for pair in self.bodies.pairs if known & self._row_names(pair)]
        if held:
            self.add(self.look(solution), held)

    def _row_names(self, pair: ShapePair) -> set[str]:
        model = self.problem.robot.model
        frames = {shape.name: shape.frame for shape in self.bodies.scene.shapes}
        one, other = (frames.get(name) for name in pair)
        joints = tuple(model.names[joint] for joint in self.fits.joints(pair))
        return {plane_row(one, other), plane_row(other, one)} | ({joint_row(joints)} if joints else set())

    def constrained(self, motion: PhaseMotion, last: PhaseMotion | None = None) -> Problem:
        """Return the problem with rows at all moments so far, with planes laid along a motion.

        Args:
            motion: Phases, fractions (K,) -> configurations (K, nq), for example `along` or `guess`.
            last: The motion that was too near, if different: its nearest corners get rows as well.
        """
        if last is not None:
            for _ in self._laid(last):
                pass
        groups: defaultdict[tuple[int, str | None, str | None], list[tuple[float, SeparatingPlane]]]
        groups = defaultdict(list)
        for (phase, fraction), plane in self._laid(motion):
            groups[phase, plane.frame, plane.body].append((fraction, plane))
        terms: list[MomentConstraint] = [
            PlaneSide(
                during=self.problem.schedule.names[phase],
                frame=frame,
                body=body,
                fractions=np.repeat([f for f, _ in members], [len(plane.corners) for _, plane in members]),
                parameters=np.concatenate([plane.parameters for _, plane in members]),
            )
            for (phase, frame, body), members in groups.items()
        ]
        return replace(self.problem, terms=(*self.problem.terms, *terms, *self._distances(motion)))

    def _distances(self, motion: PhaseMotion) -> Iterator[LinkDistance]:
        """Yield rows for links whose distances are fitted, around a motion."""
        model, names = self.problem.robot.model, self.problem.schedule.names
        for pair in filter(self._fitted, self.moments):
            moments = sorted(self.moments[pair])
            phases, fractions = _as_arrays(moments)
            rows = self.fits.rows(pair, motion(phases, fractions), self.bodies.margin_of[pair])
            for phase in np.unique(phases):
                yield LinkDistance(
                    during=names[phase],
                    joints=tuple(model.names[joint] for joint in self.fits.joints(pair)),
                    fractions=fractions[phases == phase],
                    parameters=rows[phases == phase],
                )

    def _fitted(self, pair: ShapePair) -> bool:
        """Return whether a pair's distance is fitted by a polynomial; not after too many misses."""
        return self.misses[pair] < MOST_MISSES and bool(self.fits.joints(pair))

    def starts(
        self, solution: Solution, guess_first: bool = False
    ) -> Iterator[tuple[Problem, Solution | None]]:
        """Yield problems with rows and their starts: the last motion, then the guess (None), or vice versa.

        The same follows with planes that feet are beyond, which are then kept: see `planes.beyond_foot`.
        """
        if not self.moments:
            yield from ((self.problem, solution), (self.problem, None))
            return
        last = along(solution)
        for beyond_feet in (True,) if self.beyond_feet else (False, True):
            self.beyond_feet = beyond_feet
            for from_guess in (guess_first, not guess_first):
                if from_guess:
                    yield self.constrained(self.guess, last), None
                else:
                    yield self.constrained(last), solution

    def guess(self, phases: np.ndarray, fractions: np.ndarray) -> np.ndarray:
        """Return the problem's guess (K, nq) at fractions of phases (K,)."""
        durations = np.array([entry.duration for entry in self.problem.schedule.phases])
        times = (np.cumsum(durations) - durations)[phases] + fractions * durations[phases]
        return np.array([self.problem.guess_at(time) for time in times.tolist()])

    def guess_is_clear(self) -> bool:
        """Return whether the pairs with rows are far enough apart along the guess at all their moments."""
        every = sorted({moment for moments in self.moments.values() for moment in moments})
        if not every:
            return True
        phases, fractions = _as_arrays(every)
        distances = self.bodies.scene.distances(self.guess(phases, fractions), self.band + self.bodies.widest)
        short = np.where(self.bodies.present[phases], distances - self._least, np.inf)
        columns = [column for column, pair in enumerate(self.bodies.pairs) if pair in self.moments]
        return bool((short[:, columns] >= 0).all())

    def _laid(self, motion: PhaseMotion) -> Iterator[tuple[PhaseMoment, SeparatingPlane]]:
        separated = {pair: moments for pair, moments in self.moments.items() if not self._fitted(pair)}
        every = sorted({moment for moments in separated.values() for moment in moments})
        if not every:
            return
        numbers = {moment: k for k, moment in enumerate(every)}
        q = motion(*_as_arrays(every))
        pairs = [(pair, moment) for pair, moments in separated.items() for moment in sorted(moments)]
        wanted = [(numbers[moment], pair) for pair, moment in pairs]
        feet: list[PlacedBody | None] = [None] * len(wanted)
        if self.beyond_feet:
            poses = [contact_poses(self.problem.robot, row) for row in q]
            feet = [self._feet(pair, poses[number]) for number, pair in wanted]
        laid = self.bodies.planes(q, wanted, self.band, feet)
        for (pair, moment), planes in zip(pairs, laid, strict=True):
            for plane in planes:
                key = (pair, moment, plane.frame, plane.body)
                kept = plane.with_corners(self.corners.get(key, plane.corners))
                self.corners[key] = kept.corners
                yield moment, kept

    @cached_property
    def _contacts(self) -> dict[str, list[Contact]]:
        return contacts_by_shape(self.problem.robot, self.bodies.scene.shapes)

    @cached_property
    def _apart(self) -> np.ndarray:
        """Mask (n_phases, n_pairs) of feet and the ground on which their active contacts hold them.

        Pairs with a body that is not carried in the phase are marked as well.
        """
        bodies, phases = self.bodies, self.problem.schedule.phases
        apart = ~bodies.present
        shapes = {shape.name: shape for shape in bodies.scene.shapes}
        for column, (first, _) in enumerate(bodies.pairs[: bodies.scene.n_ground]):
            names = {c.name for c in self._contacts[first] if bodies.is_foot(shapes[first], c)}
            apart[:, column] |= [not names.isdisjoint(phase.contacts) for phase in phases]
        return apart

    def _feet(self, pair: ShapePair, poses: Mapping[str, pin.SE3]) -> PlacedBody | None:
        """Return the contacts of the first link of a pair as points in the world."""
        contacts = self._contacts[pair[0]]
        if not contacts:
            return None
        corners = [poses[c.name].act(np.array([*corner, 0.0])) for c in contacts for corner in c.corners]
        return PlacedBody(points=np.array(corners), radius=min(contact.radius for contact in contacts))


def _as_arrays(moments: Sequence[PhaseMoment]) -> tuple[np.ndarray, np.ndarray]:
    """Return the phases and fractions (K,) of moments."""
    phases, fractions = zip(*moments, strict=True)
    return np.array(phases), np.array(fractions)


def along(solution: Solution) -> PhaseMotion:
    """Return the motion of a solution as a function of phase and fraction."""
    motion = SolutionMotion(solution)
    return lambda phases, fractions: motion.in_phase(phases, fractions, 0.5).q


def _moments_to_look_at(
    plan: Solution, units: np.ndarray, times: Sequence[float], ends: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return interval numbers and fractions (K,) to sample, and a mask of nodes and collocation points.

    The end of an interval is sampled where ``ends`` is true; elsewhere as the start of the next one.
    """
    numbers, fractions, regular = [], [], []
    for number in range(plan.n_intervals):
        looked_at = np.unique(np.round([0.0, *collocation_fractions(plan.arrays, number)[1], 1.0], DIGITS))
        start, end = plan.interval_t[number]
        travel = (end - start) * float((np.abs(plan.v[plan.intervals[number]]) / units).max())
        looks = max(INTERVAL_LOOKS, math.ceil(travel / LOOK_STEP))
        further = [(time - start) / (end - start) for time in times if start < time < end]
        evenly = np.linspace(0.0, 1.0, looks + 2)
        every = np.unique(np.round(np.concatenate([looked_at, evenly, further]), DIGITS))
        if not ends[number]:
            every = every[every < 1.0]
        numbers.append(np.full(len(every), number))
        fractions.append(every)
        regular.append(np.isin(every, looked_at))
    return np.concatenate(numbers), np.concatenate(fractions), np.concatenate(regular)


def _in_phases(plan: Solution, numbers: np.ndarray, fractions: np.ndarray) -> tuple[PhaseMoment, ...]:
    """Convert fractions of intervals to fractions of phases."""
    start, end = plan.interval_t[numbers].T
    times = start + fractions * (end - start)
    phases = plan.phase[[rows.start for rows in plan.intervals]][numbers]
    spans = np.array(
        [plan.interval_t[plan.intervals_of(phase)][[0, -1], [0, 1]] for phase in range(len(plan.phases))]
    )
    begin, length = spans[phases, 0], np.diff(spans, axis=1)[phases, 0]
    shares = np.clip((times - begin) / length, 0.0, 1.0).round(DIGITS)
    return tuple(zip(phases.tolist(), shares.tolist(), strict=True))


def _least_around(values: np.ndarray) -> np.ndarray:
    """Return a mask of the values (K,) that are not above their neighbours."""
    padded = np.concatenate([[np.inf], values, [np.inf]])
    return np.asarray((values <= padded[:-2]) & (values <= padded[2:]))
