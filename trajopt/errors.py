"""Errors of the toolkit, which say in one line what is wrong, where, and what is allowed; checks for them."""

from __future__ import annotations

import contextlib
import difflib
import math
import reprlib
import traceback
from collections.abc import Callable, Iterable, Mapping
from numbers import Real
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeGuard

if TYPE_CHECKING:
    import numpy as np

# A message lists all allowed names up to the first number, otherwise the second number of them.
MOST_NAMES, FEW_NAMES = 60, 8
WIDTH = 60  # characters of a value in a message
COAL_MESSAGE = "\nmessage: "


class TrajoptError(Exception):
    """Base class of the errors that the toolkit raises for user input or the environment."""

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle without calling the class's constructor, so that pools can raise their processes' errors."""
        return _as_raised, (type(self), self.args), vars(self)


class InputError(TrajoptError):
    """A value given by the user is not allowed.

    ``what`` names the value, ``allowed`` says what would be accepted.
    """

    def __init__(self, what: str, allowed: str = "") -> None:
        self.what, self.allowed = what, allowed
        super().__init__(f"{what}; {allowed}" if allowed else what)


def not_among(known: Iterable[str], name: str, what: str) -> InputError:
    """Return the error for an unknown name, with suggestions.

    Args:
        known: Allowed names; if there are many, such as a robot's frames, only the closest are listed.
        name: The given name.
        what: Beginning of the message.
    """
    names = list(known)
    folded, given = {str(each).casefold(): each for each in names}, str(name).casefold()
    close = [folded[each] for each in difflib.get_close_matches(given, folded, FEW_NAMES)]
    close = close or [each for key, each in folded.items() if given and given in key][:FEW_NAMES]
    hint = f"did you mean {close[0]}? " if close else ""
    listed = names if len(names) <= MOST_NAMES else [*(close or names[:FEW_NAMES]), "..."]
    return InputError(what, f"{hint}allowed: {', '.join(listed) or 'none'}")


def _as_raised(kind: type[TrajoptError], args: tuple[Any, ...]) -> TrajoptError:
    return kind.__new__(kind, *args)


class UnsupportedJointError(InputError):
    """A joint of the model has a kind that the toolkit cannot differentiate or transcribe."""

    def __init__(self, joint: str, kind: str, allowed: str) -> None:
        self.joint, self.kind = joint, kind
        what = f"joint '{joint}' is of kind {kind}, which is not supported"
        super().__init__(what, f"supported: {allowed}")


class SolutionFileError(InputError):
    """A solution file is missing, truncated, foreign or inconsistent."""


class VersionMismatchError(TrajoptError):
    """The installed wheels differ from those the extension was built against."""


def shown(value: Any) -> str:
    """Return a value for a message in one shortened line; objects appear by their kind, not their repr."""
    text = " ".join(_Shown().repr(value).split())
    return text if len(text) <= WIDTH else text[: WIDTH - 3] + "..."


class _Shown(reprlib.Repr):
    """Python's shortened repr for plain values and collections of them."""

    def __init__(self) -> None:
        super().__init__()
        self.maxlevel, self.maxlist, self.maxtuple, self.maxstring = (
            3,
            FEW_NAMES,
            FEW_NAMES,
            WIDTH,
        )

    def repr_instance(self, value: Any, level: int) -> str:
        if type(value) in (float, complex, bool, bytes, type(None)):
            return repr(value)
        if type(value).__module__ == "numpy" and hasattr(value, "tolist"):
            listed = self.repr1(value.tolist(), level) if 0 < value.size <= FEW_NAMES else ""
            return listed if 0 < len(listed) <= WIDTH else f"an array of shape {value.shape}{_flaw(value)}"
        if isinstance(value, Path):
            return f"'{value}'"
        return f"the class {value.__name__}" if isinstance(value, type) else with_article(type(value))


def _flaw(array: np.ndarray) -> str:
    """Say where an array has its first NaN, or else infinity; empty if it has neither."""
    import numpy as np  # deferred, also below: the command line loads errors before it needs arrays

    if array.dtype.kind != "f":
        return ""
    for word, flaws in (("nan", np.isnan(array)), ("inf", np.isinf(array))):
        if flaws.any():
            return f" with {word} at {np.argwhere(flaws)[0].tolist()}"
    return ""


def require_fields(kind: Any, described: Any, what: str) -> None:
    """Raise `InputError` unless ``described``, called ``what``, has exactly the fields of a dataclass."""
    names = set(kind.__dataclass_fields__)
    if not isinstance(described, Mapping) or set(described) != names:
        raise InputError(f"{what} in meta is not an object of its fields", ", ".join(sorted(names)))


def with_article(kind: type) -> str:
    """Return the name of a class with its article."""
    return f"{'an' if kind.__name__[0] in 'aeiouAEIOU' else 'a'} {kind.__name__}"


def first_line(error: Exception) -> str:
    """Return the first line of an exception's message, or its type if empty; for Coal, its message proper."""
    text = str(error).strip()
    if COAL_MESSAGE in text:  # it follows lines about Coal's own source and precedes a hint
        said = text.partition(COAL_MESSAGE)[2].splitlines()
        return ": ".join(line for line in said if not line.startswith("Hint: "))
    return next(iter(text.splitlines()), type(error).__name__)


def line_in(path: Path, error: BaseException) -> int | None:
    """Return the innermost line of a file at which an exception arose, or None if it is not from the file."""
    if isinstance(error, SyntaxError) and error.filename is not None and Path(error.filename) == path:
        return error.lineno
    entries = traceback.extract_tb(error.__traceback__)
    return next((each.lineno for each in reversed(entries) if Path(each.filename) == path), None)


def placed(error: TrajoptError, where: str) -> InputError:
    """Return the error with its origin in front, keeping what is allowed."""
    if isinstance(error, InputError):
        return InputError(f"{where}: {error.what}", error.allowed)
    return InputError(f"{where}: {error}")


def in_file(error: Exception, function: Callable[..., Any] | None = None) -> str:
    """Return an exception in one line, with the line of the function's file, or else its origin."""
    code = getattr(function, "__code__", None)
    given = getattr(error, "filename", None) if code is None else code.co_filename
    path = Path(given or traceback.extract_tb(error.__traceback__)[-1].filename)
    return f"{path}, {failure(error, path)}"


def failure(error: Exception, path: Path) -> str:
    """Return an exception from a file in one line: its type, its first line, and the line of the file."""
    line = line_in(path, error)
    text = next(iter(str(error).strip().splitlines()), "")
    said = f"{type(error).__name__}: {text}" if text else type(error).__name__
    return said if line is None else f"line {line}: {said}"


def expanded(path: str | Path) -> Path:
    """Return the path with a leading ``~`` expanded; raises `InputError` for an unknown user."""
    try:
        return Path(path).expanduser()
    except RuntimeError:
        raise InputError(f"{path}: there is no home folder of that user", "allowed: a path") from None


def is_number(value: Any) -> TypeGuard[float]:
    """Return whether a value is a finite number, Python's or NumPy's, but not True or False."""
    return _is_real(value) and math.isfinite(value)


def require_positive(what: str, value: Any, unit: str = "") -> None:
    """Raise `InputError` unless ``value`` is a finite positive number."""
    _require(is_number(value) and value > 0, what, value, unit, "finite and > 0")


def require_not_negative(what: str, value: Any, unit: str = "") -> None:
    """Raise `InputError` unless ``value`` is a finite non-negative number."""
    _require(is_number(value) and value >= 0, what, value, unit, "finite and >= 0")


def finite_number(what: str, text: str, unit: str = "") -> float:
    """Return the finite number that a text holds; else raise `InputError`."""
    with contextlib.suppress(ValueError):
        if math.isfinite(value := float(text)):
            return value
    raise InputError(f"{what} is '{text}'", "allowed: a finite number" + (f", {unit}" if unit else ""))


def without_nonfinite(value: object) -> object:
    """Return a JSON-able value with None for non-finite numbers."""
    if isinstance(value, Mapping):
        return {str(key): without_nonfinite(entry) for key, entry in value.items()}
    if isinstance(value, list | tuple):
        return [without_nonfinite(entry) for entry in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def _is_real(value: Any) -> bool:
    return isinstance(value, Real) and not isinstance(value, bool)


def _require(right: bool, what: str, value: Any, unit: str, allowed: str) -> None:
    if not right:
        text = f"{value:g}" if _is_real(value) else shown(value)
        raise InputError(f"{what} is {text} {unit}".rstrip(), f"allowed: {allowed}")


def numbers_of(value: Any) -> np.ndarray:
    """Return a copy of ``value`` as an array of numbers, empty if it is not one."""
    import numpy as np

    try:
        return np.array(value, dtype=float)
    except (TypeError, ValueError):
        return np.zeros(0)


def finite_array(what: str, value: Any, shape: tuple[int, ...] = (3,), unit: str = "") -> np.ndarray:
    """Return a read-only copy of ``value`` as finite numbers of a shape; else raise `InputError`."""
    import numpy as np

    array = numbers_of(value)
    if array.shape != shape or not np.isfinite(array).all():
        size = str(shape[0]) if len(shape) == 1 else f"{shape}"
        allowed = f"allowed: {size} finite numbers" + (f", {unit}" if unit else "")
        raise InputError(f"{what} is {shown(array if array.shape == shape else value)}", allowed)
    array.setflags(write=False)
    return array
