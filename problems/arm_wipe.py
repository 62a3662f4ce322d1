"""An arm wipes: its tool presses on a plane and slides along a line or a circle on it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pinocchio as pin

from trajopt.errors import InputError
from trajopt.problem import Family, Problem
from trajopt.robot import Contact, inverse_kinematics
from trajopt.schedule import Motion, Phase, Schedule
from trajopt.terms import AccelerationCost, NormalForce, TorqueCost
from trajopt.terrain import Surface, smooth_step

from . import arms, common
from .strokes import Facing, RestOnStroke, Stroke, StrokeMotion

TOOL = "tool"
# Default length of a line and diameter of a circle, over the reach.
SIZES = {"line": 0.25, "circle": 0.15}
# The default force takes this share of the torque that gravity leaves at the weakest joint along the path.
FORCE_SHARE = 0.25
# The default duration over the least duration estimated from the limits.
UNHURRIED = 2.0
# Slip speed at which friction reverses smoothly, over the mean speed.
SLIP = 0.1
# Postures along the path, by inverse kinematics, for the guess.
KNOTS = 41


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
    """Guess: smoothly through postures (nq,) that are evenly spread over the stroke, in ``duration`` s."""
    from scipy.interpolate import CubicSpline  # takes longer to load than all other problems

    start = postures[0]
    spline = CubicSpline(np.linspace(0.0, 1.0, KNOTS), [pin.difference(model, start, q) for q in postures])
    return lambda t: np.asarray(pin.integrate(model, start, spline(smooth_step(t / duration))))


def _normal(arm: arms.Arm, tilt: float | None, out: float) -> np.ndarray:
    """Normal (3,) of the plane: against the tool of the reference, or tilted from upright towards the arm."""
    if tilt is None:
        return -np.asarray(arm.at_reference.rotation @ arm.outward)
    away = arm.pose(0.0, out, 0.0).translation - arm.axis
    heading = math.atan2(away[1], away[0])
    return np.array(
        [-math.sin(tilt) * math.cos(heading), -math.sin(tilt) * math.sin(heading), math.cos(tilt)]
    )


def _stroke(arm: arms.Arm, shape: str, size: float | None, centre: np.ndarray, normal: np.ndarray) -> Stroke:
    """Stroke about ``centre`` (3,) m in the plane; a line runs sideways as the arm sees it."""
    away = centre - arm.axis
    sideways = np.array([-away[1], away[0], 0.0])
    across = sideways - (sideways @ normal) * normal
    across /= np.linalg.norm(across)
    length = size if size is not None else SIZES[shape] * arm.robot.length
    return Stroke(shape=shape, size=length, centre=centre, across=across, along=np.cross(normal, across))


def _postures(arm: arms.Arm, stroke: Stroke, normal: np.ndarray) -> list[np.ndarray]:
    """Postures (nq,) at `KNOTS` points of the stroke, the tool against the plane, each from the last."""
    reference = arm.at_reference.rotation
    turn = pin.Quaternion.FromTwoVectors(reference @ arm.outward, -normal).toRotationMatrix()
    facing, first = turn @ reference, stroke(0.0)
    approach = np.linspace(arm.at_reference.translation, first, arms.STEPS)
    q, found = arm.robot.reference, []
    for place in (*approach, *(stroke(part) for part in np.linspace(0.0, 1.0, KNOTS))):
        posture = inverse_kinematics(arm.robot, q, {arm.tool: pin.SE3(facing, place)})
        q = posture.q
        found.append(posture)
    found = found[len(approach) :]
    worst = max(posture.error for posture in found)
    if worst > arms.REACHED:
        raise InputError(
            f"'{arm.robot.name}' does not bring '{arm.tool}' along the stroke: it is off by {worst:.3g}",
            "allowed: a plane and a size within its reach and joint ranges",
        )
    return [posture.q for posture in found]


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
