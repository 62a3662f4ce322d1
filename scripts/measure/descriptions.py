"""MJCF files of others: what is read beside what MuJoCo compiles."""

from pathlib import Path

import click
import mujoco

from scripts.measure.shared import head, row
from tests.support.mujoco_comparison import differences
from trajopt import InputError, Robot


@click.command()
@click.argument(
    "files", nargs=-1, required=True, type=click.Path(exists=True, dir_okay=False, path_type=Path)
)
def descriptions(files: tuple[Path, ...]) -> None:
    """Largest relative difference of masses, poses, gravity and inverse dynamics from MuJoCo's."""
    head("file", "base", "nv", "inputs", "mass, kg", "apart")
    for path in files:
        try:
            compiled = mujoco.MjModel.from_xml_path(str(path))
            robot = Robot.from_mjcf(path)
        except (ValueError, InputError) as error:
            row(path, "refused", "", "", "", " ".join(str(error).split()))
            continue
        apart = max(differences(compiled, robot.model).values())
        row(path, robot.base, robot.nv, robot.nu, f"{robot.mass:.4g}", f"{apart:.0e}")
