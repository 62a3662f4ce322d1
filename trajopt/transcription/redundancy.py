"""Redundant contact rows, which depend on others and are left out of the problem.

The velocities of two points of one body, of the four corners of a foot, or of four feet on legs that move in
parallel planes depend on each other wherever the contacts hold. Their rows together are rank deficient (no
LICQ). Forces keep all components; the costs decide how redundant contacts share them.
"""

from collections.abc import Mapping, Sequence
from types import MappingProxyType

import numpy as np
import pinocchio as pin

from trajopt.dynamics.model_quantities import contact_jacobian
from trajopt.robot.contact import Contact
from trajopt.robot.kinematics import contact_poses, inverse_kinematics
from trajopt.robot.robot import Robot

# A unit row counts as dependent if its norm after projecting out the others is at most this. Feet that fix an
# angle only to second order (the roll of a base on legs in parallel planes) leave about a thousandth, the
# square root of the asymmetry of a description file; corners of a foot of a few centimetres leave more.
INDEPENDENT = 1e-2
# Number and displacement (rad, m) of postures near the given one, with the contacts in place. They tell
# dependent contacts from rows that depend on each other in one posture only (straight legs).
SAMPLES, SPREAD = 3, 0.2
# Heights first, so that a foot of several points still lies flat; then sliding, then turning.
ORDER = (2, 0, 1, 3, 4, 5)

_KeptRows = dict[str, tuple[int, ...]]


def independent_rows(
    robot: Robot,
    q: np.ndarray,
    before: Sequence[Contact],
    after: Sequence[Contact],
    places: Mapping[str, np.ndarray] = MappingProxyType({}),
    levers: Mapping[str, np.ndarray] = MappingProxyType({}),
) -> _KeptRows:
    """Rows to keep of every contact, by name; those of ``before`` take precedence over those of ``after``.

    A row is left out if it depends on the rows kept so far, both at q (nq,) and at nearby postures with the
    contacts in place. ``places`` (3,) are the contacts' positions in m, by name, by default those at q.
    ``levers`` (3,) in m are those of rolling contacts, see `Contact.lever`.
    """
    kept = _kept([q], robot, before, after, levers)
    if all(kept[contact.name] == contact.rows for contact in (*before, *after)):
        return kept
    return _kept([q, *_neighbours(robot, q, (*before, *after), places)], robot, before, after, levers)


def _kept(
    postures: Sequence[np.ndarray],
    robot: Robot,
    before: Sequence[Contact],
    after: Sequence[Contact],
    levers: Mapping[str, np.ndarray],
) -> _KeptRows:
    kept: dict[str, list[int]] = {contact.name: [] for contact in (*before, *after)}
    bases: list[list[np.ndarray]] = [[] for _ in postures]
    contacts = [(c, row) for group in (before, after) for row in ORDER for c in group if row in c.rows]
    for contact, row in contacts:
        lines = [_unit_row(robot, posture, contact, row, levers) for posture in postures]
        rest = [_without(line, basis) for line, basis in zip(lines, bases, strict=True)]
        lengths = [float(np.linalg.norm(line)) for line in rest]
        if max(lengths) <= INDEPENDENT:
            continue
        kept[contact.name].append(row)
        for line, length, basis in zip(rest, lengths, bases, strict=True):
            if length > INDEPENDENT:
                basis.append(line / length)
    return {name: tuple(sorted(rows)) for name, rows in kept.items()}


def _neighbours(
    robot: Robot, q: np.ndarray, contacts: Sequence[Contact], places: Mapping[str, np.ndarray]
) -> list[np.ndarray]:
    """Postures near q (nq,) that keep the positions of point contacts and the poses of soles."""
    model, generator = robot.model, np.random.default_rng(0)
    poses = contact_poses(robot, q)
    targets: dict[str, pin.SE3 | np.ndarray] = {}
    for contact in contacts:
        pose = poses[contact.name]
        pose.translation = places.get(contact.name, pose.translation)
        targets[contact.frame] = pose.translation if contact.kind == "point" else pose
    moves = np.vstack([np.zeros(robot.nv), generator.uniform(-SPREAD, SPREAD, (SAMPLES, robot.nv))])
    moved = [np.clip(pin.integrate(model, q, m), robot.position_lower, robot.position_upper) for m in moves]
    return [inverse_kinematics(robot, start, targets, move_base=True).q for start in moved]


def _unit_row(
    robot: Robot, q: np.ndarray, contact: Contact, row: int, levers: Mapping[str, np.ndarray]
) -> np.ndarray:
    line = contact_jacobian(robot.model, q, [(contact.frame, [row])], [levers.get(contact.name)])[0]
    length = float(np.linalg.norm(line))
    return line / length if length > 0 else line


def _without(line: np.ndarray, basis: Sequence[np.ndarray]) -> np.ndarray:
    """Remainder of a row after projecting out orthonormal rows, twice to reduce rounding."""
    for _ in range(2):
        for direction in basis:
            line = line - (direction @ line) * direction
    return line
