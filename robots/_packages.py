"""Descriptions of robots in other packages, named as in ``example-robot-data:romeo`` (``PACKAGE:NAME``)."""

from __future__ import annotations

import contextlib
from pathlib import Path
from types import ModuleType

from trajopt.errors import InputError, first_line, not_among
from trajopt.robot import robot_file
from trajopt.robot.data import DATA_PACKAGE
from trajopt.versions import optional_package

MENAGERIE = "menagerie"
PACKAGES = (DATA_PACKAGE, MENAGERIE)
# What the loader of example-robot-data, a package of its own, calls files whose own names differ.
LOADER_NAMES = {
    "alexander": "alexander_description/urdf/alexander_v1.lowerBodyOnly.urdf",
    "anymal": "anymal_b_simple_description/robots/anymal.urdf",
    "anymal_c": "anymal_c_simple_description/urdf/anymal.urdf",
    "anymal_kinova": "anymal_b_simple_description/robots/anymal-kinova.urdf",
    "asr_twodof": "asr_twodof_description/urdf/TwoDofs.urdf",
    "b1_z1": "b1_description/urdf/b1-z1.urdf",
    "borinot": "borinot_description/urdf/borinot_flying_arm_2.urdf",
    "cassie": "cassie_description/robots/cassie.sdf",
    "g1": "g1_description/urdf/g1_29dof_rev_1_0.urdf",
    "g1_with_hands": "g1_description/urdf/g1_29dof_with_hand_rev_1_0.urdf",
    "hector": "hector_description/robots/quadrotor_base.urdf",
    "hextilt": "hextilt_description/urdf/hextilt_flying_arm_5.urdf",
    "hyq": "hyq_description/robots/hyq_no_sensors.urdf",
    "iris": "iris_description/robots/iris_simple.urdf",
    "solo8": "solo_description/robots/solo.urdf",
    "talos": "talos_data/robots/talos_reduced.urdf",
    "talos_arm": "talos_data/robots/talos_left_arm.urdf",
    "talos_box": "talos_data/robots/talos_reduced_box.urdf",
    "talos_full": "talos_data/robots/talos_full_v2.urdf",
    "talos_full_box": "talos_data/robots/talos_full_v2_box.urdf",
    "ur3": "ur_description/urdf/ur3_robot.urdf",
    "ur3_limited": "ur_description/urdf/ur3_joint_limited_robot.urdf",
    "ur5": "ur_description/urdf/ur5_robot.urdf",
    "ur5_limited": "ur_description/urdf/ur5_joint_limited_robot.urdf",
    "ur10": "ur_description/urdf/ur10_robot.urdf",
    "ur10_limited": "ur_description/urdf/ur10_joint_limited_robot.urdf",
}


def packaged_names(package: str) -> tuple[str, ...]:
    """Names of the robots of one of `PACKAGES`, sorted. Raises `InputError` where it is not installed."""
    if package == MENAGERIE:
        return tuple(_menagerie().names())
    return tuple(sorted(name for name, file in _data_files().items() if file.suffix == ".urdf"))


def packaged_as(robot: str) -> list[str]:
    """Names ``PACKAGE:NAME`` of a robot in the installed packages."""
    found = []
    for package in PACKAGES:
        with contextlib.suppress(InputError):
            found += [f"{package}:{robot}"] * (robot in packaged_names(package))
    return found


def packaged_file(name: str) -> Path:
    """The description of the robot ``PACKAGE:NAME``; one of Menagerie is downloaded once.

    Raises `InputError` for an unknown name, and for a description that cannot be downloaded or read.
    """
    package, _, robot = name.partition(":")
    if package not in PACKAGES:
        known = [f"{each}:NAME" for each in PACKAGES]
        raise not_among(known, f"{package}:NAME", f"package '{package}' of robot '{name}' is unknown")
    files = _data_files() if package == DATA_PACKAGE else {}
    if files.get(robot, Path()).suffix == ".sdf":
        raise InputError(f"robot '{name}' is described in SDF, which is not read", "allowed: URDF or MJCF")
    if robot not in (known := packaged_names(package)):
        raise not_among(known, robot, f"robot '{robot}' of {package} is unknown")
    if robot in files:
        return files[robot]
    menagerie = _menagerie()
    described = menagerie.get(robot)
    try:
        return Path(described.xml(described.default_model))
    except (menagerie.MenagerieError, OSError) as error:
        allowed = f"once with network access: mujoco-menagerie prefetch {robot}"
        raise InputError(f"robot '{name}' cannot be downloaded: {first_line(error)}", allowed) from None


def _menagerie() -> ModuleType:
    return optional_package("mujoco_menagerie", what="MuJoCo Menagerie", extra=MENAGERIE)


def _data_files() -> dict[str, Path]:
    """Files of example-robot-data by the loader's names, or else their own."""
    named = {name: path for name, file in LOADER_NAMES.items() if (path := robot_file(file)).is_file()}
    files = set(named.values())
    others = sorted(path for path in robot_file("").glob("*/*/*.urdf") if path not in files)
    return {path.stem: path for path in others} | named
