"""Small robots with two sides for tests of scenes, exactly symmetric or not, and how well optima agree."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pinocchio as pin

import trajopt
from tests.support.models import placement
from trajopt import Contact, FlatGround, Phase, Problem, Robot, Schedule, Solution
from trajopt.dynamics.rerooting import joint_slices
from trajopt.robot.actuators.drive import Drive
from trajopt.robot.kinematics import inverse_kinematics
from trajopt.robot.mirror import find_mirror, pairs, reflected, reflected_inertia
from trajopt.terms import (
    AccelerationCost,
    FrictionCone,
    PositionLimits,
    PostureCost,
    SwingClearance,
    Term,
    TerminalRest,
    TerminalState,
    TorqueCost,
    TorqueLimits,
    VelocityCost,
    VelocityLimits,
    WrenchCost,
)

FEET = ("left_foot", "right_foot")
LEG = 0.5  # m
STANCE = 0.3  # s
EFFORT, SPEED = 60.0, 20.0  # N m or N, rad/s or m/s


def _box(mass: float, size: float) -> pin.Inertia:
    return pin.Inertia.FromBox(mass, size, 1.5 * size, 2 * size)


def _at(x: float, y: float, z: float) -> pin.SE3:
    return pin.SE3(np.eye(3), np.array([x, y, z]))


def _joint(
    model: pin.Model, parent: int, kind: pin.JointModel, place: pin.SE3, name: str, reach: float
) -> int:
    limit = np.full(kind.nv, 1.0)
    low, high = (np.full(kind.nq, sign * reach) for sign in (-1, 1))
    joint = model.addJoint(parent, kind, place, name, EFFORT * limit, SPEED * limit, low, high)
    model.addJointFrame(joint)
    model.armature[model.joints[joint].idx_v] = 0.02
    return int(joint)


def _leg(model: pin.Model, base: int, side: str, tilt: float, heavier: float) -> None:
    """Abduction about x, a hip about y (the right one's axis the other way round), a sliding shank."""
    s = 1.0 if side == "left" else -1.0
    hip = _joint(model, base, pin.JointModelRX(), _at(0.0, 0.1 * s, -0.1), f"{side}_abduction", 0.6)
    model.appendBodyToJoint(hip, _box(0.3, 0.05), _at(0.01, 0.02 * s, 0.0))
    axis = pin.JointModelRevoluteUnaligned(0.0, s, 0.0)
    turned = pin.SE3(pin.utils.rotate("x", tilt * s), np.array([0.0, 0.03 * s, 0.0]))
    thigh = _joint(model, hip, axis, turned, f"{side}_hip", 1.2)
    model.appendBodyToJoint(thigh, _box(0.8 * heavier, 0.1), _at(0.02, 0.01 * s, -0.1))
    shank = _joint(model, thigh, pin.JointModelPZ(), _at(0.0, 0.0, -LEG / 2), f"{side}_knee", 0.2)
    model.appendBodyToJoint(shank, _box(0.4, 0.05), _at(0.0, 0.01 * s, -0.05))


def biped(*, tilt: float = 0.0, heavier: float = 1.0, waist: bool = False) -> Robot:
    """A body on two legs with point feet, and an arm without use on each side (a continuous joint).

    tilt: of the plane in which a leg swings, rad. heavier: the right thigh over the left. waist: a yaw and a
    pitch joint below a trunk that carries the arms.
    """
    model = pin.Model()
    model.name = "biped"
    base = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "base")
    model.addJointFrame(base)
    model.appendBodyToJoint(base, _box(3.0, 0.2), _at(0.01, 0.0, 0.02))
    model.addFrame(pin.Frame("waist", base, 0, _at(0.0, 0.0, 0.1), pin.OP_FRAME))
    trunk = base
    for side, weight in (("left", 1.0), ("right", heavier)):
        _leg(model, base, side, tilt, weight)
    if waist:
        yaw = _joint(model, base, pin.JointModelRZ(), _at(0.0, 0.0, 0.15), "waist_yaw", 1.0)
        model.appendBodyToJoint(yaw, _box(0.2, 0.05), _at(0.0, 0.0, 0.0))
        trunk = _joint(model, yaw, pin.JointModelRY(), _at(0.0, 0.0, 0.05), "waist_pitch", 1.0)
        model.appendBodyToJoint(trunk, _box(1.0, 0.1), _at(0.02, 0.0, 0.1))
    for s, side in ((1.0, "left"), (-1.0, "right")):
        arm = _joint(model, trunk, pin.JointModelRUBY(), _at(0.0, 0.15 * s, 0.1), f"{side}_arm", 9.0)
        model.appendBodyToJoint(arm, _box(0.2, 0.05), _at(0.03, 0.0, -0.1))
    # Point feet below the centre of mass: on a line of contacts nothing else stands.
    com = pin.centerOfMass(model, model.createData(), pin.neutral(model))
    for side in ("left", "right"):
        shank = model.getJointId(f"{side}_knee")
        model.addFrame(pin.Frame(f"{side}_foot", shank, 0, _at(com[0], 0.0, -LEG / 2), pin.OP_FRAME))
    return Robot.from_model(model, name="biped", contacts=[Contact(frame=foot) for foot in FEET])


def push(robot: Robot, *, terms: Sequence[Term] | None = None, **changes: object) -> Problem:
    """The biped squats on both feet from rest to rest."""
    made = {
        "name": "push",
        "robot": robot,
        "schedule": Schedule((Phase(name="stance", duration=STANCE, contacts=FEET),)),
        "terrain": FlatGround(),
        "initial_q": robot.reference,
        "initial_v": np.zeros(robot.nv),
        "terms": usual(robot) if terms is None else tuple(terms),
        "guess": lambda t: robot.reference,
        "default_intervals": 6,
    }
    return Problem(**(made | changes))


def usual(robot: Robot, lower: float = 0.04) -> tuple[Term, ...]:
    """Costs and limits of all kinds, and an end with the body lowered by ``lower`` m."""
    feet = {foot: placement(robot.model, robot.reference, foot).translation.copy() for foot in FEET}
    end = robot.reference.copy()
    end[2] -= lower
    end = inverse_kinematics(robot, end, feet).q
    return (
        TorqueCost(weight=1.0),
        AccelerationCost(weight=1e-2),
        VelocityCost(weight=1e-2),
        PostureCost(weight=1e-1),
        WrenchCost(weight=1e-2),
        TorqueLimits(),
        PositionLimits(),
        VelocityLimits(),
        FrictionCone(),
        SwingClearance(height=0.01, terrain=FlatGround()),
        TerminalState(q=end),
        TerminalRest(q=end),
    )


def symmetrised(robot: Robot) -> Robot:
    """The robot with every right body, joint and frame the mirror image of the left."""
    mirror, model = find_mirror(robot), pin.Model(robot.model)
    for joint in [1, *(j for j in range(2, model.njoints) if mirror.partner[j] == j)]:
        body = model.inertias[joint]
        shape = np.array(body.inertia)
        shape[0, 1] = shape[1, 0] = shape[1, 2] = shape[2, 1] = 0.0
        model.inertias[joint] = pin.Inertia(body.mass, body.lever * [1, 0, 1], shape)
    for left, right in pairs(robot, mirror):
        model.jointPlacements[right] = reflected(model.jointPlacements[left])
        model.inertias[right] = reflected_inertia(model.inertias[left])
        own, image = (joint_slices(model, model.names[j])[1] for j in (left, right))
        model.armature[image] = model.armature[own]
    for contact in robot.contacts:
        frame = model.frames[model.getFrameId(contact.frame)]
        joint = int(frame.parentJoint)
        for other in robot.contacts:
            twin = model.frames[model.getFrameId(other.frame)]
            if int(twin.parentJoint) == mirror.partner[joint] > joint:
                twin.placement = reflected(frame.placement)
    return replace(robot, model=model)


def drive(side: float = 1.0) -> Drive:
    """A motor behind a gear with everything a drive can have."""
    return Drive(
        gear_ratio=9.0, rotor_inertia=1e-5, viscous_friction=0.02 * side, coulomb_friction=0.05,
        torque_limit=3.0, stall_torque=4.0, no_load_speed=700.0,
    )  # fmt: skip


# Solvers stop at 1e-8 in natural units; two ways to write one problem differ by that over costs of 1e-3.
SOLVED = 1e-8
SAME_OPTIMUM = 1e-5
SAME_MOTION = 1e-4  # rad, m: where the optimum is flat its minimiser is less sharp than its value
MOST_ITERATIONS = 60


def solved(problem: Problem, intervals: int | None = None, perturb: float = 0.0) -> Solution:
    solution = trajopt.solve(
        problem,
        intervals=intervals,
        perturb=perturb,
        tolerance=SOLVED,
        max_iterations=MOST_ITERATIONS,
        fixed_mesh=True,
    )
    assert solution.converged, solution.statistics.advice
    return solution


def objective(solution: Solution) -> float:
    return float(solution.statistics.objective)
