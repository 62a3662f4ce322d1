"""Symbolic dynamics in contact against numeric Pinocchio."""

import casadi as ca
import numpy as np
import pinocchio as pin
import pytest
from numpy.testing import assert_allclose

from trajopt.dynamics import contact_forward_dynamics, contact_inverse_dynamics
from trajopt.errors import InputError
from trajopt_library import robots

# Rows of a robot of 90 kg: 1e3 N and 1e3 rad/s^2.
AGREES = {"rtol": 1e-8, "atol": 1e-7}
HELD = {"solo12": {"FL_FOOT": 3, "FR_FOOT": 3, "HR_FOOT": 3}, "talos": {"left_sole_link": 6}}


@pytest.mark.parametrize("name", HELD)
def test_symbolic_dynamics_in_contact_are_pinocchios(name):
    robot, held = robots.load(name), HELD[name]
    model, random = robot.model, np.random.default_rng(0)
    v, tau = 0.3 * random.normal(size=(2, model.nv))
    tau[:6] = 0.0
    a, f = contact_forward_dynamics(model, held)(robot.reference, v, tau)
    data = model.createData()
    mass, bias = pin.crba(model, data, robot.reference), pin.nle(model, data, robot.reference, v)
    pin.computeJointJacobians(model, data, robot.reference)
    pin.forwardKinematics(model, data, robot.reference, v, np.zeros(model.nv))
    rows, drift = [], []
    for frame, size in held.items():
        number, axes = model.getFrameId(frame), pin.LOCAL_WORLD_ALIGNED
        pin.updateFramePlacement(model, data, number)
        rows.append(pin.getFrameJacobian(model, data, number, axes)[:size])
        drift.append(pin.getFrameClassicalAcceleration(model, data, number, axes).vector[:size])
    jacobian, drift = np.vstack(rows), np.concatenate(drift)
    a, f = np.array(a).ravel(), np.array(f).ravel()
    assert_allclose(mass @ a + bias, tau + jacobian.T @ f, **AGREES)
    assert_allclose(jacobian @ a + drift, 0.0, atol=1e-9)
    torque, wrench = contact_inverse_dynamics(model, held, robot.actuated_rows.tolist())(
        robot.reference, v, a
    )
    expected = np.linalg.pinv(np.hstack([jacobian.T, np.eye(model.nv)[:, 6:]])) @ (mass @ a + bias)
    assert_allclose(np.array(wrench).ravel(), expected[: len(jacobian)], **AGREES)
    assert_allclose(np.array(torque).ravel(), expected[len(jacobian) :], **AGREES)


def test_it_can_be_differentiated_and_names_what_is_unknown():
    robot = robots.load("solo12")
    function = contact_forward_dynamics(robot.model, {"FL_FOOT": 3})
    q, v, tau = (ca.MX.sym(name, function.size1_in(name)) for name in ("q", "v", "tau"))
    slope = ca.Function("slope", [q, v, tau], [ca.jacobian(function(q, v, tau)[0], tau)])
    still = np.zeros(robot.nv)
    assert np.isfinite(np.array(slope(robot.reference, still, still))).all()
    with pytest.raises(InputError, match="nowhere"):
        contact_forward_dynamics(robot.model, {"nowhere": 3})
