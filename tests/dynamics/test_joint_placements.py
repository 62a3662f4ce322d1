"""Placements of many configurations at once are Pinocchio's."""

import numpy as np
import pinocchio as pin
import pytest

from trajopt.dynamics.joint_placements import joint_placements

ROUNDING = 1e-12  # sums of numbers around one
AXIS = np.array([1.0, 2.0, 2.0]) / 3
KINDS = {
    "free": pin.JointModelFreeFlyer(),
    "planar": pin.JointModelPlanar(),
    "spherical": pin.JointModelSpherical(),
    "angles": pin.JointModelSphericalZYX(),
    "translation": pin.JointModelTranslation(),
    "revolute": pin.JointModelRY(),
    "skew": pin.JointModelRevoluteUnaligned(AXIS),
    "continuous": pin.JointModelRUBZ(),
    "prismatic": pin.JointModelPX(),
    "skew prismatic": pin.JointModelPrismaticUnaligned(AXIS),
    "helical": pin.JointModelHelicalUnaligned(AXIS, 0.3),
}


@pytest.mark.parametrize("kind", KINDS)
def test_placements_are_those_of_forward_kinematics(kind):
    model, random = pin.Model(), np.random.default_rng(0)
    first = model.addJoint(0, KINDS[kind], pin.SE3.Random(), "first")
    second = model.addJoint(first, KINDS[kind], pin.SE3.Random(), "second")
    model.addJoint(second, pin.JointModelRX(), pin.SE3.Random(), "third")
    steps = random.uniform(-2, 2, (5, model.nv))
    q = np.array([pin.integrate(model, pin.neutral(model), step) for step in steps])
    rotation, origin = joint_placements(model, q)
    data = model.createData()
    for row, configuration in enumerate(q):
        pin.forwardKinematics(model, data, configuration)
        for joint in range(model.njoints):
            assert rotation[joint, row] == pytest.approx(data.oMi[joint].rotation, abs=ROUNDING)
            assert origin[joint, row] == pytest.approx(data.oMi[joint].translation, abs=ROUNDING)
