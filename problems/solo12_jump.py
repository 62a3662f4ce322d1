"""A jump of Solo12: stance, flight, landing on the footholds of the target pose, rest."""

from __future__ import annotations

import math

import numpy as np
import pinocchio as pin

from trajopt.dynamics.model_quantities import STANDARD_GRAVITY
from trajopt.errors import InputError
from trajopt.problem.family import Family, Parameter
from trajopt.problem.problem import Problem
from trajopt.robot.kinematics import contact_positions, inverse_kinematics
from trajopt.robot.robot import Robot
from trajopt.terms import (
    DriveLimits,
    EffortLimits,
    FrameHeight,
    FrictionPyramid,
    ImpulseCost,
    PositionLimits,
    SwingClearance,
    Term,
    TerminalRest,
    TerminalState,
    VelocityLimits,
)
from trajopt.terrain.flat import FlatGround
from trajopt_library import robots
from trajopt_library.robots import solo12

from . import common

# A flight shorter than this leaves no time to move the feet to their new places, s.
SHORTEST_FLIGHT = 0.3
# Rise of the base over its standing height at take-off in the guess, m: legs not yet straight.
TAKEOFF_RISE = 0.04
# Part of the take-off speed times its duration that the base travels while the feet are on the ground.
GROUND_SHARE = 0.15
# Price of a hard landing: without one an impact brakes for free, torques do not see it.
IMPULSE_WEIGHT = 0.1


def _pose(robot: Robot, x: float, y: float, z: float, yaw: float) -> np.ndarray:
    """Reference posture with the base displaced by (x, y, z) m and turned by yaw rad."""
    q = robot.reference.copy()
    q[:3] += [x, y, z]
    q[3:7] = pin.Quaternion(pin.rpy.rpyToMatrix(0.0, 0.0, yaw)).coeffs()
    return q


class _Guess:
    """Base on a smooth push, a parabola and a smooth landing; legs follow the feet by inverse kinematics."""

    def __init__(
        self, robot: Robot, end: np.ndarray, path: np.ndarray, durations: tuple[float, float, float]
    ) -> None:
        self.robot, self.durations = robot, durations
        self.start_feet, self.end_feet = (contact_positions(robot, q) for q in (robot.reference, end))
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
            return common.hermite(t / stance, stance, 0.0, 0.0, self.takeoff, self.rates)
        if t <= stance + flight:
            s = t - stance
            return self.takeoff + self.rates * s - np.array([0.0, STANDARD_GRAVITY * s * s / 2, 0.0])
        fraction, landing_rates = (t - stance - flight) / landing, self.rates * [1, -1, 1]
        return common.hermite(fraction, landing, self.touchdown, landing_rates, self.end, 0.0)

    def _feet(self, t: float, pose: np.ndarray) -> dict[str, np.ndarray]:
        """Feet on their footholds; in flight carried by the base, from one stance to the other."""
        stance, flight, _ = self.durations
        if t <= stance:
            return self.start_feet
        if t >= stance + flight:
            return self.end_feet
        s, postures = (t - stance) / flight, (self._pose(stance), pose, self._pose(stance + flight))
        before, now, after = (pin.XYZQUATToSE3(q[:7]) for q in postures)
        feet = {}
        for name, start in self.start_feet.items():
            first, last = before.actInv(start), after.actInv(self.end_feet[name])
            feet[name] = now.act(common.hermite(s, flight, first, 0.0, last, 0.0))
        return feet


def _terms(
    robot: Robot, end: np.ndarray, height: float, ground: FlatGround, torque_limits: Term
) -> tuple[Term, ...]:
    return (
        *common.legged_costs(acceleration=2e-2),
        torque_limits,
        PositionLimits(),
        VelocityLimits(),
        FrictionPyramid(friction=ground.friction),
        SwingClearance(height=common.CLEARANCE, terrain=ground),
        FrameHeight(frame=solo12.BASE, height=robot.reference[2] + height, phase="flight"),
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
    durations = (stance, flight, landing)
    return Problem(
        name="solo12-jump",
        robot=robot,
        schedule=common.hop_schedule(contact_positions(robot, end), durations, impact=impact),
        terrain=ground,
        initial_q=robot.reference,
        initial_v=np.zeros(robot.nv),
        terms=(*_terms(robot, end, height, ground, torque_limits), *soft),
        guess=_Guess(robot, end, np.array([distance, 0.0, yaw]), durations),
        parameters={"flight": flight},
    )


FAMILY = Family(
    name="solo12-jump",
    robot="solo12",
    phases=("stance", "flight", "landing"),
    summary="jump from stance to a target pose, land on its footholds and come to rest",
    parameters=(
        common.length("distance", 0.3, "forward displacement", (-1.0, 1.0)),
        common.length("height", 0.0, "least rise of the base over standing in mid flight", (0.0, 0.6)),
        common.yaw(0.0),
        common.duration("stance", 0.4, "duration of the push", (1e-3, 10.0)),
        common.duration(
            "flight", None, "duration of the flight (default: from the height, at least 0.3)", (1e-3, 2.0)
        ),
        common.duration("landing", 0.5, "duration from touchdown to rest", (1e-3, 10.0)),
        common.friction(0.7),
        common.effort(),
        Parameter(
            name="voltage",
            default=None,
            unit="V",
            lower=1.0,
            upper=60.0,
            meaning="supply of the robot's own motors (24 V), with rotor inertia, current limit and "
            "torque-speed envelope (default: joints without motors)",
        ),
        common.touchdown(),
    ),
    build=build,
)
