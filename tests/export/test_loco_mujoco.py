"""LocoMuJoCo's trajectories, read as its Trajectory.load does: it refuses any key that it does not know."""

from pathlib import Path

import mujoco
import numpy as np
import pinocchio as pin
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from tests.support.exported_plans import ROUNDING, place_of, plan_to_export, rotation_of, write_own_mjcf
from tests.support.refusals import assert_refused_in_one_line
from trajopt.export.writing import export_motion

pytestmark = pytest.mark.long

RATE = 40
# The fields of TrajectoryInfo, TrajectoryModel and TrajectoryData; the loader refuses any other key.
INFO = {"joint_names", "frequency", "body_names", "site_names", "metadata"}
OF_BODIES = {"rootid", "weldid", "mocapid", "pos", "quat", "ipos", "iquat"}
MODEL = {"njnt", "jnt_type", "nbody", "nsite", "site_bodyid", "site_pos", "site_quat"}
MODEL |= {f"body_{field}" for field in OF_BODIES}
DATA = {"qpos", "qvel", "xpos", "xquat", "cvel", "subtree_com", "site_xpos", "site_xmat", "split_points"}


class LoadedTrajectory:
    """What the loader makes of a file: info as Python values, model and data as arrays, places of joints."""

    def __init__(self, path: Path) -> None:
        with np.load(path) as archive:
            assert set(archive) <= INFO | MODEL | DATA
            self.info = {key: archive[key].tolist() for key in INFO & set(archive)}
            self.model = {key: archive[key] for key in MODEL}
            self.data = {key: archive[key] for key in DATA}
        self.of_qpos: dict[str, slice] = {}
        self.of_qvel: dict[str, slice] = {}
        place = row = 0
        for name, kind in zip(self.info["joint_names"], self.model["jnt_type"], strict=True):
            free = kind == mujoco.mjtJoint.mjJNT_FREE
            assert free or kind == mujoco.mjtJoint.mjJNT_HINGE or kind == mujoco.mjtJoint.mjJNT_SLIDE
            self.of_qpos[name] = slice(place, place + (7 if free else 1))
            self.of_qvel[name] = slice(row, row + (6 if free else 1))
            place, row = self.of_qpos[name].stop, self.of_qvel[name].stop
        assert self.data["qpos"].shape[1] == place
        assert self.data["qvel"].shape[1] == row


@pytest.mark.parametrize("kind", ["turning trot", "mirrored walk", "an arm", "an impact", "planar hops"])
def test_fields_are_those_of_the_model_and_of_its_kinematics(kind: str, tmp_path: Path) -> None:
    """By MuJoCo's whole forward pass, that the loader's own extension of trajectories makes."""
    plan = plan_to_export(kind)
    read = LoadedTrajectory(export_motion(plan, "loco-mujoco", tmp_path / "a.npz", RATE))
    model = mujoco.MjModel.from_xml_path(str(write_own_mjcf(plan, tmp_path / "robot.xml")))
    data = mujoco.MjData(model)
    assert read.info["frequency"] == RATE
    assert read.info["body_names"] == [model.body(i).name for i in range(model.nbody)]
    assert read.info["joint_names"] == [model.joint(i).name for i in range(model.njnt)]
    assert read.info["site_names"] == [model.site(i).name for i in range(model.nsite)]
    for key in MODEL:
        assert_array_equal(read.model[key], getattr(model, key))
    for row in range(0, len(read.data["qpos"]), 6):
        data.qpos, data.qvel = read.data["qpos"][row], read.data["qvel"][row]
        mujoco.mj_forward(model, data)
        for key in DATA - {"qpos", "qvel", "xquat", "split_points"}:
            assert_allclose(read.data[key][row], getattr(data, key), atol=ROUNDING)
        same = np.abs((read.data["xquat"][row] * data.xquat).sum(axis=-1))
        assert_allclose(same, 1.0, atol=ROUNDING)
    assert_array_equal(read.data["split_points"], [0, len(read.data["qpos"])])


@pytest.mark.parametrize("kind", ["turning trot", "mirrored walk"])
def test_values_are_the_plans_by_numeric_pinocchio(kind: str, tmp_path: Path) -> None:
    plan, pinocchio = plan_to_export(kind), plan_to_export(kind).model
    read = LoadedTrajectory(export_motion(plan, "loco-mujoco", tmp_path / "a.npz", RATE))
    data = pinocchio.createData()
    free = read.info["joint_names"][0]
    for row in range(0, int(plan.t[-1] * RATE), 5):
        own = plan.sample(times=[row / RATE])
        base = place_of(pinocchio, read.info["body_names"][1], own.q[0], own.v[0])
        qpos, qvel = read.data["qpos"][row], read.data["qvel"][row]
        assert_allclose(qpos[read.of_qpos[free]][:3], base.pose.translation, atol=ROUNDING)
        assert_allclose(rotation_of(qpos[read.of_qpos[free]][3:]), base.pose.rotation, atol=ROUNDING)
        assert_allclose(qvel[read.of_qvel[free]][:3], base.linear, atol=ROUNDING)
        assert_allclose(qvel[read.of_qvel[free]][3:], base.pose.rotation.T @ base.angular, atol=ROUNDING)
        for name in read.info["joint_names"][1:]:
            assert qpos[read.of_qpos[name]] == own.q[0, own.position_names.index(name)]
            assert qvel[read.of_qvel[name]] == own.v[0, own.velocity_names.index(name)]
        com = pin.centerOfMass(pinocchio, data, own.q[0]).copy()
        for i, name in list(enumerate(read.info["body_names"]))[1:]:
            place = place_of(pinocchio, name, own.q[0], own.v[0])
            assert_allclose(read.data["xpos"][row, i], place.pose.translation, atol=ROUNDING)
            at_com = place.linear + np.cross(place.angular, com - place.pose.translation)
            expected = np.concatenate([place.angular, at_com])
            assert_allclose(read.data["cvel"][row, i], expected, atol=1e-7)
        assert_allclose(read.data["subtree_com"][row, 1], com, atol=1e-7)
        for i, name in enumerate(read.info["site_names"]):
            foot = place_of(pinocchio, name, own.q[0], own.v[0])
            assert_allclose(read.data["site_xpos"][row, i], foot.pose.translation, atol=ROUNDING)


def test_several_motions_lie_one_after_the_other(tmp_path: Path) -> None:
    plan = plan_to_export("turning trot")
    read = LoadedTrajectory(export_motion([plan, plan], "loco-mujoco", tmp_path / "a.npz", RATE, 2))
    one = LoadedTrajectory(export_motion(plan, "loco-mujoco", tmp_path / "b.npz", RATE, 2))
    frames = len(one.data["qpos"])
    assert_array_equal(read.data["split_points"], [0, frames, 2 * frames])
    for key in DATA - {"split_points"}:
        assert_array_equal(read.data[key], np.concatenate([one.data[key]] * 2))


def test_motions_of_several_robots_are_refused_in_one_line(tmp_path: Path) -> None:
    plans = [plan_to_export("turning trot"), plan_to_export("an arm")]
    words = "motions of 2 robots: solo12, ur5; allowed: of one"
    assert_refused_in_one_line(lambda: export_motion(plans, "loco-mujoco", tmp_path / "a.npz"), words)
    assert list(tmp_path.iterdir()) == []
