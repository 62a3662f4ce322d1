"""Discovery tasks: what a problem is without its phases, and its problems for discovered schedules."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import casadi as ca
import numpy as np

from trajopt.errors import InputError
from trajopt.problem.periodicity import PAIR_DISTANCE
from trajopt.problem.problem import Problem
from trajopt.robot.kinematics import contact_positions, frame_pose
from trajopt.robot.mirror import find_mirror, paired_contacts
from trajopt.robot.robot import Robot
from trajopt.schedule.placing import footholds_at
from trajopt.schedule.schedule import Motion, Phase, Schedule
from trajopt.study.discovery.modes import LIFTED, ModeSequence
from trajopt.terms.interfaces import Term
from trajopt.terms.swing import SwingArc, SwingClearance, SwingOver
from trajopt.terms.swing_planning import swing_arcs, swing_clearance
from trajopt.terms.terminal import TerminalState
from trajopt.terms.tracking import KeyFrames
from trajopt.terrain.flat import FlatGround
from trajopt.terrain.patch import Patch
from trajopt.terrain.piecewise import PiecewiseTerrain
from trajopt.terrain.smooth import SmoothTerrain
from trajopt.terrain.surface import Surface
from trajopt.terrain.terrain import Terrain

# Swing height in robot lengths, if the problem's terms give none.
CLEARANCE = 0.05
# In robot lengths: half the width of the flank that replaces an edge, and depth of a hole.
FLANK, HOLE = 0.03, 0.5
# Bounds of the phase durations of a discovered schedule, in multiples of the discovered durations.
FREE = (0.3, 2.5)


@dataclass(frozen=True, kw_only=True)
class ContactTask:
    """A problem without its phases: robot, ground, start, and terms that name no phase.

    Args:
        terms: those that act in the whole motion.
        left_out: names of terms that act only in phases of the problem's own schedule.
        clearance: height of swings, m.
    """

    problem: Problem
    terms: tuple[Term, ...]
    left_out: tuple[str, ...]
    clearance: float

    @classmethod
    def of(cls, problem: Problem) -> "ContactTask":
        """The task of a problem. Raises `InputError` if its model depends on its phases."""
        robot, label = problem.robot, f"the schedule of '{problem.name}' cannot be found"
        require_feet(robot)
        for what, given in (("minimal coordinates", problem.modes), ("payloads", problem.payloads)):
            if given:
                raise InputError(f"{label}: it has {what} in phases", "allowed: the same model in all phases")
        walls = [name for phase in problem.schedule.phases for name in phase.surfaces]
        if walls:
            raise InputError(
                f"{label}: phases say what '{walls[0]}' touches", "allowed: contacts with the terrain alone"
            )
        if problem.actuation != "torque" or not problem.holds_contacts:
            raise InputError(f"{label}: torques are no control", "allowed: full dynamics, actuation 'torque'")
        swings = [term for term in problem.terms if isinstance(term, SwingArc | SwingClearance | SwingOver)]
        heights = [term.height for term in swings]
        others = [term for term in problem.terms if term not in swings]
        kept = tuple(term for term in others if term.phases is None and not term.made_for_schedule)
        return cls(
            problem=_whole_cycle(problem, kept),
            terms=kept,
            left_out=tuple(dict.fromkeys(term.name for term in others if term not in kept)),
            clearance=max(heights) if heights else CLEARANCE * robot.length,
        )

    def describe(self) -> dict[str, Any]:
        """JSON-able description that distinguishes tasks."""
        problem, end = self.problem, self.end
        return {
            "problem": problem.name,
            "robot": problem.robot.name,
            "parameters": {name: str(value) for name, value in problem.parameters.items()},
            "duration": [*self.duration_range],
            "terrain": problem.terrain.describe(),
            "start": problem.initial_q.tolist(),
            "end": None if end is None else end.tolist(),
            "terms": [term.name for term in self.terms],
        }

    @property
    def robot(self) -> Robot:
        """The robot."""
        return self.problem.robot

    @property
    def duration(self) -> float:
        """Nominal duration of the motion, s."""
        return self.problem.schedule.duration

    @property
    def duration_range(self) -> tuple[float, float]:
        """Least and greatest duration of the motion, s."""
        return self.problem.duration_bounds or self.problem.schedule.duration_range

    @property
    def periodic(self) -> bool:
        """Whether the motion is a cycle."""
        return self.problem.periodicity is not None

    @property
    def end(self) -> np.ndarray | None:
        """Final configuration (nq,); None if no term prescribes it."""
        return next((term.q for term in self.terms if isinstance(term, TerminalState)), None)

    def travel(self, first: np.ndarray, last: np.ndarray) -> np.ndarray:
        """Displacement (3,) of the base between two configurations (nq,), m, world."""
        frame = self.robot.model.names[1]
        places = [frame_pose(self.robot, q, frame).translation for q in (first, last)]
        return np.asarray(places[1] - places[0])

    def moved(self, q: np.ndarray, by: np.ndarray) -> np.ndarray:
        """A configuration (nq,) with its base translated by ``by`` (3,), m, world."""
        moved, rows = q.copy(), [0, 1, 2] if self.robot.base == "freeflyer" else [0, 2]
        moved[: len(rows)] += by[rows]
        return moved

    @property
    def still(self) -> KeyFrames:
        """The simplest guess: a straight base path; legs at rest in a cycle, else from start to end."""
        robot = self.robot
        first, last = self.problem.guess_at(0.0).copy(), self.end
        last = (self.problem.guess_at(self.duration) if last is None else last).copy()
        if self.periodic:
            n = robot.model.joints[1].nq
            first[n:] = last[n:] = robot.reference[n:]
        return KeyFrames(robot, np.array([0.0, self.duration]), np.array([first, last]))

    def standing(self, q: np.ndarray) -> tuple[str, ...]:
        """Names of the contacts that touch the ground at ``q`` (nq,)."""
        near = LIFTED * self.robot.length
        places = contact_positions(self.robot, q)
        heights = {
            name: gap(self.problem.terrain, place, self.robot.contact(name).radius)
            for name, place in places.items()
        }
        return tuple(name for name, height in heights.items() if height < near)

    def with_modes(self, modes: ModeSequence, guess: Motion) -> Problem:
        """The problem with hard contacts in a discovered schedule, with free durations.

        Raises:
            InputError: for a schedule that does not fit the problem.
        """
        schedule = self._schedule(modes, guess)
        problem, names = self.problem, tuple(contact.name for contact in self.robot.contacts)
        images = {name: name for name in names} if self.periodic else None
        terrain = problem.terrain
        lifted = tuple(name for name in names if any(name not in contacts for contacts in modes.key))
        swings: tuple[Term, ...] = ()
        if isinstance(terrain, PiecewiseTerrain):
            swings = swing_clearance(self.robot, schedule, terrain, height=self.clearance, guess=guess)
        elif lifted:
            swings = swing_arcs(schedule, lifted, height=self.clearance, terrain=terrain, next_name=images)
        low, high = self.duration_range
        return replace(
            problem,
            name=f"{problem.name}-found",
            schedule=schedule,
            terms=(*self.terms, *swings),
            guess=guess,
            duration_bounds=(low, high),
            default_intervals=max(problem.default_intervals, 4 * len(schedule.phases)),
        )

    def _schedule(self, modes: ModeSequence, guess: Motion) -> Schedule:
        """Phases of the modes; each contact's last landing is at its foothold in the final configuration."""
        terrain, feet = self.problem.terrain, [set(contacts) for contacts in modes.key]
        before = [feet[-1] if self.periodic else feet[0], *feet[:-1]]
        landing = [
            [n for n in key if n not in earlier] for key, earlier in zip(modes.key, before, strict=True)
        ]
        last = {name: index for index, names in enumerate(landing) for name in names}
        ends = {} if self.end is None else footholds_at(self.robot, self.end, terrain)
        phases, time = [], 0.0
        for index, (name, (contacts, duration)) in enumerate(zip(modes.names(), modes.modes, strict=True)):
            footholds = {n: ends[n] for n in landing[index] if n in ends and last[n] == index}
            elsewhere = [n for n in landing[index] if n not in footholds]
            patches = {}
            if elsewhere and isinstance(terrain, PiecewiseTerrain):
                places = contact_positions(self.robot, guess(time))
                patches = {n: _face(terrain, places[n]) for n in elsewhere}
            phases.append(
                Phase(
                    name=name,
                    duration=duration,
                    contacts=contacts,
                    footholds=footholds,
                    patches=patches,
                    duration_bounds=(FREE[0] * duration, FREE[1] * duration),
                )
            )
            time += duration
        return Schedule(tuple(phases))


def require_feet(robot: Robot) -> None:
    """Raise `InputError` for a robot without feet on a moving base."""
    if not robot.contacts or robot.base == "fixed":
        raise InputError(f"'{robot.name}' has no feet on a moving base", "allowed: legged robots")


def _face(terrain: PiecewiseTerrain, place: np.ndarray) -> Patch:
    """The face below a landing point, or the nearest one."""
    under = terrain.face_at(float(place[0]), float(place[1]))
    off = [float(np.linalg.norm(face.nearest(place) - place)) for face in terrain.faces]
    return under or terrain.faces[int(np.argmin(off))]


def _whole_cycle(problem: Problem, terms: tuple[Term, ...]) -> Problem:
    """Complete a half cycle with its mirror image; other problems are returned unchanged."""
    periodicity, robot = problem.periodicity, problem.robot
    if periodicity is None or not periodicity.mirror:
        return problem
    pairs = paired_contacts(robot, find_mirror(robot), PAIR_DISTANCE)
    images = {contact.name: robot.contacts[pairs[i]].name for i, contact in enumerate(robot.contacts)}
    half = [
        Phase(name=phase.name, duration=phase.duration, contacts=phase.contacts)
        for phase in problem.schedule.phases
    ]
    other = [
        replace(phase, name=f"{phase.name}_mirrored", contacts=tuple(images[name] for name in phase.contacts))
        for phase in half
    ]

    def twice(numbers: Any) -> Any:
        return numbers and tuple(2 * number for number in numbers)

    duration = problem.schedule.duration
    first = problem.guess_at(0.0)
    last = first.copy()  # a mirror image needs a free-flyer
    last[:3] += 2 * (problem.guess_at(duration) - first)[:3]
    return replace(
        problem,
        schedule=Schedule((*half, *other)),
        periodicity=replace(periodicity, mirror=False, translation=twice(periodicity.translation)),
        terms=terms,
        guess=KeyFrames(robot, np.array([0.0, 2 * duration]), np.array([first, last])),
        duration_bounds=twice(problem.duration_bounds),
        default_intervals=2 * problem.default_intervals,
    )


def gap(terrain: Terrain, point: np.ndarray, radius: float) -> float:
    """Height, m, of a contact's origin (3,) m above the one at which it touches; infinite over a hole."""
    if isinstance(terrain, FlatGround):
        return float(point[2]) - _plane(terrain.surface, point[0], point[1], radius)
    return float(point[2] - terrain.offset(radius).height(point[0], point[1]))


def smooth_gap(
    terrain: Terrain, point: ca.SX, radius: float, length: float, parameter: Callable[[Any], ca.SX]
) -> ca.SX:
    """`gap` of a symbolic point (3,), with flanks in place of edges; ``length``: the robot's length, m."""
    if isinstance(terrain, SmoothTerrain):
        return terrain.offset(radius).symbolic(point, parameter)[0]
    if isinstance(terrain, FlatGround):
        return point[2] - _plane(terrain.surface, point[0], point[1], radius)
    faces = sorted(terrain.faces, key=lambda face: float(face.vertices[:, 2].max()))
    height = ca.SX(float(faces[0].vertices[:, 2].min()) - HOLE * length)
    for face in faces:
        inside = _inside(face, point, FLANK * length)
        height += (_plane(face.surface, point[0], point[1], radius) - height) * inside
    return point[2] - height


def _plane(surface: Surface, x: Any, y: Any, radius: float) -> Any:
    """Height at x, y of a surface's plane, offset by ``radius`` along its normal."""
    n = surface.normal
    return (surface.height + radius - n[0] * x - n[1] * y) / n[2]


def _inside(face: Patch, point: ca.SX, width: float) -> ca.SX:
    """Smooth indicator of a face seen from above: 1 inside, 0 outside."""
    product = ca.SX(1)
    for inward, offset in zip(face.inward, face.offsets, strict=True):
        across = float(np.linalg.norm(inward[:2]))
        along = inward[0] * point[0] + inward[1] * point[1] + inward[2] * face.vertices[0, 2]
        away = (along - offset) / across
        product *= 1 / (1 + ca.exp(-away / width * 2))
    return product
