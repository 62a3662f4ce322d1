"""Robots to drive that the library does not ship: walkers on any number of legs, a quadruped on wheels."""

from collections.abc import Sequence

import numpy as np
import pinocchio as pin

from trajopt.robot import Contact, Robot
from trajopt_library import robots

# Lengths of coxa, femur and tibia, m, and masses, kg, about those of a PhantomX hexapod, thorax first.
LENGTHS, MASSES = (0.052, 0.066, 0.133), (1.0, 0.04, 0.13, 0.05)
# Stall torque, N m, and rate without load, rad/s, of its servos (Dynamixel AX-18A); range of its joints, rad.
TORQUE, RATE, RANGE = 1.8, 10.0, 1.7
# Half height and radius of the thorax and radius of a limb, m, for inertias; radius of a foot, m.
HALF_HEIGHT, THORAX, LIMB, FOOT = 0.03, 0.1, 0.015, 0.01
# Yaw of the coxa and pitch of femur and tibia in the reference, rad.
BENT = (0.0, -0.3, 1.6)
# Hips of the hexapod: forward, to the left, m, and direction of the leg, rad.
HEXAPOD = tuple(
    (x, side * y, side * angle)
    for x, y, angle in ((0.12, 0.06, np.pi / 4), (0.0, 0.1, np.pi / 2), (-0.12, 0.06, 3 * np.pi / 4))
    for side in (1, -1)
)
# Radius and width of the wheels of the quadruped, m, mass, kg, torque, N m, and rate, rad/s.
WHEEL, WIDTH, WHEEL_MASS, WHEEL_TORQUE, WHEEL_RATE = 0.0875, 0.05, 0.8, 12.0, 60.0


def around(count: int) -> tuple[tuple[float, float, float], ...]:
    """Hips of a round walker with ``count`` legs; one points forward if their number is odd."""
    begin = 0.0 if count % 2 else np.pi / count
    angles = begin + 2 * np.pi * np.arange(count) / count
    return tuple((THORAX * np.cos(angle), THORAX * np.sin(angle), angle) for angle in angles.tolist())


def walker(hips: Sequence[tuple[float, float, float]] = HEXAPOD) -> Robot:
    """A robot with three joints a leg and balls as feet, named leg_0, leg_1, ... in the order of the hips."""
    model = pin.Model()
    base = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "root")
    thorax = pin.Inertia.FromCylinder(MASSES[0], THORAX, 2 * HALF_HEIGHT)
    model.appendBodyToJoint(base, thorax, pin.SE3.Identity())
    reference = {}
    for number, (x, y, angle) in enumerate(hips):
        place = pin.SE3(pin.utils.rotate("z", angle), np.array([x, y, 0.0]))
        parent = base
        kinds = (pin.JointModelRZ(), pin.JointModelRY(), pin.JointModelRY())
        for kind, part, length, mass, bent in zip(
            kinds, ("coxa", "femur", "tibia"), LENGTHS, MASSES[1:], BENT, strict=True
        ):
            name = f"{part}_{number}"
            most = [np.array([limit]) for limit in (TORQUE, RATE, -RANGE, RANGE)]
            parent = model.addJoint(parent, kind, place, name, *most)
            limb = pin.Inertia.FromCylinder(mass, LIMB, length)
            along = pin.SE3(pin.utils.rotate("y", np.pi / 2), np.array([length / 2, 0.0, 0.0]))
            model.appendBodyToJoint(parent, limb, along)
            place, reference[name] = pin.SE3(np.eye(3), np.array([length, 0.0, 0.0])), bent
        model.addFrame(pin.Frame(f"leg_{number}", parent, place, pin.FrameType.OP_FRAME))
    contacts = [Contact(frame=f"leg_{number}", radius=FOOT) for number in range(len(hips))]
    return Robot.from_model(
        model, name=f"walker-{len(hips)}", base="freeflyer", contacts=contacts, reference=reference
    )


def wheeled_quadruped(*, continuous: bool = True) -> Robot:
    """Go2 with a driven wheel instead of each foot; continuous joints have a cosine and a sine in q."""
    go2 = robots.load("go2")
    model, names = pin.Model(go2.model), list(go2.model.names)[2:]
    reference = dict(zip(names, go2.reference[7:].tolist(), strict=True))
    limits = [np.array([limit]) for limit in (WHEEL_TORQUE, WHEEL_RATE)]
    angle = (np.full(2, -1.01), np.full(2, 1.01)) if continuous else (np.full(1, -1e30), np.full(1, 1e30))
    for contact in go2.contacts:
        frame = model.frames[model.getFrameId(contact.frame)]
        kind = pin.JointModelRUBY() if continuous else pin.JointModelRY()
        name = f"{contact.name}_wheel"
        joint = model.addJoint(frame.parentJoint, kind, frame.placement, name, *limits, *angle)
        wheel = pin.Inertia.FromCylinder(WHEEL_MASS, WHEEL, WIDTH)
        model.appendBodyToJoint(joint, wheel, pin.SE3(pin.utils.rotate("x", np.pi / 2), np.zeros(3)))
        model.addFrame(pin.Frame(name, joint, pin.SE3.Identity(), pin.FrameType.OP_FRAME))
        reference[name] = 0.0
    contacts = [Contact(frame=f"{c.name}_wheel", radius=WHEEL, rolling=True) for c in go2.contacts]
    return Robot.from_model(
        model, name="go2-wheels", base="freeflyer", contacts=contacts, reference=reference
    )
