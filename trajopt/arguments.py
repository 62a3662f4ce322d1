"""Arguments of public classes and functions, checked against their annotations in one line each.

`checked` is the one mechanism: it reads the annotations of a dataclass's fields or of a function at the first
call. Besides Python's own types it knows the ranges and shapes below, which stand in a field's own line.
"""

from __future__ import annotations

import builtins
import functools
import inspect
import sys
from collections.abc import Callable, Mapping
from typing import Annotated, Any, TypeVar

from trajopt.errors import InputError, not_among
from trajopt.kinds import Kind, Range, kind_of

_Target = TypeVar("_Target", bound=Callable[..., Any])

# Numbers are finite, and neither True nor False; these have a range, or may be infinite.
Positive = Annotated[float, Range(0.0, above=True)]
NonNegative = Annotated[float, Range(0.0)]
Fraction = Annotated[float, Range(0.0, 1.0)]
Unbounded = Annotated[float, Range(infinite=True)]
UnboundedPositive = Annotated[float, Range(0.0, above=True, infinite=True)]
Measured = Annotated[float, Range(infinite=True, unknown=True)]
Count = Annotated[int, Range(0)]
PositiveCount = Annotated[int, Range(1)]


class _Arguments:
    """The arguments of one class or function: their names and kinds, and what is said of wrong ones."""

    def __init__(self, called: Callable[..., Any], target: Any) -> None:
        self.owner, self.keeps = target.__qualname__.removesuffix(".__init__"), isinstance(target, type)
        self.parameters = dict(inspect.signature(called).parameters)
        if self.keeps:
            del self.parameters["self"]
        listed = list(self.parameters.values())
        self.takes_more = any(each.kind is each.VAR_POSITIONAL for each in listed)
        self.takes_any_name = any(each.kind is each.VAR_KEYWORD for each in listed)
        single = [each for each in listed if each.kind not in (each.VAR_POSITIONAL, each.VAR_KEYWORD)]
        self.placed = [each.name for each in single if each.kind is not each.KEYWORD_ONLY]
        bound = ("self", "cls")
        self.named = [e.name for e in single if e.kind is not e.POSITIONAL_ONLY and e.name not in bound]
        self.needed = [each.name for each in single if each.default is each.empty]
        hints = annotations_of(target)
        self.kinds = {each.name: kind_of(hints.get(each.name, Any)) for each in single}

    def of(self, given: tuple[Any, ...], named: dict[str, Any]) -> tuple[tuple[Any, ...], dict[str, Any]]:
        """The arguments of a call as they are handed on. Raises `InputError`."""
        if len(given) > len(self.placed) and not self.takes_more:
            what = f"{self.owner} is given {len(given)} arguments without a name"
            raise InputError(what, f"allowed: {len(self.placed)}, all by name: {', '.join(self.named)}")
        placed = self.placed[: len(given)]
        for name in set(placed) & named.keys():
            raise InputError(f"{name} of {self.owner} is given twice", "allowed: once")
        by_name = self.check(named)
        values = [self._value(name, value, self.owner) for name, value in zip(placed, given, strict=False)]
        missing = [name for name in self.needed if name not in named and name not in placed]
        if missing:
            allowed = f"allowed, for {missing[0]}: {self.kinds[missing[0]].text}"
            raise InputError(f"{self.owner} needs {', '.join(missing)}", allowed)
        return (*values, *given[len(values) :]), by_name

    def check(self, named: Mapping[str, Any]) -> dict[str, Any]:
        """Arguments by name as they are handed on. Raises `InputError`."""
        for name in named:
            if name not in self.named and not self.takes_any_name:
                raise not_among(self.named, name, f"{self.owner} has no argument '{name}'")
        called = named.get("name") if self.keeps else None
        owner = f"{self.owner} '{called}'" if isinstance(called, str) else self.owner
        return {name: self._value(name, value, owner) for name, value in named.items()}

    def _value(self, name: str, value: Any, owner: str) -> Any:
        kind = self.kinds.get(name)
        return value if kind is None else kind.checked(name, owner, value, self.keeps)


def checked(target: _Target) -> _Target:
    """Check the arguments of a dataclass, or of a function, against their annotations.

    Sequences become tuples, and arrays in dataclasses read-only; a single name stands for a sequence of one.

    Raises:
        InputError: where it is called with an argument that is wrong, missing or not known.
    """
    original: Any = getattr(target, "__init__") if isinstance(target, type) else target  # noqa: B009
    arguments = functools.cache(lambda: _Arguments(original, target))

    if not isinstance(target, type):

        @functools.wraps(original)
        def call(*given: Any, **named: Any) -> Any:
            values, by_name = arguments().of(given, named)
            return original(*values, **by_name)

        return call  # type: ignore[return-value]

    @functools.wraps(original)
    def make(self: Any, *given: Any, **named: Any) -> None:
        values, by_name = arguments().of(given, named)
        original(self, *values, **by_name)

    target.__init__ = make  # type: ignore[misc]
    return target


def check_settings(function: Callable[..., Any], settings: Mapping[str, Any]) -> None:
    """Check arguments that are handed on to a function, which needs more. Raises `InputError`."""
    _arguments_of(inspect.unwrap(function)).check(settings)


@functools.cache
def _arguments_of(function: Callable[..., Any]) -> _Arguments:
    return _Arguments(function, function)


def check_fields(thing: Any) -> None:
    """Check the fields of a dataclass that is made already, such as a term of the user's own."""
    target: Any = type(thing)
    for name, kind in _kinds(target).items():
        kind.checked(name, target.__name__, getattr(thing, name), True)


@functools.cache
def _kinds(target: Any) -> dict[str, Kind]:
    hints = annotations_of(target)
    return {name: kind_of(hints[name]) for name in target.__dataclass_fields__}


def annotations_of(target: Any) -> dict[str, Any]:
    """Annotations of a class's fields or a function's arguments; names for type checkers alone become Any."""
    found = {}
    for owner in reversed(target.__mro__) if isinstance(target, type) else [inspect.unwrap(target)]:
        names = _Names(_globals_of(owner))
        for name, hint in inspect.get_annotations(owner).items():
            found[name] = _evaluated(hint, names) if isinstance(hint, str) else hint
    return found


def _globals_of(owner: Any) -> dict[str, Any]:
    """Names where a class or function was defined, which may be a file that is no known module."""
    if not isinstance(owner, type):
        return owner.__globals__
    module = sys.modules.get(owner.__module__)
    if module is not None:
        return vars(module)
    methods = (each for each in vars(owner).values() if inspect.isfunction(each))
    return next((each.__globals__ for each in methods), {})


def _evaluated(hint: str, names: _Names) -> Any:
    try:
        return eval(hint, {}, names)
    except Exception:  # of names that are known to a type checker alone
        return Any


class _Names(dict[str, Any]):
    """Names of a module, or Any."""

    def __missing__(self, name: str) -> Any:
        if name.startswith("__"):
            raise KeyError(name)
        return getattr(builtins, name, Any)
