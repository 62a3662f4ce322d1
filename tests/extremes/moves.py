"""Motions whose outcome is known: between configurations, standing, standing pushed, floating."""

from collections.abc import Callable, Sequence
from functools import partial

import numpy as np
import pinocchio as pin

from trajopt import FlatGround, Phase, Problem, Robot, Schedule, terms
from trajopt.dynamics import contact_jacobian
from trajopt.robot import Units, contact_poses, frame_pose, inverse_kinematics
from trajopt.robot.building import put_on_ground
from trajopt.schedule import footholds_at
from trajopt_library.problems import common

# Duration of a phase on legs, s: long against what a step of a small quadruped takes at least.
PHASE = 0.2

Guess = Callable[[float], np.ndarray]


def reach(
    robot: Robot,
    start: np.ndarray,
    goal: np.ndarray,
    *,
    duration: float = 1.0,
    end: Sequence[terms.Term] | None = None,
    guess: Guess | None = None,
    velocity: np.ndarray | None = None,
    limits: Sequence[terms.Term] = (terms.TorqueLimits(), terms.PositionLimits(), terms.VelocityLimits()),
    intervals: int = 10,
) -> Problem:
    """An arm goes from ``start`` to ``goal`` (nq,), to rest, within limits; ``end`` replaces the goal."""
    return Problem(
        name="reach",
        robot=robot,
        schedule=Schedule((Phase(name="reach", duration=duration),)),
        initial_q=start,
        initial_v=np.zeros(robot.nv) if velocity is None else velocity,
        terms=(
            *terms.effort_costs(),
            *limits,
            *((terms.TerminalState(q=goal), terms.TerminalRest(q=goal)) if end is None else end),
        ),
        guess=between(robot, start, goal, duration) if guess is None else guess,
        default_intervals=intervals,
    )


def pose_goal(robot: Robot, q: np.ndarray, frame: str) -> tuple[terms.Term, ...]:
    """The pose that a frame has at ``q`` (nq,), at rest."""
    pose = frame_pose(robot, q, frame)
    return terms.FramePose(
        frame=frame, position=pose.translation, rotation=pose.rotation
    ), terms.TerminalRest(q=q)


def stance(
    robot: Robot,
    start: np.ndarray,
    goal: np.ndarray | None = None,
    *,
    duration: float = 2 * PHASE,
    guess: Guess | None = None,
    extra: Sequence[terms.Term] = (),
    intervals: int = 10,
) -> Problem:
    """All contacts stay where ``start`` (nq,) has them; the robot ends at rest at ``goal``, default start."""
    names = tuple(contact.name for contact in robot.contacts)
    end = start if goal is None else goal
    schedule = Schedule((Phase(name="stance", duration=duration, contacts=names),))
    guess = between(robot, start, end, duration) if guess is None else guess
    return legged(robot, schedule, start, end, guess, extra=extra, intervals=intervals)


def steps(
    robot: Robot,
    sets: Sequence[Sequence[str]],
    *,
    duration: float = PHASE,
    clearance: float = 0.02,
    intervals: int = 10,
    impact: bool = False,
    footholds: bool = True,
) -> Problem:
    """Phases on these contacts, on the spot: whatever lifts lands where it was, by default at footholds."""
    places, before, phases = footholds_at(robot, robot.reference), set(sets[0]), []
    for index, names in enumerate(sets):
        new = [name for name in names if name not in before]
        phases.append(
            Phase(
                name=f"phase {index}",
                duration=duration,
                contacts=tuple(names),
                footholds={name: places[name] for name in new} if footholds else {},
                impact=impact and bool(new),
            )
        )
        before = set(names)
    ground = FlatGround(friction=0.7)
    over = (terms.SwingClearance(height=clearance, terrain=ground),) if clearance else ()
    q = robot.reference
    return legged(robot, Schedule(tuple(phases)), q, q, lambda t: q, extra=over, intervals=intervals)


def legged(
    robot: Robot,
    schedule: Schedule,
    start: np.ndarray,
    goal: np.ndarray,
    guess: Guess,
    *,
    extra: Sequence[terms.Term] = (),
    intervals: int = 10,
    ground: FlatGround | None = None,
) -> Problem:
    """A legged robot from rest to rest on flat ground, with least effort, within its limits."""
    return Problem(
        name="legged",
        robot=robot,
        schedule=schedule,
        terrain=FlatGround(friction=0.7) if ground is None else ground,
        initial_q=start,
        terms=(
            *terms.effort_costs(),
            terms.TorqueLimits(),
            terms.PositionLimits(),
            terms.VelocityLimits(),
            *terms.contact_cones(robot.contacts),
            terms.TerminalState(q=goal),
            terms.TerminalRest(q=goal),
            *extra,
        ),
        guess=guess,
        default_intervals=intervals,
    )


def between(robot: Robot, start: np.ndarray, goal: np.ndarray, duration: float) -> Guess:
    """Along the geodesic from start to goal (nq,), at a constant rate, then still."""
    return lambda t: np.asarray(
        pin.interpolate(robot.model, start, goal, float(np.clip(t / duration, 0.0, 1.0)))
    )


def with_joints(robot: Robot, values: dict[str, float]) -> np.ndarray:
    """The reference (nq,) with these joints (rad) changed and, on legs, the lowest contact on the ground."""
    q = robot.reference.copy()
    for name, value in values.items():
        q[robot.model.joints[robot.model.getJointId(name)].idx_q] = value
    return put_on_ground(robot.model, robot.base, robot.contacts, q)


def lowered(robot: Robot, q: np.ndarray, depth: float) -> np.ndarray:
    """The base ``depth`` m lower, all contacts where ``q`` (nq,) has them, legs bent as in the reference."""
    feet = {
        c.frame: pose if c.kind == "surface" else pose.translation
        for c, pose in zip(robot.contacts, contact_poses(robot, q).values(), strict=True)
    }
    sunk = robot.reference.copy()
    sunk[:7] = q[:7]
    sunk[2] -= depth
    found = inverse_kinematics(robot, sunk, feet)
    assert found.error < 1e-9, found.error
    return found.q


# A robot that floats is this many lengths higher than it stands, so that no leg meets the ground.
FLOATING = 4.0


def stand(
    robot: Robot,
    *,
    duration: float | None = None,
    friction: float = 0.7,
    exact: bool = False,
    push: tuple[float, ...] = (0.0,) * 6,
    costs: tuple[terms.Term, ...] | None = None,
) -> Problem:
    """Stand on all contacts at the reference; after a push of the base come back to it, to rest.

    duration: s, by default 3 sqrt(l / g). push: velocity (6,) of the base at the start, m/s and rad/s over
    their natural units, as far as the feet in place let it. exact: the smooth cone of friction, not the
    pyramid.
    """
    time = 3 * Units(robot).time if duration is None else duration
    names = tuple(contact.name for contact in robot.contacts)
    return Problem(
        name="stand",
        robot=robot,
        schedule=Schedule((Phase(name="stand", duration=time, contacts=names),)),
        terrain=FlatGround(friction=friction),
        initial_v=feet_still(robot, Units(robot).twist * push),
        terms=(
            *(terms.effort_costs() if costs is None else costs),
            terms.TorqueLimits(),
            terms.PositionLimits(),
            terms.VelocityLimits(),
            *((terms.FrictionCone(),) if exact else terms.contact_cones(robot.contacts)),
            terms.TerminalState(q=robot.reference),
            terms.TerminalRest(q=robot.reference),
        ),
        guess=partial(_still, robot.reference),
        default_intervals=10,
    )


def feet_still(robot: Robot, base: np.ndarray) -> np.ndarray:
    """Rates (nv,) with these of the base (6,) and joints that keep all contacts in place."""
    contacts = [(contact.frame, contact.rows) for contact in robot.contacts]
    jacobian = contact_jacobian(robot.model, robot.reference, contacts)
    joints = -np.linalg.lstsq(jacobian[:, 6:], jacobian[:, :6] @ base, rcond=None)[0]
    return np.concatenate([base, joints])


def _still(q: np.ndarray, t: float) -> np.ndarray:
    return q


def turn_over(robot: Robot, *, yaw: float, duration: float) -> Problem:
    """Float without contacts and turn about the vertical by moving the legs alone, from rest to rest.

    yaw: rad. As a cat does: no momentum, and yet another orientation with the same posture.
    """
    up = (0.0, 0.0, FLOATING * robot.length)
    start, end = common.displaced(robot, up), common.displaced(robot, up, yaw)
    return Problem(
        name="turn-over",
        robot=robot,
        schedule=Schedule((Phase(name="float", duration=duration),)),
        initial_q=start,
        terms=(
            *terms.effort_costs(),
            terms.TorqueLimits(),
            terms.VelocityLimits(),
            terms.TerminalState(q=end),
            terms.TerminalRest(q=end),
        ),
        guess=partial(_turning, robot, yaw, duration),
        default_intervals=12,
    )


def _turning(robot: Robot, yaw: float, duration: float, t: float) -> np.ndarray:
    up = (0.0, 0.0, FLOATING * robot.length)
    return common.displaced(robot, up, yaw * min(max(t / duration, 0.0), 1.0))
