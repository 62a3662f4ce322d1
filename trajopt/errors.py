"""Errors of the toolkit, one line each that says what, where and what is allowed; checks that raise them."""

from __future__ import annotations

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

# A message lists all allowed names up to this many, and of more this many.
MANY, LISTED = 60, 8
SHOWN = 60  # characters of a value in a message
COAL_MESSAGE = "\nmessage: "


class TrajoptError(Exception):
    """Base of every error the toolkit raises for its user's input or environment."""

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickled as it is, whatever its class takes: a pool raises the errors of its processes."""
        return _as_raised, (type(self), self.args), vars(self)


class InputError(TrajoptError):
    """A value given by the user is not allowed.

    ``what`` names the value, ``allowed`` says what would be accepted.
    """

    def __init__(self, what: str, allowed: str = "") -> None:
        self.what, self.allowed = what, allowed
        super().__init__(f"{what}; {allowed}" if allowed else what)


def not_among(known: Iterable[str], name: str, what: str) -> InputError:
    """The error of a name that is none of those known, with the one that may have been meant.

    Args:
        known: names that are allowed; of many, such as a robot's frames, only the closest are listed.
        name: the one given.
        what: beginning of the message.
    """
    names = list(known)
    folded = {str(each).casefold(): each for each in names}
    close = [folded[each] for each in difflib.get_close_matches(str(name).casefold(), folded, LISTED)]
    hint = f"did you mean {close[0]}? " if close else ""
    listed = names if len(names) <= MANY else [*(close or names[:LISTED]), "..."]
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
    """The installed wheels are not the ones the extension was built against."""


def shown(value: Any) -> str:
    """A value of a message in one line, cut where it is long; an object by its kind, never by its repr."""
    text = " ".join(_Shown().repr(value).split())
    return text if len(text) <= SHOWN else text[: SHOWN - 3] + "..."


class _Shown(reprlib.Repr):
    """Python's shortened repr, for plain values and collections of them."""

    def __init__(self) -> None:
        super().__init__()
        self.maxlevel, self.maxlist, self.maxtuple, self.maxstring = 3, LISTED, LISTED, SHOWN

    def repr_instance(self, value: Any, level: int) -> str:
        if type(value) in (float, complex, bool, bytes, type(None)):
            return repr(value)
        if type(value).__module__ == "numpy" and hasattr(value, "tolist"):
            few = 0 < value.size <= LISTED
            return self.repr1(value.tolist(), level) if few else f"an array of shape {value.shape}"
        if isinstance(value, Path):
            return f"'{value}'"
        return f"the class {value.__name__}" if isinstance(value, type) else with_article(type(value))


def require_fields(kind: Any, described: Any, what: str) -> None:
    """Raise `InputError` unless ``described`` has exactly the fields of a dataclass, ``what`` in words."""
    names = set(kind.__dataclass_fields__)
    if not isinstance(described, Mapping) or set(described) != names:
        raise InputError(f"{what} in meta is not an object of its fields", ", ".join(sorted(names)))


def with_article(kind: type) -> str:
    """The name of a class in a sentence."""
    return f"{'an' if kind.__name__[0] in 'aeiouAEIOU' else 'a'} {kind.__name__}"


def first_line(error: Exception) -> str:
    """The first line of a library's exception, or its type if it has no text; of Coal's its message."""
    text = str(error).strip()
    if COAL_MESSAGE in text:  # after lines on Coal's own source, before a hint
        said = text.partition(COAL_MESSAGE)[2].splitlines()
        return ": ".join(line for line in said if not line.startswith("Hint: "))
    return next(iter(text.splitlines()), type(error).__name__)


def line_in(path: Path, error: BaseException) -> int | None:
    """The line of a file in which an exception arose, the innermost of it; None if it is not of the file."""
    if isinstance(error, SyntaxError) and error.filename is not None and Path(error.filename) == path:
        return error.lineno
    entries = traceback.extract_tb(error.__traceback__)
    return next((each.lineno for each in reversed(entries) if Path(each.filename) == path), None)


def placed(error: TrajoptError, where: str) -> InputError:
    """The error with where it arose before it, and still with what is allowed."""
    if isinstance(error, InputError):
        return InputError(f"{where}: {error.what}", error.allowed)
    return InputError(f"{where}: {error}")


def in_file(error: Exception, function: Callable[..., Any] | None = None) -> str:
    """An exception in one line, with the line of the function's file, else the one in which it arose."""
    code = getattr(function, "__code__", None)
    given = getattr(error, "filename", None) if code is None else code.co_filename
    path = Path(given or traceback.extract_tb(error.__traceback__)[-1].filename)
    return f"{path}, {failure(error, path)}"


def failure(error: Exception, path: Path) -> str:
    """An exception from a file in one line: its type, its first line, and the line of the file."""
    line = line_in(path, error)
    text = next(iter(str(error).strip().splitlines()), "")
    said = f"{type(error).__name__}: {text}" if text else type(error).__name__
    return said if line is None else f"line {line}: {said}"


def expanded(path: str | Path) -> Path:
    """The path with the home folder for a first ``~``; raises `InputError` for a user that does not exist."""
    try:
        return Path(path).expanduser()
    except RuntimeError:
        raise InputError(f"{path}: there is no home folder of that user", "allowed: a path") from None


def is_number(value: Any) -> TypeGuard[float]:
    """Whether a value is a finite number, Python's or NumPy's; True and False are not."""
    return _is_real(value) and math.isfinite(value)


def require_positive(what: str, value: Any, unit: str = "") -> None:
    """Raise `InputError` unless ``value`` is a finite number above zero."""
    _require(is_number(value) and value > 0, what, value, unit, "finite and > 0")


def require_not_negative(what: str, value: Any, unit: str = "") -> None:
    """Raise `InputError` unless ``value`` is a finite number of zero or above."""
    _require(is_number(value) and value >= 0, what, value, unit, "finite and >= 0")


def require_finite(what: str, value: Any, unit: str = "") -> None:
    """Raise `InputError` unless ``value`` is a finite number."""
    _require(is_number(value), what, value, unit, "a finite number")


def _is_real(value: Any) -> bool:
    return isinstance(value, Real) and not isinstance(value, bool)


def _require(right: bool, what: str, value: Any, unit: str, allowed: str) -> None:
    if not right:
        text = f"{value:g}" if _is_real(value) else shown(value)
        raise InputError(f"{what} is {text} {unit}".rstrip(), f"allowed: {allowed}")


def numbers_of(value: Any) -> np.ndarray:
    """A copy of ``value`` as an array of numbers, empty if it is not one."""
    import numpy as np  # here as below: errors are loaded with the command line, before arrays are needed

    try:
        return np.array(value, dtype=float)
    except (TypeError, ValueError):
        return np.zeros(0)


def finite_array(what: str, value: Any, shape: tuple[int, ...] = (3,), unit: str = "") -> np.ndarray:
    """A read-only copy of ``value`` as finite numbers of a shape. Raises `InputError` for anything else."""
    import numpy as np

    array = numbers_of(value)
    if array.shape != shape or not np.isfinite(array).all():
        size = str(shape[0]) if len(shape) == 1 else f"{shape}"
        allowed = f"allowed: {size} finite numbers" + (f", {unit}" if unit else "")
        raise InputError(f"{what} is {shown(value)}", allowed)
    array.setflags(write=False)
    return array


def unit_vector(what: str, value: Any) -> np.ndarray:
    """The direction (3,) of ``value`` with length one. Raises `InputError` for anything without direction."""
    import numpy as np

    vector = numbers_of(value)
    if vector.shape != (3,) or not np.isfinite(vector).all() or not vector.any():
        raise InputError(f"{what} is {shown(value)}", "allowed: 3 finite numbers, not all 0")
    return np.asarray(vector / np.linalg.norm(vector))
