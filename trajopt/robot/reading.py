"""Description files as numeric `pin.Model`s: URDF, MJCF."""

import os
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from xml.etree import ElementTree

import pinocchio as pin

from trajopt.arguments import checked
from trajopt.dynamics.base_joint import Base, base_of
from trajopt.dynamics.virtual_base import virtual_model
from trajopt.errors import InputError, expanded, first_line
from trajopt.robot.building import sagittal

# Prefix of urdfdom's error messages.
PREFIX = "Error:"


@checked
def read_urdf(path: str | Path, base: Base) -> pin.Model:
    """Read a URDF file with the given base; raises `InputError` if it is missing or malformed."""
    source = existing_file(path, "URDF")
    require_xml(source)
    messages: list[str] = []
    try:
        with _captured_stderr(messages):
            if base == "fixed":
                return pin.buildModelFromUrdf(str(source))
            if base == "planar":
                return sagittal(pin.buildModelFromUrdf(str(source), pin.JointModelPlanar()))
            model = pin.buildModelFromUrdf(str(source), pin.JointModelFreeFlyer())
        return virtual_model(model) if base == "virtual" else model
    except (ValueError, RuntimeError) as error:
        errors = [line.removeprefix(PREFIX).strip(" .") for line in messages if line.startswith(PREFIX)]
        reason = "; ".join(errors) or first_line(error)
        raise InputError(f"{source} is not a readable URDF file: {reason}") from None


@contextmanager
def _captured_stderr(lines: list[str]) -> Iterator[None]:
    """Add what libraries write to the process's stderr to ``lines``, and pass it on unless they fail."""
    sys.stderr.flush()
    with tempfile.TemporaryFile() as file:
        kept = os.dup(2)
        os.dup2(file.fileno(), 2)
        failed = True
        try:
            yield
            failed = False
        finally:
            os.dup2(kept, 2)
            os.close(kept)
            file.seek(0)
            text = file.read().decode(errors="replace")
            lines += text.splitlines()
            if not failed:
                sys.stderr.write(text)


def require_xml(source: Path) -> None:
    """Raise `InputError`, with line and column, for a file that is not XML: URDF parsers print instead."""
    try:
        ElementTree.parse(source)
    except (ElementTree.ParseError, ValueError) as error:  # the second: an unknown encoding
        raise InputError(f"{source} is not a readable URDF file: {error}") from None


def read_mjcf(path: str | Path, base: Base | None) -> pin.Model:
    """Read an MJCF file; ``base=None`` takes the base that the file has.

    A file with a free joint of its own has a floating base: a different ``base`` raises `InputError`. A file
    without one gets the requested base.
    """
    source = existing_file(path, "MJCF")
    try:
        model = pin.buildModelFromMJCF(str(source))
        kind = base_of(model)
        if base is None or base == kind:
            return model
        if (kind, base) == ("freeflyer", "virtual"):
            return virtual_model(model)
        if kind != "fixed":
            raise InputError(
                f"{source} has a {kind} root joint of its own, base={base!r} contradicts it",
                f"{kind!r}",
            )
        root = pin.JointModelPlanar() if base == "planar" else pin.JointModelFreeFlyer()
        model = pin.buildModelFromMJCFAndRootJoint(str(source), pin.JointModel(root))
    except (ValueError, RuntimeError) as error:
        raise InputError(f"{source} is not a readable MJCF file: {first_line(error)}") from None
    if base == "virtual":
        return virtual_model(model)
    return sagittal(model) if base == "planar" else model


def existing_file(path: str | Path, kind: str) -> Path:
    """Return the absolute path of a file. Raises `InputError` if it does not exist."""
    source = expanded(path).absolute()
    if not source.is_file():
        raise InputError(f"{kind} file {source} does not exist")
    return source
