"""The reference of a horizon from a command: speeds and heading of the base, and footholds of a gait."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import pinocchio as pin

from trajopt.control.mpc.clock import GaitClock, Swing
from trajopt.control.mpc.commands import SPEEDS, Command
from trajopt.control.mpc.ground import GroundEstimate
from trajopt.control.mpc.reference import reference_layout
from trajopt.dynamics.manifold import Coordinates
from trajopt.dynamics.model_quantities import contact_jacobian
from trajopt.robot.contact import Contact
from trajopt.robot.kinematics import contact_positions
from trajopt.robot.legs import wheel_rows
from trajopt.robot.robot import Robot
from trajopt.terrain.flat import FlatGround

# Largest motion of a contact, per unit of the base's, that counts as rolling.
ROLLS = 1e-3


class RestingFeet:
    """Feet of a robot in its reference posture.

    Args:
        robot: a robot with a free base.
        names: names of the contacts that are its feet.

    ``hips`` (n, 3) are the positions of the feet relative to the base, m, ``radius`` (n,) their radii, m,
    ``numbers`` their indices among the contacts; ``standing`` is the height of the base above the ground, m.
    ``stable`` says whether they have three points to stand on, ``rolling`` which `SPEEDS` they permit by
    rolling alone; ``posture`` (nj,) are the angles of the joints, ``wheels`` their `wheel_rows`.
    """

    def __init__(self, robot: Robot, names: Sequence[str]) -> None:
        known, base = contact_positions(robot, robot.reference), robot.reference[:3]
        places = np.array([known[name] for name in names])
        contacts = [robot.contact(name) for name in names]
        self.robot, self.names = robot, tuple(names)
        self.hips, self.radius = places - base, np.array([contact.radius for contact in contacts])
        self.numbers = [robot.contacts.index(contact) for contact in contacts]
        self.soles = [contact.kind == "surface" for contact in contacts]
        self.standing = float(base[2] - np.min(places[:, 2] - self.radius))
        self.stable = sum(len(contact.corners) for contact in contacts) >= 3
        node = Coordinates(robot.model).node_from_pinocchio(robot.reference, np.zeros(robot.nv))
        self.posture, self.wheels = node[7 : robot.nv + 1], wheel_rows(robot)
        self.rolling = self._rolling(contacts)

    def _rolling(self, contacts: Sequence[Contact]) -> tuple[str, ...]:
        """Speeds of a command that the base may have while legs keep their posture and only wheels turn."""
        robot = self.robot
        places = [(contact.frame, contact.rows) for contact in contacts]
        levers = [contact.lever(FlatGround().surface) for contact in contacts]
        jacobian = contact_jacobian(robot.model, robot.reference, places, levers)
        wheels, moved = jacobian[:, list(self.wheels.values())], jacobian[:, [0, 1, 5]]
        held = moved - wheels @ np.linalg.lstsq(wheels, moved, rcond=None)[0]
        return tuple(name for name, rows in zip(SPEEDS, held.T, strict=True) if np.abs(rows).max() < ROLLS)


@dataclass(frozen=True, kw_only=True)
class GaitReference:
    """The reference of a gait's plan, from now on.

    ``base`` is the present configuration (nq,), ``heading`` that of the base, rad, ``ground`` the estimate of
    the ground, ``half_stance`` in s; ``lifts`` are the heights of swings of point feet and of soles, m.
    """

    feet: RestingFeet
    base: np.ndarray
    command: Command
    heading: float
    ground: GroundEstimate
    swings: Mapping[str, Sequence[Swing]]
    half_stance: float
    lifts: tuple[float, float]

    def landing_height(self, name: str, time: float) -> float:
        """Height of the frame of a contact that lands about ``time`` s from now, m."""
        number = self.feet.names.index(name)
        ends = np.array([swing.end for swing in self.swings[name]])
        place = self.foothold(number, float(ends[np.abs(ends - time).argmin()]))
        return float(place[2] + self.feet.radius[number])

    def foothold(self, number: int, time: float) -> np.ndarray:
        """Foothold (3,) of a foot that lands ``time`` s from now, m: below its hip in mid stance."""
        along, left = self._axes(np.array(time))
        stance = 0.0 if self.feet.names[number] in self.feet.wheels else self.half_stance
        ahead = self.command.speed * (time + stance), self.command.lateral * (time + self.half_stance)
        x, y = self.feet.hips[number][:2] + ahead
        return self.ground.foothold(self.base[:2] + x * along + y * left)

    def rows(self, times: np.ndarray) -> np.ndarray:
        """The reference (n, size) at times (n,) from now, s."""
        robot, ground, command = self.feet.robot, self.ground, self.command
        at, n, last = reference_layout(robot), len(times), float(times.max())
        rows = np.zeros((n, at.size))
        along, left = self._axes(times)
        level = command.speed * along + command.lateral * left
        rows[:, :2] = self.base[:2] + times[:, None] * level
        rows[:, 2] = ground.height(rows[:, 0], rows[:, 1]) + self.feet.standing + command.height
        rows[:, at.velocity] = np.column_stack([level, level @ ground.slope])
        rows[:, at.quaternion] = self._quaternions(times)
        rows[:, at.spin.stop - 1] = command.turn_rate
        rows[:, at.posture] = self.feet.posture
        for number, name in enumerate(self.feet.names):
            lift, foot = self.lifts[self.feet.soles[number]], at.foot(self.feet.numbers[number]).start
            start = ground.places[number]
            for swing in self.swings[name]:
                if swing.begin > last:
                    break
                inside = np.flatnonzero((times >= swing.begin) & (times <= swing.end))
                s = (times[inside] - swing.begin) / (swing.end - swing.begin)
                goal = self.foothold(number, swing.end)
                path, pull = ground.swing(s, start if ground.mapped or swing.begin <= 0 else goal, goal)
                path[:, 2] += self.feet.radius[number] + lift * 16 * s**2 * (1 - s) ** 2
                rows[inside, foot : foot + 3], start = path, goal
                rows[inside, foot + 3] = rows[inside, foot + 4] = pull
                rows[inside, foot + 5] = 1.0
        return rows

    def _axes(self, times: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Level unit vectors forward and to the left (..., 2) at times (...) from now, s."""
        angle = self.heading + self.command.turn_rate * times
        along = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
        return along, np.stack([-along[..., 1], along[..., 0]], axis=-1)

    @cached_property
    def _tilt(self) -> np.ndarray:
        """Quaternion (4,) that turns the vertical to the normal of the ground."""
        normal = np.append(-self.ground.slope, 1.0)
        turn = pin.Quaternion.FromTwoVectors(np.array([0.0, 0.0, 1.0]), normal / np.linalg.norm(normal))
        return np.asarray(turn.coeffs())

    def _quaternions(self, times: np.ndarray) -> np.ndarray:
        """Quaternions of the base (n, 4) at times (n,): parallel to the ground, in the commanded heading."""
        angle = 0.5 * (self.heading + self.command.turn_rate * times)
        x, y, _, w = self._tilt
        sin, cos = np.sin(angle), np.cos(angle)
        return np.column_stack([x * cos + y * sin, y * cos - x * sin, w * sin, w * cos])


def half_stance(clock: GaitClock) -> float:
    """Half the stance time of a foot in the present gait, s; 0 while the robot stands."""
    gait = clock.gaits.get(clock.gait)
    return 0.0 if gait is None else 0.5 * gait[0].duty_of(gait[0].feet[0]) * gait[1]
