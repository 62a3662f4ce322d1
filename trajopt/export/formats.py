"""Export formats by name: what each writes, its options, and where its writer is.

A writer is a function ``write(motions, path, options)`` of the motions (`ExportedMotion`), the file to write
or the empty folder to fill, which nobody else sees until it is complete, and the given ones of
`Format.options`. It raises `InputError` for motions that the format cannot hold. A new format takes one entry
here and one module; a new option takes one entry here and one keyword of `export_motion`.
"""

import importlib
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from types import ModuleType
from typing import Any

from trajopt.errors import InputError, not_among
from trajopt.versions import optional_package

# Default samples per second: the rate at which policies of legged robots are trained and run.
RATE = 50.0
# Default for torques to play back: the rate at which controllers of legged robots run.
CONTROL_RATE = 500.0


@dataclass(frozen=True, kw_only=True)
class ExportOption:
    """An option of some formats: a keyword of `export_motion`, and ``--NAME`` on the command line.

    metavar: placeholder of its value. help: one line. is_path: whether the value is a path.
    """

    metavar: str
    help: str
    is_path: bool = False


@dataclass(frozen=True, kw_only=True)
class Format:
    """A format of motions.

    help: one line. writer: "module:function", loaded on use. ending: of its file; "" for a folder. several:
    whether it takes several motions. options: names among `OPTIONS`. marker: path, within its folder, of a
    file that every export has; a folder without it is not replaced. rate: default samples per second. even:
    whether all steps are equal, see `sample_cycles`.
    """

    help: str
    writer: str
    ending: str = ""
    several: bool = False
    options: tuple[str, ...] = ()
    marker: str = ""
    rate: float = RATE
    even: bool = True

    def load_writer(self) -> Callable[..., None]:
        """Import and return the writer."""
        module, _, name = self.writer.partition(":")
        writer: Callable[..., None] = getattr(importlib.import_module(module), name)
        return writer


OPTIONS = {
    "mjcf": ExportOption(
        metavar="FILE",
        help="MJCF of the simulator's robot, for the order of its joints and bodies.",
        is_path=True,
    ),
    "task": ExportOption(
        metavar="TEXT", help="What the robot does, in words.  [default: the problem's name]"
    ),
    "fields": ExportOption(
        metavar="NAMES",
        help="Of the points of the trajectory, such as positions,velocities.  [default: all]",
    ),
}
FORMATS = {
    "isaaclab-amp": Format(
        help="Isaac Lab, AMP (MotionLoader)",
        writer="trajopt.export.isaaclab_amp:write_isaaclab_amp",
        ending=".npz",
    ),
    "mjlab": Format(
        help="mjlab and BeyondMimic (MotionLoader)",
        writer="trajopt.export.mjlab:write_mjlab",
        ending=".npz",
        options=("mjcf",),
    ),
    "loco-mujoco": Format(
        help="LocoMuJoCo (Trajectory), one motion or several",
        writer="trajopt.export.loco_mujoco:write_loco_mujoco",
        ending=".npz",
        several=True,
        options=("mjcf",),
    ),
    "amp-hardware": Format(
        help="AMP for hardware (AMPLoader), 61 numbers a frame; quadrupeds",
        writer="trajopt.export.amp_hardware:write_amp_hardware",
        ending=".json",
    ),
    "lerobot": Format(
        help="LeRobot data set v3.0 (LeRobotDataset), one episode or several",
        writer="trajopt.export.lerobot:write_lerobot",
        several=True,
        options=("task",),
        marker="meta/info.json",
    ),
    "mujoco": Format(
        help="MuJoCo: the model with its ground, and torques to play back; 500 Hz",
        writer="trajopt.export.mujoco_playback:write_mujoco_playback",
        marker="controls.npz",
        rate=CONTROL_RATE,
        even=False,
    ),
    "rosbag": Format(
        help="ROS 2 bag: trajectory, joint states, tf, odometry, contact forces",
        writer="trajopt.export.rosbag:write_rosbag",
        options=("fields",),
        marker="metadata.yaml",
        even=False,
    ),
}


def package_of_format(name: str, extra: str) -> ModuleType:
    """Import the module ``name``, which an extra installs; raises `InputError` if it is missing."""
    return optional_package(name, what="this format", extra=extra)


def format_named(name: str) -> Format:
    """The format with this name; raises `InputError`."""
    if name not in FORMATS:
        raise not_among(FORMATS, name, f"export format {name!r} is unknown")
    return FORMATS[name]


def keyword_arguments(**given: Any) -> dict[str, Any]:
    """The given options other than None."""
    return {name: value for name, value in given.items() if value is not None}


def require_options(name: str, chosen: Format, given: Iterable[str]) -> None:
    """Raise `InputError` for an option that a format does not have."""
    for option in given:
        if option not in chosen.options:
            allowed = ", ".join(chosen.options) or "no option"
            raise InputError(f"{option} is of no use for {name}", f"allowed: {allowed}")


def require_count(name: str, chosen: Format, count: int) -> None:
    """Raise `InputError` for no motion, or for several that a format does not take."""
    if count == 0 or (count > 1 and not chosen.several):
        raise InputError(
            f"{count} motions for {name}", "allowed: one or more" if chosen.several else "allowed: one"
        )
