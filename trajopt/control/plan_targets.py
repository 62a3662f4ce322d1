"""Targets of a plan for contacts, centre of mass and base at every tick, in the world."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from trajopt.control.reference import ReferenceTrajectory
from trajopt.dynamics.base_joint import BASE_JOINT
from trajopt.motion.touched import TouchedSurfaces, touched_surfaces
from trajopt.terrain.surface import UP, Surface

# Largest deviation of a level surface's normal from the vertical: feet may land elsewhere on it.
LEVEL = 1e-3


@dataclass(frozen=True, kw_only=True)
class PlanTargets:
    """Targets at n ticks; velocities and accelerations are of the frames' origins, world axes.

    ``com`` (n, 3, 3) is position, velocity and acceleration of the centre of mass, in m and s, ``momentum``
    (n, 3) the angular momentum about it, N m s. Contact frames have ``position`` (n, nc, 3), ``rotation``
    (n, nc, 3, 3), ``velocity`` and ``acceleration`` (n, nc, 6); the base joint's frame has ``base_rotation``
    (n, 3, 3), ``base_velocity`` and ``base_acceleration`` (n, 6). ``surfaces`` are under the contacts.
    ``base`` is the index of the base joint's frame, 0 for a fixed base.
    ``level`` (n, nc) tells whether a foot may land beside its foothold: on level ground without edges.
    ``next_stance``, ``last_stance`` (n, nc) are ticks until a contact in the air stands and since it stood.
    """

    com: np.ndarray
    momentum: np.ndarray
    position: np.ndarray
    rotation: np.ndarray
    velocity: np.ndarray
    acceleration: np.ndarray
    base_rotation: np.ndarray
    base_velocity: np.ndarray
    base_acceleration: np.ndarray
    base: int
    surfaces: TouchedSurfaces
    level: np.ndarray
    next_stance: np.ndarray
    last_stance: np.ndarray


def tracking_models(reference: ReferenceTrajectory) -> list[pin.Model]:
    """The plan's model in each phase, with all payloads and the frame of a moving base's joint.

    Models that do not come from a description may lack that frame.
    """
    joint, models = BASE_JOINT[reference.base], []
    for phase in range(len(reference.description.phase_names)):
        model = reference.carrying_model(phase)
        if joint and not model.existFrame(model.names[joint], pin.FrameType.JOINT):
            model = pin.Model(model)
            model.addJointFrame(joint)
        models.append(model)
    return models


def plan_targets(reference: ReferenceTrajectory, models: Sequence[pin.Model]) -> PlanTargets:
    """Targets of a reference by forward kinematics; ``models`` as from `tracking_models`."""
    frames, joint = reference.contact_ids, BASE_JOINT[reference.base]
    n, nc, axes = len(reference.t), len(frames), pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
    base = int(models[0].getFrameId(models[0].names[joint], pin.FrameType.JOINT)) if joint else 0
    com, momentum = np.zeros((n, 3, 3)), np.zeros((n, 3))
    position, rotation = np.zeros((n, nc, 3)), np.zeros((n, nc, 3, 3))
    velocity, acceleration = np.zeros((n, nc, 6)), np.zeros((n, nc, 6))
    turned, rate, change = np.tile(np.eye(3), (n, 1, 1)), np.zeros((n, 6)), np.zeros((n, 6))
    data = [model.createData() for model in models]
    for k in range(n):
        model, state_data = models[reference.source[k]], data[reference.source[k]]
        state = (reference.q[k], reference.v[k], reference.a[k])
        pin.forwardKinematics(model, state_data, *state)
        pin.updateFramePlacements(model, state_data)
        pin.centerOfMass(model, state_data, *state)
        momentum[k] = pin.computeCentroidalMomentum(model, state_data).angular
        com[k] = state_data.com[0], state_data.vcom[0], state_data.acom[0]
        for i, frame in enumerate(frames):
            position[k, i], rotation[k, i] = state_data.oMf[frame].translation, state_data.oMf[frame].rotation
            velocity[k, i] = pin.getFrameVelocity(model, state_data, frame, axes).vector
            acceleration[k, i] = pin.getFrameClassicalAcceleration(model, state_data, frame, axes).vector
        if joint:
            turned[k] = state_data.oMf[base].rotation
            rate[k] = pin.getFrameVelocity(model, state_data, base, axes).vector
            change[k] = pin.getFrameClassicalAcceleration(model, state_data, base, axes).vector
    about = reference.description
    next_stance, last_stance = _until(reference.active), _until(reference.active[::-1])[::-1]
    surfaces = touched_surfaces(about, position, reference.source)
    smooth = not about.surfaces and isinstance(about.ground, Surface)
    return PlanTargets(
        com=com,
        momentum=momentum,
        position=position,
        rotation=rotation,
        velocity=velocity,
        acceleration=acceleration,
        base_rotation=turned,
        base_velocity=rate,
        base_acceleration=change,
        base=base,
        surfaces=surfaces,
        level=(np.abs(surfaces.normal - UP).max(axis=2) < LEVEL) & smooth,
        next_stance=next_stance,
        last_stance=last_stance,
    )


def _until(active: np.ndarray) -> np.ndarray:
    """Number of rows (n, nc) until the next true entry: zero where true, n if there is none."""
    n, ticks = len(active), np.zeros(active.shape, dtype=int)
    ahead = np.full(active.shape[1], n)
    for k in range(n - 1, -1, -1):
        ahead = np.where(active[k], 0, np.minimum(ahead + 1, n))
        ticks[k] = ahead
    return ticks
