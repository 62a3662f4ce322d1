"""Targets of a plan for contacts, centre of mass and base at every tick, in the world."""

from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from trajopt.control.reference import ReferenceTrajectory
from trajopt.dynamics.base_joint import BASE_JOINT, base_of
from trajopt.motion.carried import carrying_model
from trajopt.motion.solution import Solution
from trajopt.motion.touched import TouchedSurfaces, touched_surfaces


@dataclass(frozen=True, kw_only=True)
class PlanTargets:
    """Targets at n ticks; velocities and accelerations are of the frames' origins, world axes.

    ``com`` (n, 3, 3) is position, velocity and acceleration of the centre of mass, in m and s, ``momentum``
    (n, 3) the angular momentum about it, N m s. Contact frames have ``position`` (n, nc, 3), ``rotation``
    (n, nc, 3, 3), ``velocity`` and ``acceleration`` (n, nc, 6); the base joint's frame has ``base_rotation``
    (n, 3, 3), ``base_velocity`` and ``base_acceleration`` (n, 6). ``surfaces`` are under the contacts.
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
    surfaces: TouchedSurfaces
    next_stance: np.ndarray
    last_stance: np.ndarray


def base_frame(model: pin.Model) -> int:
    """Index of the frame of a moving base's joint in the model."""
    name = model.names[BASE_JOINT[base_of(model)]]
    return int(model.getFrameId(name, pin.FrameType.JOINT))


def tracking_model(plan: Solution, phase: int) -> pin.Model:
    """The plan's model with all payloads of a phase and the frame of a moving base's joint.

    Models that do not come from a description may lack that frame.
    """
    model, kind = carrying_model(plan, phase), base_of(plan.model)
    if kind != "fixed" and base_frame(model) >= model.nframes:
        model = pin.Model(model)
        model.addJointFrame(BASE_JOINT[kind])
    return model


def plan_targets(plan: Solution, reference: ReferenceTrajectory) -> PlanTargets:
    """Targets of a reference by forward kinematics."""
    models = [tracking_model(plan, phase) for phase in range(len(plan.phases))]
    frames = [plan.model.getFrameId(name) for name in plan.contact_frames]
    n, nc, axes = len(reference.t), len(frames), pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
    moving = base_of(plan.model) != "fixed"
    base = base_frame(models[0]) if moving else 0
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
        if moving:
            turned[k] = state_data.oMf[base].rotation
            rate[k] = pin.getFrameVelocity(model, state_data, base, axes).vector
            change[k] = pin.getFrameClassicalAcceleration(model, state_data, base, axes).vector
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
        surfaces=touched_surfaces(plan, position, reference.source),
        next_stance=_until(reference.active),
        last_stance=_until(reference.active[::-1])[::-1],
    )


def _until(active: np.ndarray) -> np.ndarray:
    """Number of rows (n, nc) until the next true entry: zero where true, n if there is none."""
    n, ticks = len(active), np.zeros(active.shape, dtype=int)
    ahead = np.full(active.shape[1], n)
    for k in range(n - 1, -1, -1):
        ahead = np.where(active[k], 0, np.minimum(ahead + 1, n))
        ticks[k] = ahead
    return ticks
