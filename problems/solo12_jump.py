"""A jump of Solo12: stance, flight, landing on the footholds of the target pose, rest."""

from __future__ import annotations

import math

import numpy as np
import pinocchio as pin

import robots
from robots import solo12
from trajopt.drive_terms import DriveLimits
from trajopt.errors import InputError
from trajopt.family import Choice, Family, Parameter
from trajopt.kinematics import inverse_kinematics
from trajopt.model_quantities import STANDARD_GRAVITY
from trajopt.node_terms import FrameHeight, SwingClearance, TerminalRest, TerminalState
from trajopt.problem import Problem
from trajopt.robot import Robot
from trajopt.schedule import FlatGround, Phase, Schedule
from trajopt.terms import (
    AccelerationCost,
    EffortLimits,
    FrictionPyramid,
    ImpulseCost,
    PositionLimits,
    PostureCost,
    Term,
    TorqueCost,
    VelocityCost,
    VelocityLimits,
    WrenchCost,
)

BASE = "base_link"
# A flight shorter than this leaves no time to move the feet to their new places, s.
SHORTEST_FLIGHT = 0.3
# Rise of the base over its standing height at take-off in the guess, m: legs not yet straight.
TAKEOFF_RISE = 0.04
# Part of the take-off speed times its duration that the base travels while the feet are on the ground.
GROUND_SHARE = 0.15
# Price of a hard landing: without one an impact brakes for free, torques do not see it.
IMPULSE_WEIGHT = 0.1
# Least height of a foot over the ground in mid flight, m.
CLEARANCE = 0.03


def _pose(robot: Robot, x: float, y: float, z: float, yaw: float) -> np.ndarray:
    """Reference posture with the base displaced by (x, y, z) m and turned by yaw rad."""
    q = robot.reference.copy()
    q[:3] += [x, y, z]
    q[3:7] = pin.Quaternion(pin.rpy.rpyToMatrix(0.0, 0.0, yaw)).coeffs()
    return q


def _footholds(robot: Robot, q: np.ndarray) -> dict[str, np.ndarray]:
    data = robot.model.createData()
    pin.framesForwardKinematics(robot.model, data, q)
    return {c.name: data.oMf[robot.model.getFrameId(c.frame)].translation.copy() for c in robot.contacts}


class _Guess:
    """Base on a smooth push, a parabola and a smooth landing; legs follow the feet by inverse kinematics."""

    def __init__(
        self, robot: Robot, end: np.ndarray, path: np.ndarray, durations: tuple[float, float, float]
    ) -> None:
        self.robot, self.durations = robot, durations
        frames = {contact.name: contact.frame for contact in robot.contacts}
        self.start_feet, self.end_feet = (
            {frames[name]: point for name, point in _footholds(robot, q).items()}
            for q in (robot.reference, end)
        )
        stance, flight, landing = durations
        share = GROUND_SHARE * (stance + landing)
        self.rates = path / (flight + share) + [0.0, STANDARD_GRAVITY * flight / 2, 0.0]
        self.takeoff = GROUND_SHARE * stance * self.rates * [1, 0, 1] + [0.0, TAKEOFF_RISE, 0.0]
        self.touchdown = self.takeoff + self.rates * flight * [1, 0, 1]
        self.end = path

    def __call__(self, t: float) -> np.ndarray:
        pose = self._pose(t)
        return inverse_kinematics(self.robot, pose, self._feet(t, pose)).q

    def _pose(self, t: float) -> np.ndarray:
        x, z, yaw = self._base(t)
        return _pose(self.robot, x, 0.0, z, yaw)

    def _base(self, t: float) -> np.ndarray:
        """Forward and upward displacement (m) and yaw (rad) of the base."""
        stance, flight, landing = self.durations
        if t <= stance:
            return _hermite(max(t, 0.0) / stance, stance, np.zeros(3), np.zeros(3), self.takeoff, self.rates)
        if t <= stance + flight:
            s = t - stance
            return self.takeoff + self.rates * s - np.array([0.0, STANDARD_GRAVITY * s * s / 2, 0.0])
        fraction = min(1.0, (t - stance - flight) / landing)
        return _hermite(fraction, landing, self.touchdown, self.rates * [1, -1, 1], self.end, np.zeros(3))

    def _feet(self, t: float, pose: np.ndarray) -> dict[str, np.ndarray]:
        """Feet on their footholds; in flight carried by the base, from one stance to the other."""
        stance, flight, _ = self.durations
        if t <= stance:
            return self.start_feet
        if t >= stance + flight:
            return self.end_feet
        s = (t - stance) / flight
        smooth = s * s * (3 - 2 * s)
        before, after = self._pose(stance), self._pose(stance + flight)
        return {
            frame: _carried(
                pose, (1 - smooth) * _seen(before, start) + smooth * _seen(after, self.end_feet[frame])
            )
            for frame, start in self.start_feet.items()
        }


def _base_placement(q: np.ndarray) -> pin.SE3:
    return pin.SE3(pin.Quaternion(*q[[6, 3, 4, 5]]).toRotationMatrix(), q[:3])


def _seen(q: np.ndarray, point: np.ndarray) -> np.ndarray:
    """A point of the world in base axes, m."""
    return _base_placement(q).actInv(point)


def _carried(q: np.ndarray, point: np.ndarray) -> np.ndarray:
    """A point in base axes as a point of the world, m."""
    return _base_placement(q).act(point)


def _hermite(
    s: float,
    duration: float,
    start: np.ndarray,
    start_rate: np.ndarray,
    end: np.ndarray,
    end_rate: np.ndarray,
) -> np.ndarray:
    """Cubic through values and rates at both ends, at the fraction s of the duration."""
    return (
        (1 + 2 * s) * (1 - s) ** 2 * start
        + s * (1 - s) ** 2 * duration * start_rate
        + s * s * (3 - 2 * s) * end
        + s * s * (s - 1) * duration * end_rate
    )


def _schedule(robot: Robot, end: np.ndarray, durations: tuple[float, float, float], impact: bool) -> Schedule:
    feet = tuple(contact.name for contact in robot.contacts)
    stance, flight, landing = durations
    return Schedule(
        (
            Phase(name="stance", duration=stance, contacts=feet),
            Phase(name="flight", duration=flight),
            Phase(
                name="landing",
                duration=landing,
                contacts=feet,
                footholds=_footholds(robot, end),
                impact=impact,
            ),
        )
    )


def _terms(
    robot: Robot, end: np.ndarray, height: float, ground: FlatGround, torque_limits: Term
) -> tuple[Term, ...]:
    return (
        TorqueCost(weight=1.0),
        AccelerationCost(weight=2e-2),
        VelocityCost(weight=1e-2),
        PostureCost(weight=1e-1),
        WrenchCost(weight=1e-2),
        torque_limits,
        PositionLimits(),
        VelocityLimits(),
        FrictionPyramid(friction=ground.friction),
        SwingClearance(height=CLEARANCE, terrain=ground),
        FrameHeight(frame=BASE, height=robot.reference[2] + height, phase="flight"),
        TerminalState(q=end),
        TerminalRest(q=end),
    )


def _actuated(effort: float | None, voltage: float | None) -> tuple[Robot, Term]:
    """The robot with its motors at a supply voltage, or without, and the term that limits torques."""
    robot = robots.load("solo12")
    if voltage is None:
        return robot, EffortLimits(limit=None if effort is None else np.full(robot.nu, effort))
    if effort is not None:
        raise InputError(
            f"solo12-jump has both effort={effort:g} and voltage={voltage:g}",
            "allowed: one of them; with a voltage the motors' currents limit torques",
        )
    return robot.with_drives((solo12.drive(voltage),) * robot.nu), DriveLimits()


def build(
    *,
    distance: float,
    height: float,
    yaw: float,
    stance: float,
    flight: float | None,
    landing: float,
    friction: float,
    effort: float | None,
    voltage: float | None,
    touchdown: str,
) -> Problem:
    """Build the jump; see ``FAMILY`` for the parameters. Raises InputError."""
    robot, torque_limits = _actuated(effort, voltage)
    # Apex of a parabola from and to the standing height, with the rise that straight legs add.
    needed = 2 * math.sqrt(2 * max(height - TAKEOFF_RISE, 0.0) / STANDARD_GRAVITY)
    flight = max(SHORTEST_FLIGHT, needed) if flight is None else flight
    end = _pose(robot, distance, 0.0, 0.0, yaw)
    impact = touchdown == "impact"
    soft = (ImpulseCost(weight=IMPULSE_WEIGHT),) if impact else ()
    ground = FlatGround(friction=friction)
    return Problem(
        name="solo12-jump",
        robot=robot,
        schedule=_schedule(robot, end, (stance, flight, landing), impact),
        terrain=ground,
        initial_q=robot.reference,
        initial_v=np.zeros(robot.nv),
        terms=(*_terms(robot, end, height, ground, torque_limits), *soft),
        guess=_Guess(robot, end, np.array([distance, 0.0, yaw]), (stance, flight, landing)),
        parameters={"flight": flight},
    )


FAMILY = Family(
    name="solo12-jump",
    robot="solo12",
    phases=("stance", "flight", "landing"),
    summary="jump from stance to a target pose, land on its footholds and come to rest",
    parameters=(
        Parameter(
            name="distance", default=0.3, unit="m", lower=-1.0, upper=1.0, meaning="forward displacement"
        ),
        Parameter(
            name="height",
            default=0.0,
            unit="m",
            lower=0.0,
            upper=0.6,
            meaning="least rise of the base over standing in mid flight",
        ),
        Parameter(
            name="yaw",
            default=0.0,
            unit="rad",
            lower=-math.pi / 2,
            upper=math.pi / 2,
            meaning="turn to the left",
        ),
        Parameter(
            name="stance", default=0.4, unit="s", lower=1e-3, upper=10.0, meaning="duration of the push"
        ),
        Parameter(
            name="flight",
            default=None,
            unit="s",
            lower=1e-3,
            upper=2.0,
            meaning="duration of the flight (default: from the height, at least 0.3)",
        ),
        Parameter(
            name="landing",
            default=0.5,
            unit="s",
            lower=1e-3,
            upper=10.0,
            meaning="duration from touchdown to rest",
        ),
        Parameter(
            name="friction", default=0.7, unit="", lower=0.0, upper=10.0, meaning="Coulomb coefficient"
        ),
        Parameter(
            name="effort",
            default=None,
            unit="N m",
            lower=0.0,
            upper=1e4,
            meaning="torque limit (default: the URDF's)",
        ),
        Parameter(
            name="voltage",
            default=None,
            unit="V",
            lower=1.0,
            upper=60.0,
            meaning="supply of the robot's own motors (24 V), with rotor inertia, current limit and "
            "torque-speed envelope (default: joints without motors)",
        ),
        Choice(
            name="touchdown",
            default="soft",
            choices=("soft", "impact"),
            meaning="land at zero foot velocity or by a rigid impact",
        ),
    ),
    build=build,
)
