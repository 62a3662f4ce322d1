"""Robots without meshes are replayed as skeletons, their base as the box of its inertia."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pinocchio as pin
from numpy.testing import assert_allclose
from replay_pages import hopping, objects_of, placements_of, shown, with_meta
from synthetic import Motion, arm_motion, sampled

import robots
from robots.hopper import SLENDERNESS, TORSO_CENTRE, TORSO_LENGTH

INTERVALS, DURATION = 3, 0.2  # s
SINGLE_PRECISION = 2e-6  # of lengths around one


def test_trunk_of_a_skeleton_is_the_box_of_its_inertia(tmp_path):
    robot = robots.load("hopper")
    data, still = robot.model.createData(), np.zeros(robot.nv)
    pin.framesForwardKinematics(robot.model, data, robot.reference)
    stance = Motion(
        duration=DURATION,
        contacts=("foot",),
        q=lambda t: robot.reference,
        v=lambda t: still,
        a=lambda t: still,
        tau=lambda t: still[3:],
        f=lambda t: np.array([[0.0, 0, 98.1, 0, 0, 0]]),
    )
    scene = shown(sampled(robot, [stance], INTERVALS), tmp_path)
    path = next(path for path in objects_of(scene) if path.endswith("/trunk"))
    box, place = objects_of(scene)[path]["geometries"][0], placements_of(scene)[path]
    sides = np.array([box["width"], box["height"], box["depth"]])
    expected = np.array([SLENDERNESS, SLENDERNESS, 1.0]) * TORSO_LENGTH
    assert_allclose(np.sort(sides), expected, rtol=SINGLE_PRECISION)
    world = data.oMi[1].homogeneous @ place
    upright = np.array([0.0, 0.0, 1.0])
    assert_allclose(np.abs(world[:3, np.argmax(sides)]), upright, atol=SINGLE_PRECISION)
    hip = data.oMi[1].translation
    assert_allclose(world[:3, 3], hip + TORSO_CENTRE * TORSO_LENGTH * upright, atol=SINGLE_PRECISION)


def test_skeleton_on_a_fixed_base_has_no_trunk(tmp_path):
    robot = robots.load("ur5")
    scene = shown(sampled(robot, [arm_motion(robot)], INTERVALS), tmp_path)
    assert not any(path.endswith("/trunk") for path in objects_of(scene))
    assert any("/rod" in path for path in objects_of(scene))


def test_base_without_mass_or_extent_has_no_trunk(tmp_path):
    bones = with_meta(hopping(), visual=None)
    model = bones.model.copy()
    for inertia in (pin.Inertia.Zero(), pin.Inertia(1.0, np.zeros(3), np.zeros((3, 3)))):
        model.inertias[1] = inertia
        scene = shown(replace(bones, model_text=model.saveToString()), tmp_path)
        assert not any(path.endswith("/trunk") for path in objects_of(scene))
