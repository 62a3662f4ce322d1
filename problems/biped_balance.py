"""A biped is pushed while it stands: it comes to rest with its feet in place, or takes steps.

The push is an impulse on the base: velocities jump, except those of the standing feet.
"""

import math

import numpy as np
import pinocchio as pin

from trajopt.dynamics import contact_jacobian, gravity_of
from trajopt.problem import Family, Problem
from trajopt.reduced import legged_guess
from trajopt.robot import Robot, Units, biped_legs
from trajopt.schedule import Phase, Schedule
from trajopt.terrain import FlatGround

from . import bipeds, common

# Push over mass times sqrt(g l), which moves the pendulum's capture point by this fraction of the robot's
# length.
PUSH = 0.05
# Distance of the step over that of the pendulum's capture point.
BEYOND = 1.5
# Durations in units of sqrt(l / g).
STAND = 6.0
STEPS = {"react": 0.3, "step_1": 1.2, "double": 0.4, "step_2": 1.2, "settle": 2.5}
CLEARANCE = 0.05
INTERVALS = 40


def pushed(robot: Robot, impulse: np.ndarray) -> np.ndarray:
    """Velocity (nv,) of the standing robot just after an impulse (3,) N s, world, on its base's origin.

    M v = J_b^T p + J_c^T p_c with J_c v = 0: of all velocities that move no foot, the nearest to that of the
    free robot in the metric of kinetic energy.
    """
    q, model = robot.reference, robot.model
    mass = pin.crba(model, model.createData(), q)
    levers = [contact.lever(FlatGround().surface) for contact in robot.contacts]
    held = contact_jacobian(model, q, [(contact.frame, contact.rows) for contact in robot.contacts], levers)
    generalized = contact_jacobian(model, q, [(model.names[1], (0, 1, 2))]).T @ impulse
    free = np.linalg.solve(mass, generalized)
    spread = np.linalg.solve(mass, held.T)
    # Linearly dependent contact rows share their impulses.
    return np.asarray(free - spread @ np.linalg.lstsq(held @ spread, held @ free, rcond=None)[0])


def _capture(robot: Robot, velocity: np.ndarray) -> np.ndarray:
    """Return the vector (2,) in m from the centre of mass to the pendulum's capture point."""
    data = robot.model.createData()
    com = pin.centerOfMass(robot.model, data, robot.reference, velocity)
    height = com[2] - common.foot_radius(robot)  # forces act at the centres of the feet
    return np.asarray(data.vcom[0][:2] * math.sqrt(height / gravity_of(robot.model)))


def _schedule(robot: Robot, recover: str, way: np.ndarray) -> Schedule:
    unit = Units(robot).time
    if recover == "stand":
        return Schedule((Phase(name="stand", duration=STAND * unit, contacts=biped_legs(robot)),))
    return bipeds.two_steps(robot, way, {name: part * unit for name, part in STEPS.items()})


def build(*, robot: str, push: float | None, direction: float, recover: str, **limits: float) -> Problem:
    """Build the recovery; see ``FAMILY`` for the parameters. Raises InputError."""
    body = bipeds.biped(robot)
    push = PUSH * body.mass * math.sqrt(gravity_of(body.model) * body.length) if push is None else push
    if recover == "default":
        recover = "stand" if all(contact.kind == "surface" for contact in body.contacts) else "step"
    start = pushed(body, push * np.array([math.cos(direction), math.sin(direction), 0.0]))
    way = np.append(BEYOND * _capture(body, start) if recover == "step" else np.zeros(2), 0.0)
    schedule = _schedule(body, recover, way)
    path = [bipeds.waypoint(body, 0.0, (0.0, 0.0, 0.0)), bipeds.waypoint(body, schedule.duration, way)]
    return common.problem(
        "biped-balance",
        body,
        schedule,
        legged_guess(body, schedule, path),
        clearance=CLEARANCE * body.length if recover == "step" else None,
        end=common.displaced(body, way),
        initial_v=start,
        parameters={"push": push, "recover": recover},
        default_intervals=INTERVALS,
        **limits,
    )


FAMILY = Family(
    name="biped-balance",
    robots=bipeds.ROBOTS,
    phases=("stand",),
    summary="come to rest after a push, on the same feet or by two steps",
    parameters=(
        common.number(
            "push",
            None,
            "N s",
            "impulse on the base (default: 0.05 of mass times sqrt(g length))",
            (0.0, 1e4),
        ),
        common.angle(
            "direction", 0.0, "direction of the push, from forward to the left", (-math.pi, math.pi)
        ),
        common.choice(
            "recover",
            "keep the feet in place, or step (default: stand on soles, step on points)",
            "default",
            "stand",
            "step",
        ),
        common.friction(0.7),
        common.TORQUE_SHARE,
    ),
    build=build,
)
