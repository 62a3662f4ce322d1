"""An arm wipes: its tool presses on a plane and slides along a line or a circle on it."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import casadi as ca
import numpy as np
import pinocchio as pin
from typing_extensions import override

from trajopt.errors import InputError
from trajopt.problem import Family, Problem
from trajopt.robot import Contact, Units, inverse_kinematics
from trajopt.schedule import Motion, Phase, Schedule
from trajopt.terms import (
    AccelerationCost,
    Context,
    NodeConstraint,
    NodePlace,
    NormalForce,
    PointConstraint,
    Rows,
    TorqueCost,
    free_directions,
)
from trajopt.terrain import Surface, smooth_step

from . import arms, common

TOOL = "tool"
# Default length of the line and diameter of the circle, over the reach.
SIZES = {"line": 0.25, "circle": 0.15}
# Share of the torque left by gravity at the weakest joint along the path that the default force takes.
FORCE_SHARE = 0.25
# Default duration over the least duration estimated from the limits.
UNHURRIED = 2.0
# Slip speed over which friction reverses smoothly, over the mean speed.
SLIP = 0.1
# Least sine of the angle between the plane's normal and the arm's sideways direction for a sideways line.
LEAST_ACROSS = 1e-6
# Number of postures along the path, from inverse kinematics, for the guess.
KNOTS = 41


@dataclass(frozen=True, kw_only=True)
class Stroke:
    """A path in a plane: ``centre`` (3,) m; ``across``, ``along`` (3,) are unit vectors in it, world."""

    shape: str
    size: float
    centre: np.ndarray
    across: np.ndarray
    along: np.ndarray

    def __call__(self, part: float) -> np.ndarray:
        """Position (3,) m at a fraction ``part`` of the path, 0 to 1: side to side, or once around."""
        if self.shape == "line":
            return np.asarray(self.centre + (part - 0.5) * self.size * self.across)
        turn = 2 * math.pi * part
        return np.asarray(self.centre + self.size / 2 * self._direction(turn))

    def acceleration(self, t: float, duration: float) -> np.ndarray:
        """Second derivative (3,) m/s^2 of the position at part 10 s^3 - 15 s^4 + 6 s^5, s = t / duration."""
        s = min(max(t / duration, 0.0), 1.0)
        rate = 30 * (s * (1 - s)) ** 2 / duration
        change = 60 * s * (1 - s) * (1 - 2 * s) / duration**2
        if self.shape == "line":
            return np.asarray(change * self.size * self.across)
        turn = 2 * math.pi * float(smooth_step(s))
        forward, inward = self._direction(turn + math.pi / 2), -self._direction(turn)
        circling = 2 * math.pi * change * forward + (2 * math.pi * rate) ** 2 * inward
        return np.asarray(self.size / 2 * circling)

    def _direction(self, turn: float) -> np.ndarray:
        """Return the unit vector (3,) from a circle's centre to the point at ``turn`` rad."""
        return math.sin(turn) * self.across - math.cos(turn) * self.along

    @property
    def length(self) -> float:
        """Length of the path, m."""
        return self.size if self.shape == "line" else math.pi * self.size


@dataclass(frozen=True, kw_only=True)
class StrokeMotion(PointConstraint):
    """A contact that slides follows the stroke in ``duration`` s, smoothly from rest to rest.

    Its acceleration within the plane is that of the stroke at the point's time, J a + Jdot v = x'': the same
    level as the constraints of other contacts. From a start on the stroke at rest its position follows to
    the accuracy of the scheme; constraints on positions, at points or at nodes, make accelerations oscillate.
    """

    contact: str
    stroke: Stroke
    duration: float

    @override
    def rows(self, context: Context, units: Units) -> Rows | None:
        acceleration = context.contact_acceleration(context.contact(self.contact))
        axes = np.array([self.stroke.across, self.stroke.along])
        wanted = context.varying(lambda t: axes @ self.stroke.acceleration(t, self.duration), 2)
        off = ca.mtimes(context.parameter(axes), acceleration) - wanted
        return Rows.create(off, 0.0, 0.0, units.contact_acceleration[0])


@dataclass(frozen=True, kw_only=True)
class RestOnStroke(NodeConstraint):
    """At the end the joints rest, at ``q`` (nq,), in the directions that the contacts leave free.

    `TerminalRest` would also stop the sliding contact, which the stroke does already.
    """

    q: np.ndarray

    @override
    def rows(self, context: Context, units: Units, place: NodePlace) -> Rows:
        basis = free_directions(context.robot, self.q, place.phase.contacts)
        rates = context.dxi / units.velocity
        return Rows.create(ca.mtimes(context.parameter(basis).T, rates), 0.0, 0.0, 1.0)


@dataclass(frozen=True, kw_only=True)
class Facing(NodeConstraint):
    """An ``axis`` (3,) of a frame is within ``angle`` rad of ``direction`` (3,), world, at every node."""

    frame: str
    axis: np.ndarray
    direction: np.ndarray
    angle: float

    @override
    def acts_at(self, place: NodePlace) -> bool:
        return place.index > 0

    @override
    def rows(self, context: Context, units: Units, place: NodePlace) -> Rows:
        axis, direction = context.parameter(self.axis), context.parameter(self.direction)
        cosine = ca.dot(direction, ca.mtimes(context.frame(self.frame).rotation, axis))
        return Rows.create(cosine, math.cos(self.angle), np.inf, 1.0)


def build(
    *,
    robot: str,
    shape: str,
    size: float | None,
    force: float | None,
    friction: float,
    tilt: float | None,
    out: float,
    up: float,
    lean: float,
    duration: float | None,
) -> Problem:
    """Build the wiping; see ``FAMILY`` for the parameters. Raises InputError."""
    arm = arms.load(robot)
    touching = replace(arm.robot, contacts=(Contact(frame=arm.tool, name=TOOL),))
    normal = _normal(arm, tilt, out)
    stroke = _stroke(arm, shape, size, arm.pose(0.0, out, up).translation, normal)
    postures = _postures(arm, stroke, normal)
    time = duration or UNHURRIED * arms.least_duration(arm.robot, postures)
    pressure = force if force is not None else FORCE_SHARE * arms.strength(arm, postures, normal)
    surface = Surface(
        point=stroke.centre, normal=normal, friction=friction, slip_speed=SLIP * stroke.length / time
    )
    return common.problem(
        "arm-wipe",
        touching,
        Schedule((Phase(name="wipe", duration=time, contacts=(TOOL,), surfaces={TOOL: surface}),)),
        _along(touching.model, postures, time),
        costs=(TorqueCost(weight=1.0), AccelerationCost(weight=1e-2)),
        torques=arms.torque_limits(touching),
        cones=(NormalForce(contact=TOOL, lower=pressure, upper=pressure),),
        more=(
            StrokeMotion(contact=TOOL, stroke=stroke, duration=time),
            Facing(frame=arm.tool, axis=arm.outward, direction=-normal, angle=lean),
        ),
        end=(RestOnStroke(q=postures[-1]),),
        initial_q=postures[0],
        parameters={"size": stroke.size, "force": pressure, "duration": time},
        default_intervals=40,
    )


def _along(model: pin.Model, postures: Sequence[np.ndarray], duration: float) -> Motion:
    """Return a smooth guess through postures (nq,) evenly spaced on the stroke, in ``duration`` s."""
    from scipy.interpolate import CubicSpline  # slower to import than all other problems

    start = postures[0]
    spline = CubicSpline(np.linspace(0.0, 1.0, KNOTS), [pin.difference(model, start, q) for q in postures])
    return partial(_moved, model, start, spline, duration)


def _moved(model: pin.Model, start: np.ndarray, way: Motion, duration: float, t: float) -> np.ndarray:
    return np.asarray(pin.integrate(model, start, way(smooth_step(t / duration))))


def _normal(arm: arms.Arm, tilt: float | None, out: float) -> np.ndarray:
    """Return the plane's normal (3,): against the reference's tool, or tilted from upright to the arm."""
    if tilt is None:
        return -np.asarray(arm.at_reference.rotation @ arm.outward)
    away = arm.pose(0.0, out, 0.0).translation - arm.axis
    heading = math.atan2(away[1], away[0])
    return np.array(
        [-math.sin(tilt) * math.cos(heading), -math.sin(tilt) * math.sin(heading), math.cos(tilt)]
    )


def _stroke(arm: arms.Arm, shape: str, size: float | None, centre: np.ndarray, normal: np.ndarray) -> Stroke:
    """Return the stroke about ``centre`` (3,) m in the plane; a line runs sideways as the arm sees it."""
    away = centre - arm.axis
    sideways = np.array([-away[1], away[0], 0.0])
    across = sideways - (sideways @ normal) * normal
    if np.linalg.norm(across) < LEAST_ACROSS * np.linalg.norm(sideways):
        raise InputError(
            f"the plane that '{arm.robot.name}' wipes faces sideways, where the stroke is to run",
            "allowed: tilt=0deg, a level plane, or another tilt towards the arm",
        )
    across /= np.linalg.norm(across)
    length = size if size is not None else SIZES[shape] * arm.robot.length
    return Stroke(shape=shape, size=length, centre=centre, across=across, along=np.cross(normal, across))


def _postures(arm: arms.Arm, stroke: Stroke, normal: np.ndarray) -> list[np.ndarray]:
    """Return postures (nq,) at `KNOTS` points of the stroke, tool against the plane, in sequence."""
    reference = arm.at_reference.rotation
    turn = pin.Quaternion.FromTwoVectors(reference @ arm.outward, -normal).toRotationMatrix()
    facing, first = turn @ reference, stroke(0.0)
    approach = np.linspace(arm.at_reference.translation, first, arms.STEPS)
    q, postures = arm.robot.reference, []
    for place in (*approach, *(stroke(part) for part in np.linspace(0.0, 1.0, KNOTS))):
        posture = inverse_kinematics(arm.robot, q, {arm.tool: pin.SE3(facing, place)})
        q = posture.q
        postures.append(posture)
    postures = postures[len(approach) :]
    worst = max(posture.error for posture in postures)
    if worst > arms.REACHED:
        raise InputError(
            f"'{arm.robot.name}' does not bring '{arm.tool}' along the stroke: it is off by {worst:.3g}",
            arm.allowed("a plane and a size within its reach and joint ranges"),
        )
    return [posture.q for posture in postures]


FAMILY = Family(
    name="arm-wipe",
    robots=arms.ARMS,
    phases=("wipe",),
    summary="press an arm's tool on a plane with a given force and slide along a line or a circle on it",
    parameters=(
        common.choice("shape", "path of the tool on the plane", *SIZES),
        common.length(
            "size",
            None,
            "length of the line or diameter of the circle (default: 0.25 or 0.15 of the reach)",
            (1e-3, 5.0),
        ),
        common.number(
            "force",
            None,
            "N",
            "normal force of the tool on the plane (default: a quarter of what torque limits allow)",
            (0.0, 1e5),
        ),
        common.friction(0.3),
        common.angle(
            "tilt",
            None,
            "tilt of the plane from level towards the arm (default: normal to the tool of the reference)",
            (-math.pi / 2, math.pi / 2),
        ),
        arms.part("out", 0.0, "outward offset of the stroke from the tool of the reference"),
        arms.part("up", 0.0, "upward offset of the stroke from the tool of the reference"),
        common.angle("lean", math.radians(20), "largest angle between tool and normal", (1e-3, math.pi / 2)),
        common.duration("duration", None, "duration (default: estimated from the limits)", (1e-2, 60.0)),
    ),
    build=build,
)
