"""A robot as one rigid body on its footholds: a reduced problem for the same pipeline.

The robot's bodies are welded at its reference posture. With the total mass m, the composite inertia I about
the centre of mass c in base axes, the base's rotation R and known footholds p_i (Di Carlo et al. 2018,
without their linearisation),

    m (c'' - g) = sum f_i,      I omega' + omega x I omega = R^T sum ((p_i - c) x f_i + m_i)

Legs have no separate mass and no joints. Instead, each active foot is kept within reach of its hip. The
solution gives the base motion and the forces, from which ``body_guess`` makes a guess for the full problem.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import partial

import casadi as ca
import numpy as np
import pinocchio as pin
from typing_extensions import override

from trajopt.arguments import checked
from trajopt.dynamics.rotations import rotation_matrix
from trajopt.errors import InputError
from trajopt.problem.problem import Problem
from trajopt.reduced.footsteps import Foothold, FootstepPlan, StepPhase, feet_of
from trajopt.robot.kinematics import frame_pose, inverse_kinematics
from trajopt.robot.legs import require_free_flyer
from trajopt.robot.robot import Robot
from trajopt.robot.units import Units
from trajopt.schedule.placing import landing_place
from trajopt.schedule.schedule import Motion, Schedule
from trajopt.terms.context import Context
from trajopt.terms.costs import AccelerationCost, TimeCost, VelocityCost, WrenchCost
from trajopt.terms.frames import FrameHeight, FramePose, FrameVelocity
from trajopt.terms.friction import ContactConstraint, NormalForce
from trajopt.terms.interfaces import PointConstraint, Rows, Term
from trajopt.terms.terminal import TerminalRest, TerminalState

# Frame at the origin of the free-flyer, in its axes.
BODY = "single_rigid_body"
# Range of the distance from hip to active foot, over the straight leg's length. A straight leg is singular
# and can bend either way, so a guess keeps well away from it (docs/modelling/reduced-models.md).
SHORTEST, LONGEST = 0.2, 0.85
# Factor that puts a foot's target beyond any leg's reach, so that inverse kinematics straighten the leg.
BEYOND = 4.0
# Terms with the same meaning for one body: base motion, contact wrenches, time.
KEPT = (ContactConstraint, NormalForce, AccelerationCost, VelocityCost, WrenchCost, TimeCost)


@dataclass(frozen=True, kw_only=True, eq=False)
class RigidBody:
    """A robot welded at its reference posture; base axes.

    mass: kg. lever: (3,) base to centre of mass, m. inertia: (3, 3) about the centre of mass, kg m^2.
    hips: (3,) position by contact, m. legs: length of the straight leg from hip to foot by contact, m.
    """

    mass: float
    lever: np.ndarray
    inertia: np.ndarray
    hips: Mapping[str, np.ndarray]
    legs: Mapping[str, float]


def rigid_body(robot: Robot) -> RigidBody:
    """Return mass properties and legs of a robot welded at its reference, without rotor inertias (armature).

    Raises InputError unless the base is a free-flyer in world axes.
    """
    require_free_flyer(robot)
    model, data = robot.model, robot.model.createData()
    pin.ccrba(model, data, robot.reference, np.zeros(robot.nv))
    base = data.oMi[1]
    hips, legs = {}, {}
    for contact in robot.contacts:
        frame = model.frames[model.getFrameId(contact.frame)]
        chain = [int(joint) for joint in model.supports[frame.parentJoint] if joint > 1]
        if chain:
            hip = data.oMi[chain[0]].translation.copy()
            hips[contact.name] = base.actInv(hip)
            foot = frame_pose(robot, robot.reference, contact.frame).translation
            towards = {contact.frame: hip + BEYOND * (foot - hip)}
            straight = inverse_kinematics(robot, robot.reference, towards).q
            reach = frame_pose(robot, straight, contact.frame).translation - hip
            legs[contact.name] = float(np.linalg.norm(reach))
    return RigidBody(
        mass=float(data.Ig.mass),
        lever=base.actInv(data.com[0]),
        inertia=base.rotation.T @ data.Ig.inertia @ base.rotation,
        hips=hips,
        legs=legs,
    )


def body_robot(robot: Robot) -> Robot:
    """Return the one-body robot with the same base, weight and length and no joints.

    Base frames keep their names. Contact frames are fixed to the body as in the reference posture.
    """
    body = rigid_body(robot)
    source, data = robot.model, robot.model.createData()
    pin.framesForwardKinematics(source, data, robot.reference)
    model = pin.Model()
    model.name, model.gravity = robot.name, source.gravity
    joint = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), source.names[1])
    inertia = pin.Inertia(body.mass, body.lever, body.inertia)
    model.appendBodyToJoint(joint, inertia, pin.SE3.Identity())
    model.addFrame(pin.Frame(BODY, joint, 0, pin.SE3.Identity(), pin.OP_FRAME))
    contacts = [contact.frame for contact in robot.contacts]
    for index, frame in enumerate(source.frames):
        if frame.parentJoint == 1 or frame.name in contacts:
            model.addFrame(pin.Frame(frame.name, joint, 0, data.oMi[1].actInv(data.oMf[index]), pin.OP_FRAME))
    return Robot.from_model(
        model, name=robot.name, contacts=robot.contacts, reference=robot.reference[: model.nq]
    )


def footholds_of(problem: Problem) -> FootstepPlan:
    """Return the footholds of a problem in each phase.

    They come from ``initial_q`` in the first phase, then from the schedule's footholds, or without those from
    the problem's guess at touchdown, moved along the normal onto the surface.
    """
    robot, t = problem.robot, 0.0
    current = feet_of(robot, problem.initial_q)
    supports = []
    for i, phase in enumerate(problem.schedule.phases):
        landing = problem.schedule.new_contacts(i)
        guessed = feet_of(robot, problem.guess(t)) if landing else {}
        for name in landing:
            place = landing_place(phase, robot.contact(name), problem.terrain, guessed[name].position)
            current[name] = replace(guessed[name], position=place)
        feet = {name: current[name] for name in phase.contacts}
        supports.append(StepPhase(name=phase.name, duration=phase.duration, feet=feet))
        t += phase.duration
    return FootstepPlan(tuple(supports))


@dataclass(frozen=True, kw_only=True, eq=False)
class BodyDynamics(PointConstraint):
    """Newton-Euler equations of one body on known ``footholds``, 6 rows.

    Forces are in world axes, moments about the centre of mass in base axes. Mass properties are parameters,
    so that all robots share one compiled function.
    """

    body: RigidBody
    footholds: Mapping[str, Foothold]

    @override
    def rows(self, context: Context, units: Units) -> Rows:
        rotation = rotation_matrix(context.q[3:7])
        lever, inertia = context.parameter(self.body.lever), context.parameter(self.body.inertia)
        omega, domega = context.v[3:6], context.a[3:6]
        turning = ca.cross(domega, lever) + ca.cross(omega, ca.cross(omega, lever))
        felt = context.ddxi[:3] + ca.mtimes(rotation, turning)
        felt -= context.parameter(context.robot.model.gravity.linear)
        com = context.xi[:3] + ca.mtimes(rotation, lever)
        force, moment = ca.SX.zeros(3), ca.SX.zeros(3)
        for contact in context.contacts:
            wrench = context.wrenches[contact.name]
            arm = context.parameter(self.footholds[contact.name].position) - com
            force += wrench[:3]
            moment += ca.cross(arm, wrench[:3])
            if contact.kind == "surface":
                moment += wrench[3:]
        spin = ca.mtimes(inertia, omega)
        linear = context.parameter(self.body.mass) * felt - force
        angular = ca.mtimes(inertia, domega) + ca.cross(omega, spin) - ca.mtimes(rotation.T, moment)
        return Rows.create(ca.vertcat(linear, angular), 0, 0, units.wrench)


@dataclass(frozen=True, kw_only=True, eq=False)
class FootReach(PointConstraint):
    """Keep active feet within reach: shortest^2 <= |p_i - hip_i|^2 / leg_i^2 <= longest^2."""

    body: RigidBody
    footholds: Mapping[str, Foothold]
    shortest: float = SHORTEST
    longest: float = LONGEST

    def __post_init__(self) -> None:
        if not 0 <= self.shortest < self.longest:
            raise InputError(
                f"reach is from {self.shortest:g} to {self.longest:g}", "allowed: 0 <= shortest < longest"
            )

    @override
    def rows(self, context: Context, units: Units) -> Rows | None:
        rotation, parts = rotation_matrix(context.q[3:7]), []
        for contact in context.contacts:
            if contact.name in self.body.hips:
                hip = context.xi[:3] + ca.mtimes(rotation, context.parameter(self.body.hips[contact.name]))
                leg = context.parameter(self.footholds[contact.name].position) - hip
                parts.append(ca.sumsqr(leg) / context.parameter(self.body.legs[contact.name]) ** 2)
        if not parts:
            return None
        return Rows.create(ca.vertcat(*parts), self.shortest**2, self.longest**2, 1.0)


@checked
def body_problem(
    problem: Problem, *, terms: tuple[Term, ...] = (), shortest: float = SHORTEST, longest: float = LONGEST
) -> Problem:
    """Return the problem on one rigid body, with the same schedule, known footholds and limited reach.

    Footholds are those of `footholds_of`. Terms on contact forces, costs of base motion, wrenches and time,
    heights of base frames, and the base's part of the terminal state and rest are kept. Impacts become
    landings at zero velocity, since massless feet have none.

    Args:
        problem: The problem of the whole robot.
        terms: Additional terms for the single body.
        shortest: Least distance from hip to foot, over the straight leg's length.
        longest: Largest distance from hip to foot, over the straight leg's length.

    Raises:
        InputError: If the base is not a free-flyer in world axes, or the problem has phases in minimal
            coordinates, a payload, or a periodic motion.
    """
    if problem.modes:
        raise InputError(f"phases {', '.join(problem.modes)} have coordinates of their own", "allowed: none")
    if problem.periodicity is not None or problem.payloads or problem.wrenches:
        what = f"problem '{problem.name}' is periodic, or has payloads or wrenches"
        raise InputError(what, "allowed: a fixed start, and neither of them")
    body, robot, plan = rigid_body(problem.robot), body_robot(problem.robot), footholds_of(problem)
    dynamics: list[PointConstraint] = []
    limits: list[Term] = []
    for support in plan.supports:
        feet, here = support.feet, (support.name,)
        dynamics.append(BodyDynamics(body=body, footholds=feet, during=here))
        limits.append(FootReach(body=body, footholds=feet, during=here, shortest=shortest, longest=longest))
    phases = tuple(replace(phase, impact=False) for phase in problem.schedule.phases)
    return replace(
        problem,
        name=f"{problem.name}-body",
        robot=robot,
        schedule=Schedule(phases),
        initial_q=problem.initial_q[: robot.nq],
        initial_v=problem.initial_v[: robot.nv],
        terms=(*_kept(problem, robot), *limits, *terms),
        guess=partial(_first, problem.guess, robot.nq),
        actuation="torque",
        dynamics=tuple(dynamics),
    )


def _first(motion: Motion, size: int, t: float) -> np.ndarray:
    """Return the first ``size`` coordinates of a configuration: those of the base."""
    return motion(t)[:size]


def _kept(problem: Problem, robot: Robot) -> list[Term]:
    terms: list[Term] = []
    for term in problem.terms:
        if isinstance(term, KEPT) or (isinstance(term, FrameHeight) and robot.model.existFrame(term.frame)):
            terms.append(term)
        elif isinstance(term, TerminalState):
            turn = pin.Quaternion(*term.q[[6, 3, 4, 5]]).toRotationMatrix()
            terms.append(FramePose(frame=BODY, position=term.q[:3], rotation=turn))
        elif isinstance(term, TerminalRest):
            terms.append(FrameVelocity(frame=BODY, velocity=np.zeros(6)))
    return terms
