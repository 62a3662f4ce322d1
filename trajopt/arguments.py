"""Checks of arguments of public classes and functions against their annotations, with one-line errors.

`checked` is the only mechanism. It reads the annotations of a dataclass's fields or of a function at the
first call. Besides Python's own types it supports the ranges and shapes below, as parts of an annotation.

It does not use a library. Measured with `trajopt.load("quadruped-trot")`, 0.86 s of processor time: building
the kinds of its 161 parameters takes 1 ms, checking its 3,635 values 5 ms. pydantic 2.14 checks them in 3 ms,
but takes 140 ms to import and 23 ms to build its validators, a fifth of the total. It would validate
dataclasses anew, so every annotation would have to be translated, and its messages on unions name its own
functions. beartype 0.23 takes 170 ms to import, accepts True as a number, converts nothing, and checks a
random item of a sequence: 195 of 200 checks of 50 numbers and a string passed (`BeartypeStrategy.On`: 193).
"""

from __future__ import annotations

import builtins
import functools
import inspect
import sys
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Annotated, Any, TypeVar

from trajopt.errors import InputError, not_among
from trajopt.kinds import ANY, ArrayShape, Kind, Normalised, Range, RefusedError, kind_of
from trajopt.pickling import picklable

if TYPE_CHECKING:
    import numpy as np  # deferred: the command line checks arguments before it needs arrays

_Target = TypeVar("_Target", bound=Callable[..., Any])

# Numbers exclude True and False and are finite unless stated otherwise; these have a range.
Positive = Annotated[float, Range(0.0, above=True)]
NonNegative = Annotated[float, Range(0.0)]
Fraction = Annotated[float, Range(0.0, 1.0)]
SignedFraction = Annotated[float, Range(-1.0, 1.0)]
UnboundedPositive = Annotated[float, Range(0.0, above=True, infinite=True)]
Count = Annotated[int, Range(0)]
PositiveCount = Annotated[int, Range(1)]
Array3 = Annotated["np.ndarray", ArrayShape((3,))]
Array33 = Annotated["np.ndarray", ArrayShape((3, 3))]
UnitVector = Annotated[tuple[float, float, float], Normalised()]


class _Arguments:
    """Arguments of one class or function: names, kinds, and errors for wrong ones."""

    def __init__(self, called: Callable[..., Any], target: Any) -> None:
        self.owner, self.keeps = target.__qualname__.removesuffix(".__init__"), isinstance(target, type)
        self.signature, hints = inspect.signature(called), annotations_of(target)
        parameters = self.signature.parameters.values()
        self.takes_more = any(each.kind is each.VAR_POSITIONAL for each in parameters)
        self.takes_any_name = any(each.kind is each.VAR_KEYWORD for each in parameters)
        single = [each for each in parameters if each.kind not in (each.VAR_POSITIONAL, each.VAR_KEYWORD)]
        self.placed = [each.name for each in single if each.kind is not each.KEYWORD_ONLY]
        self.needed = [each.name for each in single if each.default is each.empty]
        self.kinds = {each.name: kind_of(hints.get(each.name, Any), self.keeps) for each in single}
        self.named = [name for name in self.kinds if name not in ("self", "cls")]

    def of(self, given: tuple[Any, ...], named: dict[str, Any]) -> tuple[list[Any], dict[str, Any]]:
        """Return checked and converted arguments of a call. Raises `InputError`."""
        self.require_known(named)
        placed = dict(zip(self.placed, given, strict=False))
        if placed.keys() & named.keys() or (len(given) > len(placed) and not self.takes_more):
            try:
                self.signature.bind(*given, **named)
            except TypeError as error:
                raise InputError(f"{self.owner}: {error}", f"allowed: {', '.join(self.named)}") from None
        values = self.check(placed | named)
        missing = [name for name in self.needed if name not in values]
        if missing:
            allowed = f"allowed, for {missing[0]}: {self.kinds[missing[0]].text}"
            raise InputError(f"{self.owner} needs {', '.join(missing)}", allowed)
        return [*(values.pop(name) for name in placed), *given[len(placed) :]], values

    def check(self, values: Mapping[str, Any]) -> dict[str, Any]:
        """Return checked and converted arguments by name. Raises `InputError`."""
        kinds = self.kinds
        try:
            return {name: kinds.get(name, ANY).accept(value, name) for name, value in values.items()}
        except (ValueError, RefusedError):
            pass  # checked again below, with a message
        called = values.get("name") if self.keeps else None
        owner = f"{self.owner} '{called}'" if isinstance(called, str) else self.owner
        return {name: kinds.get(name, ANY).checked(name, owner, value) for name, value in values.items()}

    def require_known(self, names: Mapping[str, Any]) -> None:
        """Raise `InputError` for a name that is not an argument."""
        for name in names:
            if name not in self.kinds and not self.takes_any_name:
                raise not_among(self.named, name, f"{self.owner} has no argument '{name}'")


def checked(target: _Target) -> _Target:
    """Check the arguments of a dataclass or a function against their annotations.

    Sequences become tuples, and arrays in dataclasses become read-only, also after pickling. A single name
    counts as a sequence of one.

    Raises:
        InputError: If it is called with an argument that is wrong, missing or unknown.
    """
    original: Any = getattr(target, "__init__") if isinstance(target, type) else target  # noqa: B009
    arguments = functools.cache(lambda: _Arguments(original, target))

    @functools.wraps(original)
    def call(*given: Any, **named: Any) -> Any:
        placed, by_name = arguments().of(given, named)
        return original(*placed, **by_name)

    if not isinstance(target, type):
        return call  # type: ignore[return-value]
    target.__init__ = call  # type: ignore[misc]
    return picklable(target)


def check_settings(function: Callable[..., Any], settings: Mapping[str, Any]) -> None:
    """Check some of the arguments of a function before it is called. Raises `InputError`."""
    arguments = _Arguments(inspect.unwrap(function), inspect.unwrap(function))
    arguments.require_known(settings)
    arguments.check(settings)


def check_fields(thing: Any) -> None:
    """Check the fields of an existing dataclass, such as a user-defined term. Raises `InputError`."""
    target: Any = type(thing)
    for name, kind in kinds_of_fields(target).items():
        kind.checked(name, target.__name__, getattr(thing, name))


@functools.cache
def kinds_of_fields(target: Any) -> dict[str, Kind]:
    """Return the kinds of a dataclass's fields by name."""
    hints = annotations_of(target)
    return {name: kind_of(hints[name], True) for name in target.__dataclass_fields__}


def annotations_of(target: Any) -> dict[str, Any]:
    """Return annotations of a class's fields or a function's arguments; unresolved names become Any."""
    hints = {}
    for owner in reversed(target.__mro__) if isinstance(target, type) else [inspect.unwrap(target)]:
        names = _Names(_globals_of(owner))
        for name, hint in inspect.get_annotations(owner).items():
            hints[name] = _evaluated(hint, names) if isinstance(hint, str) else hint
    return hints


def _globals_of(owner: Any) -> dict[str, Any]:
    """Return the global names at the definition of a class or function, also in a file that is no module."""
    if not isinstance(owner, type):
        return owner.__globals__
    if owner.__module__ in sys.modules:
        return vars(sys.modules[owner.__module__])
    methods = (each for each in vars(owner).values() if inspect.isfunction(each))
    return next((each.__globals__ for each in methods), {})


def _evaluated(hint: str, names: _Names) -> Any:
    try:
        return eval(hint, {}, names)
    except Exception:  # names that only a type checker resolves
        return Any


class _Names(dict[str, Any]):
    """Names of a module; unknown names resolve to builtins or Any."""

    def __missing__(self, name: str) -> Any:
        return getattr(builtins, name, Any)
