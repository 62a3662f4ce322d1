"""An arm picks up an object and places it elsewhere: waypoints above both places, a payload in between."""

import math
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pinocchio as pin

from trajopt.dynamics import contact_jacobian, gravity_of
from trajopt.errors import InputError
from trajopt.problem import Family, PosturePath, Problem
from trajopt.robot import Contact, Payload, Robot
from trajopt.schedule import END, Moment, Phase, Schedule, start_of
from trajopt.terms import AccelerationCost, FramePose, FrameVelocity, Term, TerminalRest, TimeCost, TorqueCost
from trajopt.terrain import FlatGround

from . import arms, common

TOOL = "tool"
PHASES = ("approach", "descend", "lift", "carry", "lower", "retreat")
CARRIED = ("lift", "carry", "lower")
# Height of the waypoints above the places, over the reach.
OVER = 0.1
# Share of the torque left by gravity at the weakest joint of all waypoints that the default object takes, and
# its largest share of the arm's mass. It is a cube with the density of water, held at the middle of its top.
SHARE, OF_ARM = 0.4, 0.1
DENSITY = 1000.0
# Multiples of the shortest durations within the limits: the default for least effort, and the bounds of free
# durations.
UNHURRIED, FREE = 2.5, (0.1, 4.0)
# Weights of accelerations; see `arm-transfer`.
SMOOTH = {"effort": 1e-2, "time": 1e-3}
INTERVALS = 36


def cube(arm: arms.Arm, mass: float) -> Payload:
    """A cube of that mass, kg, held at the middle of one side where the tool points."""
    side = (mass / DENSITY) ** (1 / 3)
    return Payload(
        contact=TOOL, mass=mass, centre=side / 2 * arm.outward, inertia=mass * side**2 / 6 * np.eye(3)
    )


def default_mass(robot: Robot, tool: str, postures: list[np.ndarray]) -> float:
    """Mass in kg of an object that the weakest joint holds with a share of its torque at all postures."""
    most = OF_ARM * robot.mass
    if robot.torque_limit is None:
        return most
    gravity, data = gravity_of(robot.model), robot.model.createData()
    for q in postures:
        needed = np.abs(pin.computeGeneralizedGravity(robot.model, data, q))
        lever = np.abs(contact_jacobian(robot.model, q, [(tool, (2,))])[0]) * gravity
        spare = SHARE * np.maximum(robot.torque_limit - needed, 0.0)
        most = min(most, float(np.min(spare[lever > 0] / lever[lever > 0])))
    return most


def _way(arm: arms.Arm, poses: list[pin.SE3], end: np.ndarray) -> tuple[Term, ...]:
    """Return the goals: above each place before and after, at rest on it, above the second at the end."""
    over_pick, pick, over_place, place = poses

    def pose(at: Moment, goal: pin.SE3, *, turned: bool) -> FramePose:
        rotation = goal.rotation if turned else None
        return FramePose(frame=arm.tool, position=goal.translation, rotation=rotation, at=at)

    still = np.zeros(6)
    return (
        pose(start_of("descend"), over_pick, turned=False),
        pose(start_of("lift"), pick, turned=True),
        FrameVelocity(frame=arm.tool, velocity=still, at=start_of("lift")),
        pose(start_of("carry"), over_pick, turned=False),
        pose(start_of("lower"), over_place, turned=False),
        pose(start_of("retreat"), place, turned=True),
        FrameVelocity(frame=arm.tool, velocity=still, at=start_of("retreat")),
        pose(END, over_place, turned=True),
        TerminalRest(q=end),
    )


def build(
    *,
    robot: str,
    turn: float,
    out: float,
    up: float,
    over: float,
    payload: float | None,
    goal: str,
    duration: float | None,
    actuation: str,
) -> Problem:
    """Build the task; see ``FAMILY`` for the parameters. Raises InputError."""
    loaded = arms.load(robot)
    arm = replace(loaded, robot=replace(loaded.robot, contacts=(Contact(frame=loaded.tool, name=TOOL),)))
    places = [(side * turn / 2, out, up + high) for side in (-1, 1) for high in (over, 0.0)]
    over_pick, pick, over_place, place = stops = [arm.posture(*where) for where in places]
    postures = (arm.robot.reference, over_pick, pick, over_pick, over_place, place, over_place)
    mass = default_mass(arm.robot, arm.tool, stops) if payload is None else payload
    durations = _durations(arm.robot, postures, goal, duration)
    phases = zip(PHASES, durations, strict=True)
    schedule = Schedule(tuple(Phase(name=name, duration=time) for name, time in phases))
    cost = TimeCost(weight=1.0) if goal == "time" else TorqueCost(weight=1.0)
    return common.problem(
        "arm-pick-place",
        arm.robot,
        common.freed(schedule, FREE) if goal == "time" else schedule,
        PosturePath(model=arm.robot.model, postures=postures, durations=durations),
        costs=(cost, AccelerationCost(weight=SMOOTH[goal])),
        torques=arms.torque_limits(arm.robot),
        cones=(),
        end=_way(arm, [arm.pose(*where) for where in places], over_place),
        terrain=FlatGround(height=_below(arm)),
        parameters={"payload": mass, "duration": float(np.sum(durations))},
        default_intervals=2 * INTERVALS if goal == "time" else INTERVALS,
        # Least-time torques jump between limits; polynomials of higher degree overshoot between points.
        default_transcription="legendre:1" if goal == "time" else "legendre:2",
        payloads=dict.fromkeys(CARRIED, cube(arm, mass)) if mass > 0 else {},
        actuation=actuation,
        goal=goal,
    )


def _durations(
    robot: Robot, postures: tuple[np.ndarray, ...], goal: str, duration: float | None
) -> list[float]:
    """Return the duration of every phase, s: the total, in proportion to the least durations."""
    least = [arms.least_duration(robot, pair) for pair in pairwise(postures)]
    if not min(least) > 0:
        raise InputError("two waypoints of arm-pick-place are the same", "allowed: turn and over not zero")
    whole = sum(least) * (1.0 if goal == "time" else UNHURRIED) if duration is None else duration
    return [whole * shortest / sum(least) for shortest in least]


def _below(arm: arms.Arm) -> float:
    """Return the height in m of a floor out of the way; the table below the object is not modelled."""
    return float(min(arm.axis[2], 0.0) - arm.robot.length)


FAMILY = Family(
    name="arm-pick-place",
    robots=arms.ARMS,
    phases=PHASES,
    summary="pick up an object, carry it over waypoints and place it elsewhere, its mass included",
    parameters=(
        common.angle(
            "turn", math.radians(90), "angle about the base from pick to place", (-math.pi, math.pi)
        ),
        arms.part("out", 0.0, "outward offset of both places from the tool's start"),
        arms.part("up", -0.1, "upward offset of both places from the tool's start"),
        arms.part("over", OVER, "height of the waypoints above the places", (0.0, 1.0)),
        common.number(
            "payload", None, "kg", "mass of the object (default: from the torque limits)", (0.0, 1e4)
        ),
        common.goal("effort", "time", meaning="objective: torques or time"),
        common.duration("duration", None, "total duration (default: from the limits)", (1e-3, 120.0)),
        common.ACTUATION,
    ),
    build=build,
    variants=arms.VARIANTS,
)
