"""Kinds of joints in a description: an arm with fingers at its end, wheels, joints without drive."""

from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from trajopt.dynamics.base_joint import UNLIMITED
from trajopt.inspection.faults import listed

# A hand weighs at most the first fraction of what its arm's first joint moves; a joint without drive moves at
# most the second fraction of the total mass.
HAND, TINY = 0.25, 0.02
# Bounds for a wheel: sine of its axis's angle to the ground, distance of its centre of mass from the axis
# over its radius of gyration, height of its axis over the lowest tip relative to the height of all joints.
LEVEL, CENTRED, LOW = 0.1, 0.2, 0.1


@dataclass(frozen=True, kw_only=True)
class Limbs:
    """Names of joints that a guess locks, and whether it fixes the base, as for an arm or on wheels."""

    wheels: tuple[str, ...]
    undriven: tuple[str, ...]
    is_fixed: bool

    def lines(self) -> tuple[str, ...]:
        """Lines that say what a guess does with them."""
        wheels = f"guess: wheels, locked and not taken as feet: {listed(self.wheels)}"
        undriven = f"guess: joints at the ends without drive or mass, locked: {listed(self.undriven)}"
        return (wheels,) * bool(self.wheels) + (undriven,) * bool(self.undriven)


def find_limbs(model: pin.Model) -> Limbs:
    """Limbs of a model on a fixed base, with all joints at zero.

    A joint without drive moves no mass; or it moves little, and has an effort limit of 0 or none while others
    have one. Tips at the bottom are not counted among them, as they may be feet.
    """
    data, joints, children = model.createData(), range(1, model.njoints), _children(model)
    pin.computeJointJacobians(model, data, pin.neutral(model))
    pin.computeSubtreeMasses(model, data)
    heights = np.array([place.translation[2] for place in data.oMi])
    tips = [joint for joint in joints if not children[joint]]
    low = min((heights[tip] for tip in tips), default=0.0) + LOW * np.ptp(heights)
    bottom = {tip for tip in tips if heights[tip] <= low}
    wheels = {joint for joint in bottom if _is_wheel(model, data, joint)}
    wheels = wheels if len(wheels) > 1 else set()  # one alone is a flywheel
    is_arm = _is_arm(data, children, wheels)
    undriven: set[int] = set()
    for joint in reversed(joints):
        may_be_foot = joint in bottom and not is_arm
        if not may_be_foot and undriven.issuperset(children[joint]) and _without_drive(model, data, joint):
            undriven.add(joint)
    wheel_names, names = (tuple(str(model.names[j]) for j in sorted(each)) for each in (wheels, undriven))
    return Limbs(wheels=wheel_names, undriven=names, is_fixed=is_arm or bool(wheels))


def tool_joint(model: pin.Model) -> int:
    """The last joint of the heaviest chain, before a light hand; 0 without joints."""
    data, children, joint = model.createData(), _children(model), 0
    pin.computeSubtreeMasses(model, data)
    while children[joint]:
        behind = [float(data.mass[child]) for child in children[joint]]
        if joint and len(behind) > 1 and sum(behind) <= HAND * data.mass[model.supports[joint][1]]:
            break
        joint = children[joint][int(np.argmax(behind))]
    return joint


def _children(model: pin.Model) -> list[list[int]]:
    parents = list(model.parents)
    return [[k for k in range(1, model.njoints) if parents[k] == joint] for joint in range(model.njoints)]


def _is_arm(data: pin.Data, children: list[list[int]], wheels: set[int]) -> bool:
    """Whether all joints but wheels form one chain, with at most a light hand at its end."""
    branches, chain = [child for child in children[0] if child not in wheels], list[int]()
    while len(branches) == 1:
        chain.append(branches[0])
        branches = children[branches[0]]
    return bool(chain) and sum(data.mass[each] for each in branches) <= HAND * data.mass[chain[0]]


def _is_wheel(model: pin.Model, data: pin.Data, joint: int) -> bool:
    """Whether a tip turns without limits about a level axis through its body's centre of mass."""
    kind, inertia = model.joints[joint], model.inertias[joint]
    span = model.upperPositionLimit[kind.idx_q] - model.lowerPositionLimit[kind.idx_q]
    endless = kind.nq == 2 or not 0 < span < UNLIMITED
    if kind.nv != 1 or not endless or inertia.mass <= 0:
        return False
    jacobian = np.reshape(data.J, (6, model.nv), order="F")  # of one column it is flat
    axis = jacobian[3:, kind.idx_v]  # world; zero where it slides
    off = np.linalg.norm(np.cross(axis, data.oMi[joint].rotation @ inertia.lever))
    radius = np.sqrt(np.linalg.eigvalsh(inertia.inertia)[-1] / inertia.mass)
    return bool(axis.any() and abs(axis[2]) < LEVEL and off <= CENTRED * radius)


def _without_drive(model: pin.Model, data: pin.Data, joint: int) -> bool:
    driven = (model.upperEffortLimit > 0) & (model.upperEffortLimit < UNLIMITED)
    kind, mass = model.joints[joint], data.mass[joint]
    own = driven[kind.idx_v : kind.idx_v + kind.nv]
    return bool(mass == 0 or (driven.any() and not own.any() and mass <= TINY * data.mass[0]))
