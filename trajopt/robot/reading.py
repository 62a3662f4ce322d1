"""URDF files as numeric `pin.Model`s."""

import math
import os
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from xml.etree import ElementTree

import pinocchio as pin

from trajopt.arguments import checked
from trajopt.dynamics.base_joint import Base
from trajopt.dynamics.virtual_base import virtual_model
from trajopt.errors import InputError, expanded, first_line
from trajopt.robot.building import sagittal

# Prefix of urdfdom's error messages.
PREFIX = "Error:"
# Suffix of files for the preprocessor xacro, and the part that the tags of its elements share.
XACRO, XACRO_ELEMENT = ".xacro", "xacro}"


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
    """Capture in ``lines`` what libraries write to stderr; pass it on unless they fail."""
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


def require_xml(source: Path) -> ElementTree.Element:
    """Root element of a URDF. Raises `InputError` for malformed XML, with its position, and Xacro files."""
    try:
        root = ElementTree.parse(source).getroot()
    except (ElementTree.ParseError, ValueError) as error:  # the second: an unknown encoding
        raise InputError(f"{source} is not a readable URDF file: {error}") from None
    # The output of xacro may keep its namespace, but none of its elements.
    if source.suffix == XACRO or any(XACRO_ELEMENT in str(element.tag) for element in root.iter()):
        target = source.with_suffix("").stem if source.suffix == XACRO else f"{source.stem}_expanded"
        command = f"xacro {source.name} > {target}.urdf"
        raise InputError(f"{source} is a Xacro file, not yet a URDF", f"expand it: {command}")
    require_numbers(source, root)
    return root


def require_numbers(source: Path, root: ElementTree.Element) -> None:
    """Raise `InputError` for masses, inertias and mimic rules that are not numbers: parsers skip them."""
    for owner in (*root.iter("link"), *root.iter("joint")):
        for path in ("inertial/mass", "inertial/inertia", "mimic"):
            element = owner.find(path)
            for key, value in () if element is None else element.items():
                if key != "joint" and not _is_number(value):
                    what = f"{key} of <{path.split('/')[-1]}> of {owner.tag} '{owner.get('name')}'"
                    raise InputError(f"{source}: {what} is '{value}'", "allowed: a finite number")


def _is_number(text: str) -> bool:
    try:
        return math.isfinite(float(text))
    except ValueError:
        return False


def existing_file(path: str | Path, kind: str) -> Path:
    """Return the absolute path of a file. Raises `InputError` if it does not exist."""
    source = expanded(path).absolute()
    if not source.is_file():
        what = "is a folder" if source.is_dir() else "does not exist"
        raise InputError(f"{kind} file {source} {what}")
    return source
