"""Robots without meshes are replayed as skeletons, their base as the box of its inertia."""

import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from numpy.testing import assert_allclose

from tests.support.replay_pages import hopping, objects_of, placements_of, shown
from tests.support.synthetic_motions import Motion, arm_motion, sampled, with_meta
from trajopt.robot.data import robot_file
from trajopt.view.replay.robot import mesh_points, visuals_of
from trajopt_library import robots
from trajopt_library.robots.hopper import SLENDERNESS, TORSO_CENTRE, TORSO_LENGTH

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
        scene = shown(replace(bones, model=model), tmp_path)
        assert not any(path.endswith("/trunk") for path in objects_of(scene))


# Meshes that are found, and those that are not


@pytest.mark.long
@pytest.mark.parametrize("name", ["solo12", "anymal_c", "ur5", "talos"])
def test_visuals_are_those_that_pinocchio_reads(name):
    robot = robots.load(name)
    found, whole = visuals_of(robot.visual, robot.model), robot.visual.geometry(robot.model)
    assert not found.missing
    assert [entry.name for entry in found.geometry.geometryObjects] == [e.name for e in whole.geometryObjects]
    for own, other in zip(found.geometry.geometryObjects, whole.geometryObjects, strict=True):
        assert own.parentJoint == other.parentJoint
        assert own.placement == other.placement
        assert_allclose(own.meshColor, other.meshColor)
        if own.name in found.meshes:
            assert Path(own.meshPath) == Path(other.meshPath)
            assert_allclose(own.meshScale, other.meshScale)


@pytest.mark.long
@pytest.mark.parametrize("name", ["solo12", "ur5"])
def test_points_of_meshes_span_what_pinocchio_loads(name):
    robot = robots.load(name)
    for entry in robot.visual.geometry(robot.model).geometryObjects:
        points, whole = mesh_points(entry.meshPath, entry.meshScale), entry.geometry.vertices()
        for extreme in (np.min, np.max):
            assert_allclose(extreme(points, axis=0), extreme(whole, axis=0), atol=SINGLE_PRECISION)


def partly_there(tmp_path: Path, *, damaged: bool) -> Path:
    """A copy of Solo12's description in which one mesh file is missing, or holds no mesh."""
    source = robot_file("solo_description")
    copied = tmp_path / "share" / "example-robot-data" / "robots" / "solo_description"
    shutil.copytree(source, copied)
    lost = sorted((copied / "meshes").rglob("solo12/solo12_hip_fe_fl.stl"))[0]
    lost.unlink()
    if damaged:
        lost.write_text("no mesh")
    return tmp_path / "share"


@pytest.mark.parametrize("damaged", [False, True])
def test_robot_is_drawn_without_the_mesh_that_is_missing_and_one_line_names_it(tmp_path, capsys, damaged):
    share = partly_there(tmp_path, damaged=damaged)
    urdf = share / "example-robot-data/robots/solo_description/robots/solo12.urdf"
    told = with_meta(hopping(), visual={"urdf": str(urdf), "package_dirs": [str(share)]})
    page = shown(told, tmp_path)
    said = capsys.readouterr().err
    assert said.count("\n") == 1
    assert ("FL_SHOULDER" if damaged else "solo12_hip_fe_fl.stl") in said
    assert "skeleton" not in said
    drawn = [path for path in objects_of(page) if path.startswith("robot/")]
    assert len(drawn) == 17 - 1
    assert not any("FL_SHOULDER" in path for path in drawn)
