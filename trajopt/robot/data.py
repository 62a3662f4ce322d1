"""Paths of robot descriptions and their meshes on this machine, in a portable form."""

from __future__ import annotations

import importlib.metadata
import os
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Any

import pinocchio as pin

from trajopt.arguments import checked
from trajopt.errors import InputError, first_line
from trajopt.robot.mjcf import mjcf_geometry

DATA_PACKAGE = "example-robot-data"
# The wheel is built by cmeel, which puts its files under this prefix of site-packages.
DATA_SHARE = "cmeel.prefix/share"

# "package://name/..." is searched in this many parents of a file such as <packages>/name/urdf/robot.urdf.
PACKAGE_LEVELS = 3
# Suffixes of MJCF files; all other files are URDF.
MJCF_SUFFIXES = (".xml", ".mjcf")


def data_share() -> Path:
    """Return the directory that holds ``example-robot-data/robots``.

    URDF files of the package name their meshes ``package://example-robot-data/...``,
    so this is also their package directory. Raises `InputError` if the package is missing.
    """
    try:
        distribution = importlib.metadata.distribution(DATA_PACKAGE)
    except importlib.metadata.PackageNotFoundError:
        raise InputError(
            f"package '{DATA_PACKAGE}' is not installed", f"pip install {DATA_PACKAGE}"
        ) from None
    share = Path(str(distribution.locate_file(DATA_SHARE)))
    if not (share / DATA_PACKAGE / "robots").is_dir():
        raise InputError(
            f"package '{DATA_PACKAGE}' has no {share / DATA_PACKAGE / 'robots'}", "version 5 or later"
        )
    return share


@checked
def robot_file(relative: str) -> Path:
    """Return the path of a description, ``relative`` to ``example-robot-data/robots``."""
    return data_share() / DATA_PACKAGE / "robots" / relative


def package_directories(urdf: Path) -> tuple[Path, ...]:
    """Directories in which ``package://`` paths are searched: those above ``urdf``, and its `data_share`."""
    urdf = Path(os.path.normpath(urdf))  # without "..", links are not followed
    nearby = tuple(urdf.parents)[:PACKAGE_LEVELS]
    try:
        share = data_share()
    except InputError:
        return nearby
    return (*nearby, share) if urdf.is_relative_to(share) else nearby


@dataclass(frozen=True, kw_only=True)
class VisualSource:
    """Source of a robot's geometry: a URDF (or MJCF) file and the directories of its packages."""

    urdf: Path
    package_dirs: tuple[Path, ...] = ()

    def to_meta(self) -> dict[str, Any]:
        """Return the JSON form: paths inside the robot data package are relative to `data_share`."""
        return {"urdf": _portable(self.urdf), "package_dirs": [_portable(path) for path in self.package_dirs]}

    @classmethod
    def from_meta(cls, visual: dict[str, Any]) -> VisualSource:
        """Read the form of `to_meta`; relative paths refer to the installed robot data package."""
        try:
            directories = tuple(_located(path) for path in visual.get("package_dirs", ()))
            return cls(urdf=_located(visual["urdf"]), package_dirs=directories)
        except (KeyError, TypeError, AttributeError):
            raise InputError(
                "key 'visual' is malformed", "an object with 'urdf' and 'package_dirs'"
            ) from None

    @property
    def is_mjcf(self) -> bool:
        """Whether the file is MJCF."""
        return self.urdf.suffix.lower() in MJCF_SUFFIXES

    def geometry(
        self, model: pin.Model, kind: pin.GeometryType = pin.GeometryType.VISUAL
    ) -> pin.GeometryModel:
        """Return the visual or collision geometries placed on ``model``; raises `InputError`."""
        if self.is_mjcf:
            return mjcf_geometry(self.urdf, model, kind)
        if not self.urdf.is_file():
            raise InputError(f"URDF file {self.urdf} of the robot's meshes does not exist")
        directories = [str(path) for path in self.package_dirs]
        try:
            return pin.buildGeomFromUrdf(model, str(self.urdf), kind, package_dirs=directories)
        except (ValueError, RuntimeError) as error:
            raise InputError(f"meshes of {self.urdf} cannot be read: {first_line(error)}") from None


def _portable(path: Path) -> str:
    path = path.absolute()
    try:
        return str(PurePosixPath(path.relative_to(data_share())))
    except (ValueError, InputError):
        return str(path)


def _located(text: str) -> Path:
    path = Path(text)
    return path if path.is_absolute() else data_share() / path
