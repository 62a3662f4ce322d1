"""The cart-pole of Kelly's tutorial: a motor pushes the cart, the pole on it swings freely.

M. Kelly, "An introduction to trajectory optimization: how to do your own direct collocation", SIAM Review
59(4), 2017, sec. 6 and table 3.
"""

import numpy as np
import pinocchio as pin

from trajopt.robot import Robot

KIND = "pendulum"

CART_MASS, POLE_MASS = 1.0, 0.3  # kg
POLE_LENGTH = 0.5  # m, to the pole's point mass
CART_SIDES = (0.3, 0.1, 0.1)  # m, irrelevant for any motion
FORCE, TRACK = 20.0, 2.0  # N, and m to either side


def build() -> Robot:
    """Return the cart with its pole hanging: q is the cart's place along x, m, and the pole's angle, rad.

    The angle is zero where the pole hangs, and turns the mass towards positive x as in Kelly's figure.
    """
    model = pin.Model()
    model.name = "cart_pole"
    track = np.array([TRACK])
    unlimited = np.array([np.inf])
    cart = model.addJoint(
        0, pin.JointModelPX(), pin.SE3.Identity(), "slide", np.array([FORCE]), unlimited, -track, track
    )
    model.addJointFrame(cart)
    model.appendBodyToJoint(cart, pin.Inertia.FromBox(CART_MASS, *CART_SIDES), pin.SE3.Identity())
    model.addBodyFrame("cart", cart, pin.SE3.Identity(), -1)
    # A positive turn about -y moves a hanging body towards positive x.
    axis = pin.JointModelRevoluteUnaligned(0.0, -1.0, 0.0)
    pole = model.addJoint(cart, axis, pin.SE3.Identity(), "swing")
    model.addJointFrame(pole)
    tip = pin.SE3(np.eye(3), np.array([0.0, 0.0, -POLE_LENGTH]))
    model.appendBodyToJoint(pole, pin.Inertia(POLE_MASS, np.zeros(3), np.zeros((3, 3))), tip)
    model.addBodyFrame("pole", pole, pin.SE3.Identity(), -1)
    model.addFrame(pin.Frame("tip", pole, 0, tip, pin.FrameType.OP_FRAME))
    return Robot.from_model(model, passive=["swing"])
