"""Kinds of values that annotations stand for: what is accepted, how it is kept, how it is put in words."""

from __future__ import annotations

import collections.abc
import math
import types
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from numbers import Integral, Real
from typing import TYPE_CHECKING, Annotated, Any, Literal, TypeVar, Union, get_args, get_origin

from trajopt.errors import InputError, not_among

if TYPE_CHECKING:
    import numpy as np

# A given value is shown up to this many characters, in one line.
SHOWN = 60
# How values of a class are made, where a name or a path is a likely mistake for one.
MADE_BY = {
    "Problem": "trajopt.load({name!r})",
    "Robot": "trajopt.robot({name!r})",
    "Moment": "start_of({name!r}), middle_of({name!r}) or end_of({name!r})",
    "Solution": "trajopt.Solution.load({name!r})",
}


@dataclass(frozen=True)
class Range:
    """Range of a number.

    Args:
        least: lower bound.
        most: upper bound.
        above: whether the lower bound is excluded.
        infinite: whether inf is allowed.
        unknown: whether NaN is allowed: what was measured, or could not be.
    """

    least: float = -math.inf
    most: float = math.inf
    above: bool = False
    infinite: bool = False
    unknown: bool = False

    def holds(self, value: float) -> bool:
        """Whether a number is within the range."""
        if math.isnan(value):
            return self.unknown
        if math.isinf(value) and not self.infinite:
            return False
        return self.least <= value <= self.most and not (self.above and value == self.least)

    @property
    def text(self) -> str:
        """The range in words, empty where it has no bounds."""
        if self.least == -math.inf:
            return ""
        if math.isfinite(self.most):
            return f" from {self.least:g} to {self.most:g}"
        return f" {'>' if self.above else '>='} {self.least:g}"


@dataclass(frozen=True)
class ArrayShape:
    """Shape of an array, None for any size along an axis; inf and NaN are allowed as in `Range`."""

    sizes: tuple[int | None, ...] | None = None
    infinite: bool = False
    unknown: bool = False

    def holds(self, array: np.ndarray) -> bool:
        """Whether an array has the shape, and numbers that are allowed."""
        import numpy as np  # here as below: the command line is loaded before arrays are needed

        wanted = array.shape if self.sizes is None else self.sizes
        if len(wanted) != array.ndim or any(
            w not in (None, n) for n, w in zip(array.shape, wanted, strict=True)
        ):
            return False
        wrong = ~np.isfinite(array) if not self.infinite else np.isnan(array)
        return self.unknown or not bool(wrong.any())


@dataclass(frozen=True)
class Kind:
    """Values of one annotation.

    Args:
        text: what is allowed, in words.
        accept: value, and whether it is kept -> the value as it is handed on; raises `ValueError` for a wrong
            one, or `InputError` where a part of it is wrong.
        hint: value -> what may have been meant, or nothing.
    """

    text: str
    accept: Callable[[Any, bool], Any]
    hint: Callable[[Any], str] = lambda value: ""

    def checked(self, name: str, owner: str, value: Any, keeps: bool) -> Any:
        """The value as it is handed on. Raises `InputError` that begins with the name of the argument."""
        try:
            return self.accept(value, keeps)
        except _PartError as part:
            raise InputError(f"{name}{part.where} of {owner} is {shown(part.value)}", part.allowed) from None
        except ValueError:
            raise InputError(
                f"{name} of {owner} is {shown(value)}", f"allowed: {self.text}{self.hint(value)}"
            ) from None


NAMES = "a name, or a sequence of names"
ANY = Kind("any value", lambda value, keeps: value)


class _PartError(ValueError):
    """A part of a value is wrong."""

    def __init__(self, where: str, value: Any, allowed: str) -> None:
        self.where, self.value, self.allowed = where, value, allowed
        super().__init__(where)


def shown(value: Any) -> str:
    """A value in one line, cut where it is long."""
    try:
        text = " ".join(repr(value).split())
    except Exception:  # a repr of the user's own
        text = ""
    if not text or (text.startswith("<") and "object at 0x" in text):
        name = type(value).__name__
        return f"{'an' if name[0] in 'aeiouAEIOU' else 'a'} {name}"
    return text if len(text) <= SHOWN else text[: SHOWN - 3] + "..."


def kind_of(hint: Any) -> Kind:
    """The kind of an annotation."""
    origin, parts = get_origin(hint), get_args(hint)
    if origin is Annotated:
        return _annotated(parts[0], parts[1])
    if hint in (Any, object) or isinstance(hint, TypeVar):
        return ANY
    if hint is None or hint is type(None):
        return Kind("None", lambda value, keeps: _only(value is None, value))
    if origin in (Union, types.UnionType):
        return _union(parts)
    if origin is Literal:
        return _literal(parts)
    if hint in (float, int):
        return _number(hint, Range())
    if hint is bool:
        return Kind("True or False", lambda value, keeps: _only(_is_bool(value), value))
    if hint is str:
        return Kind("a string", lambda value, keeps: _only(isinstance(value, str), value))
    if origin is tuple:
        return _tuple(parts)
    if isinstance(origin, type) and issubclass(origin, collections.abc.Mapping):
        return _mapping(*parts)
    if origin is collections.abc.Callable:
        return Kind("a function", lambda value, keeps: _only(callable(value), value))
    if origin in (collections.abc.Sequence, collections.abc.Collection, collections.abc.Iterable, list):
        return _several(parts[0], list if origin is list else tuple)
    if (getattr(hint, "__module__", "") == "numpy" and hint.__name__ == "ndarray") or _is_array(origin):
        return _array(ArrayShape())
    if origin is type:
        return Kind("a class", lambda value, keeps: _only(isinstance(value, type), value))
    kind = origin or hint
    return _instance(kind) if isinstance(kind, type) else ANY


def _is_array(origin: Any) -> bool:
    return getattr(origin, "__name__", "") == "ndarray"


def _is_bool(value: Any) -> bool:
    return isinstance(value, bool) or type(value).__name__ in ("bool_", "bool")


def _only(right: bool, value: Any) -> Any:
    if not right:
        raise ValueError
    return value


def _annotated(hint: Any, mark: Any) -> Kind:
    if isinstance(mark, Range):
        return _number(hint, mark)
    return _array(mark) if isinstance(mark, ArrayShape) else kind_of(hint)


def _number(hint: type, span: Range) -> Kind:
    base = Integral if hint is int else Real
    word = "a whole number" if hint is int else "a number" if span.infinite else "a finite number"

    def accept(value: Any, keeps: bool) -> Any:
        return _only(isinstance(value, base) and not _is_bool(value) and span.holds(float(value)), value)

    return Kind(word + span.text, accept)


def _literal(values: tuple[Any, ...]) -> Kind:
    def accept(value: Any, keeps: bool) -> Any:
        return _only(any(type(value) is type(each) and value == each for each in values), value)

    def meant(value: Any) -> str:
        near = not_among([str(each) for each in values], value, "") if isinstance(value, str) else None
        return f"; {near.allowed.partition('?')[0]}?" if near is not None and "?" in near.allowed else ""

    return Kind(", ".join(str(each) for each in values), accept, meant)


def _instance(kind: Any) -> Kind:
    name = kind.__name__
    article = "an" if name[0] in "aeiouAEIOU" else "a"

    def hint(value: Any) -> str:
        known = MADE_BY.get(name) if isinstance(value, str) or name == "Moment" else None
        return (
            f", for example {known.format(name=value if isinstance(value, str) else '...')}" if known else ""
        )

    return Kind(f"{article} {name}", lambda value, keeps: _only(_is_a(value, kind), value), hint)


def _is_a(value: Any, kind: Any) -> bool:
    if getattr(kind, "_is_protocol", False):
        members = [name for name in vars(kind) if not name.startswith("_")]
        called = "__call__" in vars(kind)
        return all(hasattr(value, name) for name in members) and (callable(value) or not called)
    return isinstance(value, kind)


def _union(hints: tuple[Any, ...]) -> Kind:
    from numpy.typing import ArrayLike

    general = set(get_args(ArrayLike))
    arrays = [_array(ArrayShape())] if general <= set(hints) else []
    kinds = [kind_of(each) for each in hints if not (arrays and each in general)]
    if any(kind.text == NAMES for kind in kinds):
        kinds = [kind for kind in kinds if kind.text not in ("a string", NAMES)] + [
            Kind(NAMES, kind.accept) for kind in kinds if kind.text in ("a string", NAMES)
        ]
    kinds = [kind for kind in kinds if kind.text != "None"] + arrays + [k for k in kinds if k.text == "None"]

    def accept(value: Any, keeps: bool) -> Any:
        inner: _PartError | None = None
        for kind in kinds:
            try:
                return kind.accept(value, keeps)
            except _PartError as part:
                inner = inner or part
            except ValueError:
                continue
        raise inner or ValueError

    def meant(value: Any) -> str:
        return next((found for found in (kind.hint(value) for kind in kinds) if found), "")

    return Kind(" or ".join(dict.fromkeys(kind.text for kind in kinds)), accept, meant)


def _parts(kind: Kind, values: Any, keeps: bool) -> list[Any]:
    found = []
    for index, value in enumerate(values):
        found.append(_part(kind, f"[{index}]", value, keeps))
    return found


def _part(kind: Kind, where: str, value: Any, keeps: bool) -> Any:
    try:
        return kind.accept(value, keeps)
    except _PartError as part:
        raise _PartError(where + part.where, part.value, part.allowed) from None
    except ValueError:
        raise _PartError(where, value, f"allowed: {kind.text}{kind.hint(value)}") from None


def _is_series(value: Any) -> bool:
    """Whether a value has parts in an order, and is no string."""
    wrong = isinstance(value, str | bytes | Mapping) or not hasattr(value, "__iter__")
    return not wrong and getattr(value, "ndim", 1) == 1


def _several(hint: Any, build: Callable[[list[Any]], Any]) -> Kind:
    """Any number of one kind; a single name stands for a sequence of one."""
    kind, names = kind_of(hint), hint is str

    def accept(value: Any, keeps: bool) -> Any:
        if names and isinstance(value, str):
            return build([value])
        return build(_parts(kind, _only(_is_series(value), value), keeps))

    return Kind(NAMES if names else f"a sequence, each {kind.text}", accept)


def _tuple(hints: tuple[Any, ...]) -> Kind:
    if len(hints) == 2 and hints[1] is Ellipsis:
        return _several(hints[0], tuple)
    kinds = [kind_of(each) for each in hints]
    numbers = all(each is float for each in hints)
    text = f"{len(kinds)} finite numbers" if numbers else f"({', '.join(kind.text for kind in kinds)})"

    def accept(value: Any, keeps: bool) -> Any:
        values = list(_only(_is_series(value), value))
        _only(len(values) == len(kinds), value)
        if numbers:
            return tuple(kind.accept(each, keeps) for kind, each in zip(kinds, values, strict=True))
        return tuple(
            _part(kind, f"[{index}]", each, keeps)
            for index, (kind, each) in enumerate(zip(kinds, values, strict=True))
        )

    return Kind(text, accept)


def _mapping(key: Any, value: Any) -> Kind:
    keys, values = kind_of(key), kind_of(value)

    def accept(given: Any, keeps: bool) -> Any:
        _only(isinstance(given, Mapping), given)
        for each in given:
            _part(keys, f" (a key of it: {shown(each)})", each, keeps)
        found = {each: _part(values, f"[{each!r}]", part, keeps) for each, part in given.items()}
        return given if all(found[each] is part for each, part in given.items()) else found

    return Kind(f"a mapping of {keys.text} to {values.text}", accept)


def _array(shape: ArrayShape) -> Kind:
    """Arrays of numbers: kept ones become read-only copies, lists arrays of floats."""
    import numpy as np

    def accept(value: Any, keeps: bool) -> Any:
        _only(not isinstance(value, str | bytes | bool) and value is not None, value)
        try:
            array = value if isinstance(value, np.ndarray) else np.array(value)
            numbers = array.dtype.kind in "fiub"
            array = array if array is value or not numbers else array.astype(float)
        except Exception:  # a conversion of the user's own
            raise ValueError from None
        _only(numbers and shape.holds(array), value)
        if keeps and array.flags.writeable:
            array = array.copy() if array is value else array
            array.setflags(write=False)
        return array

    sizes = shape.sizes
    many = "" if sizes is None else f" of shape ({', '.join('n' if n is None else str(n) for n in sizes)})"
    text = f"{sizes[0]} " if sizes is not None and len(sizes) == 1 and sizes[0] else ""
    word = "numbers" if shape.infinite else "finite numbers"
    return Kind(text + word if text else f"an array of {word}{many}", accept)
