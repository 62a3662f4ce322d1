"""MuJoCo, which is optional: it reads MJCF files and simulates."""

import contextlib
from collections.abc import Iterator
from typing import Any

from trajopt.errors import InputError

PACKAGE_MISSING = "pip install mujoco, or the extra 'mujoco'"


def mujoco_package(purpose: str = "simulating") -> Any:
    """The module ``mujoco``; raises `InputError` where it is not installed."""
    try:
        import mujoco
    except ImportError:
        raise InputError(f"{purpose} needs MuJoCo, which is not installed", PACKAGE_MISSING) from None
    return mujoco


@contextlib.contextmanager
def muted_mujoco(purpose: str = "simulating") -> Iterator[None]:
    """Suppress MuJoCo's warnings, which go to stderr and into a file in the working directory.

    Divergence is detected from the state instead.
    """
    mujoco = mujoco_package(purpose)
    before = mujoco.get_mju_user_warning()
    mujoco.set_mju_user_warning(lambda _: None)
    try:
        yield
    finally:
        mujoco.set_mju_user_warning(before)
