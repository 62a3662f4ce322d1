"""Motions to play back in MuJoCo: the model begins where the plan does, its torques are the plan's."""

import csv
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pinocchio as pin
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from tests.support.exported_plans import ROUNDING, place_of, plan_to_export, rotation_of
from tests.support.refusals import assert_refused_in_one_line
from tests.support.sampled_problems import solution_of_kind
from trajopt.export.writing import export_motion
from trajopt.motion.solution import Solution

pytestmark = pytest.mark.long

KINDS = ["turning trot", "mirrored walk", "planar hops", "an arm"]
FILES = ["controls.csv", "controls.npz", "model.xml"]
# Residual of the equations of motion over the weight: a solver's tolerance, forces in single precision.
SOLVED = 1e-5
# Without feedback for so long, s, a motion leaves the plan by less than this, rad and m.
SHORT, OPEN_LOOP = 0.03, 0.01
# With the feedback of the file all along: contacts of MuJoCo give way.
FED_BACK = 0.05
# What is larger than this, m, is seen.
SEEN = 5e-3


class Playback:
    """A folder as a user opens it: the model, and arrays by name."""

    def __init__(self, folder: Path) -> None:
        assert sorted(path.name for path in folder.iterdir()) == FILES
        self.model = mujoco.MjModel.from_xml_path(str(folder / "model.xml"))
        self.data = mujoco.MjData(self.model)
        with np.load(folder / "controls.npz") as archive:
            self.arrays = {key: archive[key] for key in archive}
        self.reset()

    def reset(self) -> None:
        mujoco.mj_resetDataKeyframe(self.model, self.data, self.model.key("start").id)

    def largest_error(self, until: float, *, feedback: bool) -> float:
        """Largest distance of a coordinate from the plan, played as docs/exports.md does."""
        self.reset()
        model, data, plan, worst = self.model, self.data, self.arrays, 0.0
        joints = model.actuator_trnid[:, 0]
        places, rows = model.jnt_qposadr[joints], model.jnt_dofadr[joints]
        while data.time < until:
            now = np.searchsorted(plan["time"], data.time + ROUNDING, side="right") - 1
            data.eq_active = plan["eq_active"][now]
            data.ctrl = plan["ctrl"][now]
            if feedback:
                data.ctrl += plan["kp"][now] * (plan["qpos"][now, places] - data.qpos[places])
                data.ctrl += plan["kd"][now] * (plan["qvel"][now, rows] - data.qvel[rows])
            expected = [np.interp(data.time, plan["time"], column) for column in plan["qpos"].T]
            worst = max(worst, float(np.abs(data.qpos - expected).max()))
            mujoco.mj_step(model, data)
        return worst


def exported(plan: Solution, path: Path, **settings: Any) -> Playback:
    return Playback(export_motion(plan, "mujoco", path / "playback", **settings))


@pytest.mark.parametrize("kind", KINDS)
def test_the_keyframe_is_the_start_of_the_plan(kind: str, tmp_path: Path) -> None:
    plan = plan_to_export(kind)
    found = exported(plan, tmp_path, rate=50)
    model, data, arrays = found.model, found.data, found.arrays
    assert_allclose(data.qpos, arrays["qpos"][0], atol=ROUNDING)
    assert_allclose(data.qvel, arrays["qvel"][0], atol=ROUNDING)
    assert_allclose(data.ctrl, arrays["ctrl"][0], atol=ROUNDING)
    own = plan.sample(times=[arrays["time"][5]])
    data.qpos, data.qvel = arrays["qpos"][5], arrays["qvel"][5]
    mujoco.mj_forward(model, data)
    for body in range(1, model.nbody):
        place = place_of(plan.model, model.body(body).name, own.q[0], own.v[0])
        assert_allclose(data.xpos[body], place.pose.translation, atol=ROUNDING)
        assert_allclose(rotation_of(data.xquat[body]), place.pose.rotation, atol=ROUNDING)


@pytest.mark.parametrize("kind", KINDS)
def test_torques_are_those_of_mujocos_inverse_dynamics(kind: str, tmp_path: Path) -> None:
    """At a collocation point, with the exported forces at the contacts instead of MuJoCo's own."""
    plan = plan_to_export(kind)
    found = exported(plan, tmp_path, rate=1 / plan.t[plan.collocation][3])
    model, data, arrays = found.model, found.data, found.arrays
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONTACT
    own = plan.sample(times=[arrays["time"][1]])
    data.qpos, data.qvel = arrays["qpos"][1], arrays["qvel"][1]
    data.qacc = acceleration_in_mujoco(plan, own.q[0], own.v[0], own.a[0], model)
    mujoco.mj_inverse(model, data)
    missing = data.qfrc_inverse.copy()
    for actuator in range(model.nu):
        joint = model.actuator_trnid[actuator, 0]
        missing[model.jnt_dofadr[joint]] -= arrays["ctrl"][1, actuator]
    for number, name in enumerate(arrays["contact_names"]):
        jacobian = np.zeros((6, model.nv))
        mujoco.mj_jacSite(model, data, jacobian[:3], jacobian[3:], model.site(str(name)).id)
        wrench = [*arrays["contact_forces"][1, number], *arrays["contact_moments"][1, number]]
        missing -= jacobian.T @ wrench
    assert np.abs(missing).max() < SOLVED * pin.computeTotalMass(plan.model) * 9.81


def acceleration_in_mujoco(
    plan: Solution, q: np.ndarray, v: np.ndarray, a: np.ndarray, model: mujoco.MjModel
) -> np.ndarray:
    """Accelerations (nv,): of a base along the world's axes, which turn in Pinocchio's with the base."""
    found, base = a.copy(), plan.model.joints[1].shortname()
    if base == "JointModelFreeFlyer":
        turn = pin.Quaternion(q[3:7]).toRotationMatrix()
        found[:3] = turn @ (a[:3] + np.cross(v[3:6], v[:3]))
    elif base == "JointModelPlanar":
        (cosine, sine), (x, y) = q[2:4], a[:2] + v[2] * np.array([-v[1], v[0]])
        found[:2] = cosine * x - sine * y, sine * x + cosine * y
    assert len(found) == model.nv
    return found


@pytest.mark.parametrize("kind", KINDS)
def test_torques_alone_follow_the_plan_for_a_short_time_and_with_gains_to_the_end(
    kind: str, tmp_path: Path
) -> None:
    plan = plan_to_export(kind)
    found = exported(plan, tmp_path)
    *whole, last = np.diff(found.arrays["time"])
    assert_allclose(whole, 1 / 500, atol=ROUNDING)
    assert 0 < last <= 1 / 500 + ROUNDING
    assert found.largest_error(SHORT, feedback=False) < OPEN_LOOP
    assert found.largest_error(found.arrays["time"][-1], feedback=True) < FED_BACK


def test_what_hands_hold_on_to_is_active_in_the_phases_of_the_grasp(tmp_path: Path) -> None:
    plan = solution_of_kind("grasp")
    found = exported(plan, tmp_path)
    active, held = found.arrays["eq_active"], found.arrays["contact_active"]
    assert active.shape == (len(found.arrays["time"]), found.model.neq)
    assert_array_equal(active, held)
    assert found.largest_error(found.arrays["time"][-1], feedback=True) < FED_BACK


def test_the_gains_hold_over_several_cycles(tmp_path: Path) -> None:
    plan = plan_to_export("turning trot")
    found = exported(plan, tmp_path, cycles=3, rate=200)
    assert found.arrays["time"][-1] > 2.9 * plan.t[-1]
    assert found.largest_error(found.arrays["time"][-1], feedback=True) < FED_BACK


def test_the_table_has_the_arrays_by_name(tmp_path: Path) -> None:
    plan = plan_to_export("turning trot")
    found = exported(plan, tmp_path, rate=50)
    with (tmp_path / "playback/controls.csv").open() as file:
        header, *rows = csv.reader(file)
    table, arrays = np.array(rows, dtype=float), found.arrays
    assert_array_equal(table, np.column_stack([arrays[key] for key in ("time", "ctrl", "qpos", "qvel")]))
    assert header[0] == "time"
    model = found.model
    assert header[1 : 1 + model.nu] == [f"ctrl/{model.actuator(i).name}" for i in range(model.nu)]
    free = ["x", "y", "z", "qw", "qx", "qy", "qz"]
    assert header[1 + model.nu :][:7] == [f"qpos/root_joint/{part}" for part in free]
    for joint in range(1, model.njnt):
        name, place = model.joint(joint).name, model.jnt_qposadr[joint]
        assert header[1 + model.nu + place] == f"qpos/{name}"
        assert header[1 + model.nu + model.nq + model.jnt_dofadr[joint]] == f"qvel/{name}"


@pytest.mark.parametrize("kind", ["planar hops", "turning trot"])
def test_every_link_is_seen(kind: str, tmp_path: Path) -> None:
    """Robots whose files have no shapes are drawn as bones that touch nothing."""
    model = exported(plan_to_export(kind), tmp_path, rate=50).model
    seen = model.geom_rbound > SEEN
    assert set(model.geom_bodyid[seen & (model.geom_group < 3)]) >= set(range(1, model.nbody))
    assert not model.geom_contype.any()
    assert not model.geom_conaffinity.any()


def test_missing_mujoco_is_said_in_one_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    plan = plan_to_export("an arm")
    monkeypatch.setitem(sys.modules, "mujoco", None)
    words = "MuJoCo, which is not installed; pip install mujoco, or the extra 'mujoco'"
    assert_refused_in_one_line(lambda: export_motion(plan, "mujoco", tmp_path / "a"), words)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("kind", KINDS)
def test_gains_of_the_plan_give_the_same_torques_in_mujocos_coordinates(kind: str, tmp_path: Path) -> None:
    plan, rng = plan_to_export(kind), np.random.default_rng(2)
    shape = plan.n_intervals, plan.tau.shape[1], 2 * plan.model.nv
    plan = replace(plan, gain=rng.standard_normal(shape))
    found = exported(plan, tmp_path, rate=50)
    model, arrays, k = found.model, found.arrays, 3
    own = plan.sample(times=[arrays["time"][k]])
    change, rate = 1e-6 * rng.standard_normal((2, plan.model.nv))
    q, v = pin.integrate(plan.model, own.q[0], change), own.v[0] + rate
    qpos, qvel = state_in_mujoco(plan, q, v)
    difference = np.zeros(model.nv)
    mujoco.mj_differentiatePos(model, difference, 1.0, arrays["qpos"][k], qpos)
    torque = arrays["gain"][k] @ np.concatenate([difference, qvel - arrays["qvel"][k]])
    expected = plan.gains(own.t)[0] @ np.concatenate([change, rate])
    assert_allclose(torque, expected, rtol=1e-4, atol=1e-4 * np.abs(expected).max())


def state_in_mujoco(plan: Solution, q: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Positions and velocities: of a base along the world's axes, a quaternion with w first."""
    base = plan.model.joints[1].shortname()
    if base == "JointModelFreeFlyer":
        turn = pin.Quaternion(q[3:7]).toRotationMatrix()
        return np.concatenate([q[:3], q[[6, 3, 4, 5]], q[7:]]), np.concatenate([turn @ v[:3], v[3:]])
    if base == "JointModelPlanar":
        (cosine, sine), (x, y) = q[2:4], v[:2]
        place = [*q[:2], np.arctan2(sine, cosine), *q[4:]]
        return np.array(place), np.array([cosine * x - sine * y, sine * x + cosine * y, *v[2:]])
    return q, v
