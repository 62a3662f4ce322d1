"""What can be told of a problem before it is solved: a start beyond limits, goals and places out of reach."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import combinations
from typing import TYPE_CHECKING

import numpy as np

from trajopt.bases.virtual_base import LEAST_MARGIN, gimbal_margin
from trajopt.errors import InputError
from trajopt.kinematics import contact_positions
from trajopt.manifold import Coordinates
from trajopt.node_terms import FramePose, TerminalState
from trajopt.point_terms import PositionLimits
from trajopt.reach import Place, longest_between
from trajopt.robot_validation import require_configuration

if TYPE_CHECKING:
    from trajopt.problem import Problem

# A start may exceed a limit by what a check allows: this part of it, at least this many rad, m, rad/s or m/s.
LIMIT_SLACK = 1e-6
# A goal may have contacts this part of the robot's length away from where they stand, and places may be as
# much further apart than the links are long: what a check allows of feet that drift, on a robot of a metre.
PLACE_SLACK = 1e-3


def require_start(problem: Problem) -> None:
    """Raise `InputError` for a start that is no configuration, or beyond limits that the problem states.

    A free start is only what rotations are measured from: its limits are rows of the problem.
    """
    robot, first = problem.robot, problem.schedule.phases[0].name
    require_configuration(robot.model, problem.initial_q, f"initial_q of problem '{problem.name}'")
    margin = gimbal_margin(robot.model, problem.initial_q)
    if margin is not None and margin < LEAST_MARGIN:
        raise InputError(
            f"problem '{problem.name}' starts in gimbal lock: margin {margin:.3f} < {LEAST_MARGIN}",
            "another order of the virtual joints, or base='freeflyer'",
        )
    if problem.periodicity is not None:
        return
    coordinates = Coordinates(robot.model)
    node = coordinates.node_from_pinocchio(problem.initial_q, problem.initial_v)
    positions, n4 = np.zeros(robot.nv), 4 * coordinates.n_rotations
    positions[coordinates.additive_index] = node[n4 : n4 + len(coordinates.additive_index)]
    for term in problem.point_constraints:
        if isinstance(term, PositionLimits) and term.acts_in(first):
            _require_joint_range(problem, term.name)
        bounds = term.node_bounds(robot) if term.acts_in(first) else None
        if bounds is not None:
            _require_within(problem, term.name, "is at", positions, bounds[:2])
            _require_within(problem, term.name, "moves at", node[-robot.nv :], bounds[2:])


def _require_within(
    problem: Problem, term: str, how: str, values: np.ndarray, bounds: tuple[np.ndarray, ...]
) -> None:
    """Values (nv,) within (lower, upper), both (nv,), up to the slack."""
    lower, upper = bounds
    room = [LIMIT_SLACK * np.where(np.isfinite(b), np.maximum(np.abs(b), 1.0), 1.0) for b in (lower, upper)]
    for row in np.flatnonzero((values < lower - room[0]) | (values > upper + room[1])):
        joint = next(j for j in Coordinates(problem.robot.model).joints if j.v.start <= row < j.v.stop)
        raise InputError(
            f"at the start of problem '{problem.name}' joint '{joint.name}' {how} {values[row]:.9g}, beyond"
            f" its {term}",
            f"allowed: {lower[row]:.9g} to {upper[row]:.9g}",
        )


def _require_joint_range(problem: Problem, term: str) -> None:
    """All limits of the robot, those too that are so wide that no rows state them."""
    robot, rows = problem.robot, np.full((3, problem.robot.nv), np.nan)
    for joint in Coordinates(robot.model).joints:
        if joint.kind == "plain" and joint.v.start >= robot.n_unactuated:
            for row, values in zip(
                rows, (problem.initial_q, robot.position_lower, robot.position_upper), strict=True
            ):
                row[joint.v] = values[joint.q]
    _require_within(problem, term, "is at", rows[0], (rows[1], rows[2]))


def guessed(problem: Problem, t: float) -> np.ndarray:
    """The problem's guess (nq,) at ``t`` s. Raises `InputError` that names the time."""
    what, given = f"guess of problem '{problem.name}' at t = {t:.6g} s", problem.guess(t)
    try:
        q = np.array(given, dtype=float)
    except (TypeError, ValueError):
        raise InputError(f"{what} is not numeric", f"allowed: ({problem.robot.nq},), finite") from None
    require_configuration(problem.robot.model, q, what)
    return q


def require_goals(problem: Problem) -> None:
    """Raise `InputError` for a final configuration that has contacts elsewhere than where they stand.

    Goals are asked for in the directions that contacts leave free: what contradicts the contacts would be
    left out without a word.
    """
    last = problem.schedule.phases[-1].name
    for term in problem.terms:
        if not isinstance(term, TerminalState):
            continue
        q = np.array(term.q, dtype=float)
        require_configuration(problem.robot.model, q, f"q of {term.name}")
        reached = contact_positions(problem.robot, q)
        for name, place in _places(problem, len(problem.schedule.phases) - 1).items():
            off = float(np.linalg.norm(reached[name] - place))
            if off > PLACE_SLACK * problem.robot.length:
                raise InputError(
                    f"q of {term.name} has '{name}' {off:.4g} m from where it stands in phase '{last}'",
                    "allowed: a configuration in which contacts are where they stand, or landed",
                )


def _places(problem: Problem, phase: int) -> dict[str, np.ndarray]:
    """Where contacts of a phase are known to stand (3,) m, by name: not those that slide or land anywhere."""
    phases, found = problem.schedule.phases, {}
    for name in phases[phase].contacts:
        begins = problem.schedule.beginning(name, phase)
        if begins == 0 and problem.periodicity is not None:
            continue
        grounds = [phases[index].surfaces.get(name) for index in range(begins, phase + 1)]
        place = problem.contact_place(name, phase)
        if place is not None and all(ground is None or ground.slip_speed is None for ground in grounds):
            found[name] = place
    return found


def require_reach(problem: Problem) -> None:
    """Raise `InputError` for places further apart than the links between them are long.

    Contacts that stand at once, and the frame of a `FramePose` with them and with the world. Only what no
    posture reaches is refused; a place that only limits, or other places, put out of reach is not.
    """
    robot, phases = problem.robot, problem.schedule.phases
    for index, phase in enumerate(phases):
        places = _places(problem, index)
        feet = {name: Place.of_frame(robot.model, robot.contact(name).frame) for name in places}
        for one, other in combinations(places, 2):
            what = f"contacts '{one}' and '{other}' stand in phase '{phase.name}'"
            _require_near(problem, what, (feet[one], feet[other]), places[one] - places[other])
        for term in problem.terms:
            if isinstance(term, FramePose) and term.position is not None:
                at = phases[-1].name if term.phase is None else term.phase
                if at == phase.name:
                    _require_pose(problem, term, places, feet)


def _require_pose(
    problem: Problem, term: FramePose, places: Mapping[str, np.ndarray], feet: Mapping[str, Place]
) -> None:
    frame, goal = Place.of_frame(problem.robot.model, term.frame), np.array(term.position, dtype=float)
    for name, place in places.items():
        what = f"{term.name} has '{term.frame}' and contact '{name}'"
        _require_near(problem, what, (feet[name], frame), goal - place)
    root = frame.root(problem.robot.model)
    what = f"{term.name} has '{term.frame}' and the place where its first joint is fixed"
    _require_near(problem, what, (root, frame), goal - root.point)


def _require_near(problem: Problem, what: str, ends: tuple[Place, Place], apart: np.ndarray) -> None:
    longest, distance = longest_between(problem.robot.model, *ends), float(np.linalg.norm(apart))
    if distance > longest + PLACE_SLACK * problem.robot.length:
        raise InputError(
            f"{what} {distance:.4g} m apart",
            f"allowed: up to {longest:.4g} m, all links between them in line",
        )
