"""Errors of the toolkit: one line each that says what, where and what is allowed."""

from __future__ import annotations


class TrajoptError(Exception):
    """Base of every error the toolkit raises for its user's input or environment."""


class InputError(TrajoptError):
    """A value given by the user is not allowed.

    ``what`` names the value, ``allowed`` says what would be accepted.
    """

    def __init__(self, what: str, allowed: str = "") -> None:
        self.what = what
        self.allowed = allowed
        super().__init__(f"{what}; {allowed}" if allowed else what)


class UnsupportedJointError(InputError):
    """A joint of the model has a kind that the toolkit cannot differentiate or transcribe."""

    def __init__(self, joint: str, kind: str, allowed: str) -> None:
        self.joint = joint
        self.kind = kind
        super().__init__(
            f"joint '{joint}' is of kind {kind}, which is not supported", f"supported: {allowed}"
        )


class SolutionFileError(InputError):
    """A solution file is missing, truncated, foreign or inconsistent."""


class VersionMismatchError(TrajoptError):
    """The installed wheels are not the ones the extension was built against."""


def first_line(error: Exception) -> str:
    """What a library's exception says first, or its kind where it says nothing."""
    return next(iter(str(error).strip().splitlines()), type(error).__name__)
