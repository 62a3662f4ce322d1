"""A motion to play back in MuJoCo: the model with its ground, and torques and states over time."""

import csv
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from trajopt.export.archives import contact_arrays, names_array, write_archive
from trajopt.export.exported_motion import ExportedMotion
from trajopt.motion.cycles import gains_in_passes, pass_numbers
from trajopt.robot.mujoco_package import mujoco_package, muted_mujoco
from trajopt.simulation.joint_feedback import gains_of
from trajopt.simulation.mjcf import mjcf_of_scene
from trajopt.simulation.scene import Scene, build_scene
from trajopt.simulation.settings import SimulationSettings
from trajopt.simulation.site import Site

MODEL, ARRAYS, TABLE = "model.xml", "controls.npz", "controls.csv"
# Suffixes of the coordinate names of a free joint; other joints have one coordinate each.
FREE_POSITION = ("/x", "/y", "/z", "/qw", "/qx", "/qy", "/qz")
FREE_VELOCITY = ("/linear_x", "/linear_y", "/linear_z", "/angular_x", "/angular_y", "/angular_z")


def write_mujoco_playback(motions: Sequence[ExportedMotion], path: Path, options: Mapping[str, Any]) -> None:
    """Write one motion: the MJCF, and times, torques, states and feedback gains as arrays and as a table.

    ``gain`` (n, nu, 2 nv) are the gains of a plan that has them, in MuJoCo's coordinates.

    Raises `InputError` for a model that MJCF cannot express, and without MuJoCo.
    """
    (motion,) = motions
    with muted_mujoco():
        scene = build_scene(Site.of_plan(motion.plan), SimulationSettings())
        text = mjcf_of_scene(motion.plan, scene)
        compiled = mujoco_package().MjModel.from_xml_string(text)
        arrays = _playback_arrays(motion, scene)
    (path / MODEL).write_text(text, encoding="utf-8")
    named = {
        "actuator_names": names_array([compiled.actuator(i).name for i in range(compiled.nu)]),
        "qpos_names": names_array(_coordinate_names(compiled, FREE_POSITION)),
        "qvel_names": names_array(_coordinate_names(compiled, FREE_VELOCITY)),
    }
    write_archive(path / ARRAYS, arrays | named | contact_arrays(motion))
    _write_table(path / TABLE, arrays, named)


def _playback_arrays(motion: ExportedMotion, scene: Scene) -> dict[str, np.ndarray]:
    """Times (n,), torques and gains (n, nu) in the order of the motors, states (n, nq), (n, nv), and grasps.

    A motor's torque is that of its drive, since the model includes the joints' friction.
    """
    coordinates, joints = scene.coordinates, motion.joints
    qpos = coordinates.to_mujoco(motion.q)
    addresses = [coordinates.addresses[motion.model.getJointId(name) - 1].q for name in joints.names]
    for place, angle in zip(addresses, joints.position.T, strict=True):
        qpos[:, place] = angle[:, None]  # counts turns even if samples are far apart
    period = float(scene.compiled.opt.timestep)  # feedback acts at every physics step
    gains = gains_of(scene, motion, period, SimulationSettings())
    whole = {} if motion.plan.gain is None else {"gain": _plan_gains(motion, scene, qpos)}
    return whole | {
        "time": motion.t,
        "ctrl": motion.drive_torque,
        "qpos": qpos,
        "qvel": coordinates.rates_to_mujoco(qpos, motion.v),
        "kp": gains.kp,
        "kd": gains.kd,
        "eq_active": _held_grasps(motion, scene),
    }


def _plan_gains(motion: ExportedMotion, scene: Scene, qpos: np.ndarray) -> np.ndarray:
    """Gains (n, nu, 2 nv) on differences by ``mj_differentiatePos`` and of ``qvel``.

    A base's linear velocity in its own axes also changes as they turn.
    """
    plan, nv = motion.plan, motion.model.nv
    number = pass_numbers(plan, motion)
    begun, ended = plan.interval_t[0, 0], plan.interval_t[-1, 1]
    times = np.clip(motion.t - number * (ended - begun) + begun, begun, ended)
    gains = gains_in_passes(plan, times, number)
    place, rate = gains[..., :nv].copy(), gains[..., nv:]
    base, turning = motion.base, motion.v[:, None, :3]
    if base == "freeflyer":
        place[..., 3:6] += np.cross(rate[..., :3], turning)
    elif base == "planar":
        place[..., 2] += rate[..., 0] * turning[..., 1] - rate[..., 1] * turning[..., 0]
    parts = [
        scene.coordinates.rates_to_mujoco(np.repeat(qpos, gains.shape[1], axis=0), part.reshape(-1, nv))
        for part in (place, rate)
    ]
    return np.concatenate([part.reshape(place.shape) for part in parts], axis=-1)


def _held_grasps(motion: ExportedMotion, scene: Scene) -> np.ndarray:
    """Whether each grasp is active (n, neq), in the order of the model's equality constraints."""
    held = [np.isin(motion.source, grasp.phases) for grasp in scene.site.grasps]
    return np.array(held).reshape(-1, len(motion.t)).T


def _coordinate_names(compiled: Any, of_free: Sequence[str]) -> list[str]:
    free = mujoco_package().mjtJoint.mjJNT_FREE
    return [
        f"{compiled.joint(joint).name}{part}"
        for joint in range(compiled.njnt)
        for part in (of_free if compiled.jnt_type[joint] == free else ("",))
    ]


def _write_table(path: Path, arrays: Mapping[str, np.ndarray], named: Mapping[str, np.ndarray]) -> None:
    """Write a header, then one line per sample: time, torques, positions, velocities, at full precision."""
    groups = {"ctrl": "actuator_names", "qpos": "qpos_names", "qvel": "qvel_names"}
    header = ["time", *(f"{group}/{name}" for group, names in groups.items() for name in named[names])]
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(header)
        writer.writerows(np.column_stack([arrays[name] for name in ("time", *groups)]).tolist())
