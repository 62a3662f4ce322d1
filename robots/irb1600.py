"""ABB IRB 1600-8/1.45, a six-joint arm for 8 kg, its links hollow metal beams, its motors behind gears."""

import math
from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from trajopt.errors import InputError
from trajopt.robot import Beam, Drive, Robot

KIND = "arm"
# Flange frame in ABB's convention: z points out of the flange, and x down at zero angles.
TOOL = "tool0"
AXES = {"x": pin.JointModelRX, "y": pin.JointModelRY, "z": pin.JointModelRZ}


@dataclass(frozen=True, kw_only=True)
class _Joint:
    """Axis and place in the previous frame at zero (m); range and largest speed (degrees, degrees/s)."""

    axis: str
    place: tuple[float, float, float]
    range: tuple[float, float]
    speed: float


# From abb_irb1600_support of ros-industrial/abb (urdf/irb1600_8_145_macro.xacro and its parameters for
# closed-form kinematics), which follows ABB's product specification 3HAC023604-001 Rev AQ. At zero the upper
# arm is upright and the forearm points forward; there is no offset at elbow or shoulder.
JOINTS = (
    _Joint(axis="z", place=(0.0, 0.0, 0.0), range=(-180.0, 180.0), speed=180.0),
    _Joint(axis="y", place=(0.150, 0.0, 0.4865), range=(-90.0, 120.0), speed=180.0),
    _Joint(axis="y", place=(0.0, 0.0, 0.700), range=(-245.0, 65.0), speed=200.0),
    _Joint(axis="x", place=(0.300, 0.0, 0.0), range=(-200.0, 200.0), speed=400.0),
    _Joint(axis="y", place=(0.300, 0.0, 0.0), range=(-115.0, 115.0), speed=400.0),
    _Joint(axis="x", place=(0.065, 0.0, 0.0), range=(-400.0, 400.0), speed=460.0),
)


@dataclass(frozen=True, kw_only=True)
class _Link:
    """A beam from ``start`` to ``end`` in its joint's frame; outer width and height, wall thickness; m."""

    start: tuple[float, float, float]
    end: tuple[float, float, float]
    section: tuple[float, float]
    wall: float

    def inertia(self, material: str) -> pin.Inertia:
        length = math.dist(self.start, self.end)
        width, height = self.section
        beam = Beam(length=length, width=width, height=height, wall=self.wall, density=material)
        return beam.between(self.start, self.end)


# The drawing shows outlines, not castings: sections are roughly those of the drawing, walls those of a welded
# arm. The fourth axis turns within the forearm, so links 3 and 4 share its length.
LINKS = (
    _Link(start=(0.0, 0.0, 0.20), end=(0.150, 0.0, 0.4865), section=(0.26, 0.26), wall=0.010),
    _Link(start=(0.0, 0.0, 0.0), end=(0.0, 0.0, 0.700), section=(0.16, 0.20), wall=0.006),
    _Link(start=(0.0, 0.0, 0.0), end=(0.300, 0.0, 0.0), section=(0.14, 0.16), wall=0.006),
    _Link(start=(0.0, 0.0, 0.0), end=(0.300, 0.0, 0.0), section=(0.12, 0.12), wall=0.005),
    _Link(start=(-0.035, 0.0, 0.0), end=(0.045, 0.0, 0.0), section=(0.09, 0.09), wall=0.005),
    _Link(start=(-0.020, 0.0, 0.0), end=(0.0, 0.0, 0.0), section=(0.08, 0.08), wall=0.020),
)

GEAR_RATIOS = (-100.0, 100.0, 100.0, -60.0, -60.0, 40.0)
# The lecture's table reads "[6 1050.60 .6 0.5]": four numbers instead of six. "1050.60" may be read as 10, 5
# and 0.60 (1000 and 500 N m at the joints) or as 10, 50 and .60 (5000 N m at the elbow, ten times what holds
# the stretched forearm with its load, behind a weaker shoulder). The first reading is used.
MOTOR_TORQUE_LIMITS = (6.0, 10.0, 5.0, 0.60, 0.6, 0.5)  # N m, motor side

# The wrist is bent by 30 degrees, because the fourth and sixth axes are aligned at zero.
REFERENCE = (0.0, 0.0, 0.0, 0.0, math.radians(30.0), 0.0)


def build(*, payload: float = 0.0, motor_inertia: float = 0.75, material: str = "steel") -> Robot:
    """Return the arm with a fixed base and a drive on each joint.

    payload: mass of a solid steel cube on the flange, kg; the robot is rated for 8.
    motor_inertia: reflected rotor inertia n^2 I_r over the link's inertia, here that of everything behind the
        joint about its axis, in the reference posture and without payload (what the motor was sized for); the
        lecture says 0.5 to 1.
    material: of the links, a name of `trajopt.robot.actuators.beams.DENSITY`.

    Raises `InputError` for a payload or a share below zero, or an unknown material.
    """
    for name, value in (("payload", payload), ("motor_inertia", motor_inertia)):
        if not (math.isfinite(value) and value >= 0):
            raise InputError(f"{name} of the IRB 1600 is {value:g}", "allowed: finite and >= 0")
    model = _model(material)
    inertia = motor_inertia * np.diag(pin.crba(model, model.createData(), np.array(REFERENCE)))
    if payload > 0:
        model.appendBodyToJoint(model.njoints - 1, _cube(payload), pin.SE3.Identity())
    drives = [
        Drive(gear_ratio=ratio, rotor_inertia=float(share) / ratio**2, torque_limit=limit)
        for ratio, share, limit in zip(GEAR_RATIOS, inertia, MOTOR_TORQUE_LIMITS, strict=True)
    ]
    robot = Robot.from_model(model, name="irb1600", base="fixed", reference=np.array(REFERENCE))
    return robot.with_drives(drives)


def _model(material: str) -> pin.Model:
    model, parent = pin.Model(), 0
    model.name = "irb1600"
    for number, (joint, link) in enumerate(zip(JOINTS, LINKS, strict=True), start=1):
        lower, upper = (np.array([math.radians(angle)]) for angle in joint.range)
        speed = np.array([math.radians(joint.speed)])
        place = pin.SE3(np.eye(3), np.array(joint.place))
        parent = model.addJoint(
            parent, AXES[joint.axis](), place, f"joint_{number}", np.array([np.inf]), speed, lower, upper
        )
        model.addJointFrame(parent)
        model.appendBodyToJoint(parent, link.inertia(material), pin.SE3.Identity())
        model.addBodyFrame(f"link_{number}", parent, pin.SE3.Identity(), -1)
    flange = pin.SE3(pin.rpy.rpyToMatrix(0.0, math.pi / 2, 0.0), np.zeros(3))
    model.addFrame(pin.Frame(TOOL, parent, 0, flange, pin.FrameType.OP_FRAME))
    return model


def _cube(mass: float) -> pin.Inertia:
    """Return the inertia of a solid steel cube with one face on the flange, in the last joint's frame."""
    side = (mass / Beam(length=1.0, width=1.0, height=1.0).mass) ** (1 / 3)
    cube = Beam(length=side, width=side, height=side)
    return cube.spatial_inertia(pin.SE3(np.eye(3), np.array([side / 2, 0.0, 0.0])))
