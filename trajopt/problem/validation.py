"""Checks before solving: a start beyond limits, goals that contacts contradict, places out of reach."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import combinations

import numpy as np

from trajopt.dynamics.manifold import Coordinates
from trajopt.dynamics.virtual_base import LEAST_MARGIN, gimbal_margin
from trajopt.errors import InputError
from trajopt.robot.kinematics import contact_positions
from trajopt.robot.reach import Place, longest_between
from trajopt.robot.robot import Robot
from trajopt.robot.validation import require_configuration
from trajopt.terms.frames import FramePose
from trajopt.terms.interfaces import PointConstraint, Term
from trajopt.terms.limits import PositionLimits
from trajopt.terms.terminal import TerminalState

# A start may exceed a limit by what a check allows: this part of it, at least this many rad, m, rad/s or m/s.
LIMIT_SLACK = 1e-6
# A goal may have contacts this part of the robot's length away from where they stand, and places may be as
# much further apart than the links are long: what a check allows of feet that drift, on a robot of a metre.
PLACE_SLACK = 1e-3


def require_start(
    problem: str, robot: Robot, q: np.ndarray, v: np.ndarray, rows: Sequence[PointConstraint]
) -> None:
    """Raise `InputError` for a start that is no configuration, or beyond limits that the problem states.

    Args:
        problem: its name. q (nq,), v (nv,): the start.
        rows: constraints of the first phase; none for a free start, whose limits are rows of the problem.
    """
    require_configuration(robot.model, q, f"initial_q of problem '{problem}'")
    margin = gimbal_margin(robot.model, q)
    if margin is not None and margin < LEAST_MARGIN:
        raise InputError(
            f"problem '{problem}' starts in gimbal lock: margin {margin:.3f} < {LEAST_MARGIN}",
            "another order of the virtual joints, or base='freeflyer'",
        )
    coordinates = Coordinates(robot.model)
    node = coordinates.node_from_pinocchio(q, v)
    positions, n4 = np.zeros(robot.nv), 4 * coordinates.n_rotations
    positions[coordinates.additive_index] = node[n4 : n4 + len(coordinates.additive_index)]
    for term in rows:
        what = f"at the start of problem '{problem}'", term.name
        if isinstance(term, PositionLimits):
            _require_joint_range(robot, what, q)
        bounds = term.node_bounds(robot)
        if bounds is not None:
            _require_within(robot, (*what, "is at"), positions, bounds[:2])
            _require_within(robot, (*what, "moves at"), node[-robot.nv :], bounds[2:])


def _require_within(
    robot: Robot, what: tuple[str, str, str], values: np.ndarray, bounds: tuple[np.ndarray, ...]
) -> None:
    """Values (nv,) within (lower, upper), both (nv,), up to the slack; ``what``: where, the term, how."""
    (where, term, how), (lower, upper) = what, bounds
    room = [LIMIT_SLACK * np.where(np.isfinite(b), np.maximum(np.abs(b), 1.0), 1.0) for b in (lower, upper)]
    for row in np.flatnonzero((values < lower - room[0]) | (values > upper + room[1])):
        joint = next(j for j in Coordinates(robot.model).joints if j.v.start <= row < j.v.stop)
        raise InputError(
            f"{where} joint '{joint.name}' {how} {values[row]:.9g}, beyond its {term}",
            f"allowed: {lower[row]:.9g} to {upper[row]:.9g}",
        )


def _require_joint_range(robot: Robot, what: tuple[str, str], q: np.ndarray) -> None:
    """All limits of the robot, those too that are so wide that no rows state them."""
    rows = np.full((3, robot.nv), np.nan)
    for joint in Coordinates(robot.model).joints:
        if joint.kind == "plain" and joint.v.start >= robot.n_unactuated:
            for row, values in zip(rows, (q, robot.position_lower, robot.position_upper), strict=True):
                row[joint.v] = values[joint.q]
    _require_within(robot, (*what, "is at"), rows[0], (rows[1], rows[2]))


def require_goals(
    robot: Robot, terms: Sequence[Term], phase: str, standing: Mapping[str, np.ndarray]
) -> None:
    """Raise `InputError` for a final configuration that has contacts elsewhere than where they stand.

    Goals are asked for in the directions that contacts leave free: what contradicts the contacts would be
    left out without a word. ``phase`` is the last one, ``standing`` are the places (3,) m of its contacts.
    """
    for term in terms:
        if not isinstance(term, TerminalState):
            continue
        q = np.array(term.q, dtype=float)
        require_configuration(robot.model, q, f"q of {term.name}")
        reached = contact_positions(robot, q)
        for name, place in standing.items():
            off = float(np.linalg.norm(reached[name] - place))
            if off > PLACE_SLACK * robot.length:
                raise InputError(
                    f"q of {term.name} has '{name}' {off:.4g} m from where it stands in phase '{phase}'",
                    "allowed: a configuration in which contacts are where they stand, or landed",
                )


def require_reach(
    robot: Robot, terms: Sequence[Term], standing: Mapping[str, Mapping[str, np.ndarray]]
) -> None:
    """Raise `InputError` for places further apart than the links between them are long.

    Contacts that stand at once, and the frame of a `FramePose` with them and with the world. Only what no
    posture reaches is refused; a place that only limits, or other places, put out of reach is not.
    ``standing``: by phase, in order, the places (3,) m of contacts.
    """
    last = list(standing)[-1]
    poses = [term for term in terms if isinstance(term, FramePose) and term.position is not None]
    for phase, places in standing.items():
        feet = {name: Place.of_frame(robot.model, robot.contact(name).frame) for name in places}
        for one, other in combinations(places, 2):
            what = f"contacts '{one}' and '{other}' stand in phase '{phase}'"
            _require_near(robot, what, (feet[one], feet[other]), places[one] - places[other])
        for term in poses:
            if phase == (term.phase or last):
                _require_pose(robot, term, places, feet)


def _require_pose(
    robot: Robot, term: FramePose, places: Mapping[str, np.ndarray], feet: Mapping[str, Place]
) -> None:
    frame, goal = Place.of_frame(robot.model, term.frame), np.array(term.position, dtype=float)
    for name, place in places.items():
        what = f"{term.name} has '{term.frame}' and contact '{name}'"
        _require_near(robot, what, (feet[name], frame), goal - place)
    root = frame.root(robot.model)
    what = f"{term.name} has '{term.frame}' and the place where its first joint is fixed"
    _require_near(robot, what, (root, frame), goal - root.point)


def _require_near(robot: Robot, what: str, ends: tuple[Place, Place], apart: np.ndarray) -> None:
    longest, distance = longest_between(robot.model, *ends), float(np.linalg.norm(apart))
    if distance > longest + PLACE_SLACK * robot.length:
        raise InputError(
            f"{what} {distance:.4g} m apart",
            f"allowed: up to {longest:.4g} m, all links between them in line",
        )
