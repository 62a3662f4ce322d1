"""The check of surface contacts: six rows, margins of the sole, turning."""

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest

from tests.support.synthetic_motions import Motion, sampled
from trajopt.certify.check import check
from trajopt.robot.contact import Contact
from trajopt.robot.robot import Robot

EXACT = 1e-9  # a body at rest; only rounding remains


def box_on_a_sole(offset: float) -> tuple[Robot, Motion]:
    """A box of 2 kg that rests on one sole, its centre of mass ``offset`` m before the sole's origin."""
    model = pin.Model()
    joint = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "root_joint")
    inertia = pin.Inertia(2.0, np.array([offset, 0.0, 0.3]), 0.01 * np.eye(3))
    model.appendBodyToJoint(joint, inertia, pin.SE3.Identity())
    model.addFrame(pin.Frame("sole", joint, 0, pin.SE3.Identity(), pin.FrameType.OP_FRAME))
    sole = Contact(frame="sole", kind="surface", half_length=0.1, half_width=0.05)
    robot = Robot.from_model(model, name="box", contacts=[sole])
    still, weight = np.zeros(6), 2 * 9.81
    wrench = np.array([[0.0, 0.0, weight, 0.0, -weight * offset, 0.0]])
    q = pin.neutral(model)
    return robot, Motion(
        duration=0.2,
        contacts=("sole",),
        q=lambda t: q,
        v=lambda t: still,
        a=lambda t: still,
        tau=lambda t: np.zeros(0),
        f=lambda t: wrench,
    )


@pytest.mark.parametrize(("offset", "failures"), [(0.03, ()), (0.12, ("sole_margin", "sole_margin_between"))])
def test_surface_contact_holds_force_and_moment(offset, failures):
    robot, motion = box_on_a_sole(offset)
    report = check(sampled(robot, [motion], 3, contact_sizes=[[0.1, 0.05]]))
    assert report.failures() == failures
    assert report.sole_margin == pytest.approx(min(0.1 - offset, 0.7 * 0.075, 0.05))
    assert report.base_residual < EXACT
    assert report.foot_turn == 0
    assert report.open_loop_position < EXACT
    assert report.open_loop_orientation < EXACT


def test_turning_sole_is_measured():
    robot, motion = box_on_a_sole(0.0)
    still = sampled(robot, [motion], 3)
    turned = still.q.copy()
    turned[-1, 3:7] = pin.Quaternion(pin.exp3(np.array([0.0, 0.0, 0.2]))).coeffs()
    report = check(replace(still, q=turned))
    assert report.foot_turn == pytest.approx(0.2)
    assert report.sole_margin is None
