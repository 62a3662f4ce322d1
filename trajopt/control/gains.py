"""Gains and weights of a tracker, in natural units."""

from dataclasses import dataclass

from trajopt.arguments import NonNegative, Positive, checked


@checked
@dataclass(frozen=True, kw_only=True)
class TrackerGains:
    """Bandwidths of feedback in 1 / sqrt(l / g), l the robot's reach, and weights of tasks in natural units.

    Args:
        body: bandwidth of the centre of mass and the base.
        foot: bandwidth of swinging feet.
        joint: bandwidth of joints.
        contact: rate at which the velocity of a contact decays.
        com_weight: weight of the centre of mass while contacts stand.
        thin_com_weight: the same on a line or a point, in plans that are not periodic.
        base_weight: weight of the base's orientation while contacts stand.
        foot_weight: weight of swinging feet.
        joint_weight: weight of joints while contacts stand.
        leg_weight: the same for joints that the pose of a foot in the air determines.
        force_weight: weight of contact forces.
        flight_joint_weight: weight of joints while no contact stands, in plans that are not periodic.
        balance: bandwidth of balancing on a line or a point.
        balance_joint_weight: weight of joints there.
        placement: offset of footholds from the plan, over the error of the capture point at touchdown.
        steady: rate at which this offset grows while the centre of mass of a gait stays off the plan.
    """

    body: NonNegative = 8.0
    foot: NonNegative = 15.0
    joint: NonNegative = 20.0
    contact: NonNegative = 20.0
    com_weight: NonNegative = 10.0
    thin_com_weight: NonNegative = 1.0
    base_weight: NonNegative = 1.0
    foot_weight: NonNegative = 1.0
    joint_weight: NonNegative = 1e-2
    leg_weight: NonNegative = 1e-4
    force_weight: NonNegative = 1e-3
    flight_joint_weight: Positive = 1.0
    balance: NonNegative = 10.0
    balance_joint_weight: NonNegative = 1e-4
    placement: NonNegative = 1.3
    steady: NonNegative = 0.1
