"""Placements of bodies at many configurations are Pinocchio's."""

import coal
import numpy as np
import pinocchio as pin
import pytest

from trajopt import _numeric

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
    frames = [model.addFrame(pin.Frame(f"{j}", j, pin.SE3.Random(), pin.OP_FRAME)) for j in range(1, 4)]
    bodies, ball = _numeric.Bodies(model), coal.Sphere(0.1)
    for frame in (*frames, -1):
        bodies.add(ball, frame, np.eye(3, 4), np.zeros((1, 3)), 0.1, np.zeros((0, 4)))
    found = bodies.placements(q).reshape(len(q), len(frames) + 1, 12)
    data = model.createData()
    for row, configuration in enumerate(q):
        pin.framesForwardKinematics(model, data, configuration)
        places = [*(data.oMf[frame] for frame in frames), pin.SE3.Identity()]
        for body, place in enumerate(places):
            assert found[row, body, :9] == pytest.approx(place.rotation.ravel(), abs=ROUNDING)
            assert found[row, body, 9:] == pytest.approx(place.translation, abs=ROUNDING)


def test_what_is_no_body_is_refused():
    model = pin.buildSampleModelManipulator()
    bodies, place, point, none = _numeric.Bodies(model), np.eye(3, 4), np.zeros((1, 3)), np.zeros((0, 4))
    with pytest.raises(TypeError, match="CollisionGeometry"):
        bodies.add("ball", 1, place, point, 0.1, none)
    with pytest.raises(ValueError, match="frame"):
        bodies.add(coal.Sphere(0.1), model.nframes, place, point, 0.1, none)
    with pytest.raises(ValueError, match="half-space"):
        bodies.add(None, -1, place, point, 0.0, none)
    bodies.add(coal.Sphere(0.1), 1, place, point, 0.1, none)
    for pair in ((0, 1), (-1, 0)):
        with pytest.raises(ValueError, match="pair"):
            bodies.distances(np.zeros((1, model.nq)), [pair], np.array([np.inf]))
    with pytest.raises(ValueError, match="q has"):
        bodies.distances(np.zeros((1, model.nq + 1)), [(0, 0)], np.array([np.inf]))
