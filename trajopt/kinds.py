"""Kinds of values, one for each annotation: what is accepted, how it is converted, how it is described."""

import collections.abc
import math
import sys
import types
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from numbers import Integral, Real
from typing import Annotated, Any, Literal, TypeVar, Union, get_args, get_origin

from trajopt.errors import InputError, not_among, numbers_of, shown, with_article

# How to make values of a class for which users often pass a name or a path.
MADE_BY = {
    "Problem": "trajopt.load({name!r})",
    "Robot": "trajopt.robot({name!r})",
    "Moment": "start_of({name!r}), middle_of({name!r}) or end_of({name!r})",
    "Solution": "trajopt.Solution.load({name!r})",
}
NAMES = "a name, or a sequence of names"
UNIT_VECTOR = "3 finite numbers, not all 0"
SERIES = (list, tuple, collections.abc.Sequence, collections.abc.Collection, collections.abc.Iterable)


@dataclass(frozen=True)
class Range:
    """Range of a number.

    Args:
        least: Lower bound.
        most: Upper bound.
        above: Whether the lower bound is excluded.
        infinite: Whether inf is allowed.
    """

    least: float = -math.inf
    most: float = math.inf
    above: bool = False
    infinite: bool = False

    def holds(self, value: float) -> bool:
        """Return whether a number is within the range; NaN never is."""
        if math.isinf(value) and not self.infinite:
            return False
        return self.least <= value <= self.most and not (self.above and value == self.least)

    @property
    def text(self) -> str:
        """The range in words, empty if unbounded."""
        if math.isfinite(self.most):
            return f" from {self.least:g} to {self.most:g}"
        return f" {'>' if self.above else '>='} {self.least:g}" if math.isfinite(self.least) else ""


@dataclass(frozen=True)
class ArrayShape:
    """Shape of an array, with None for any size along an axis; no NaN, and no inf unless ``infinite``."""

    sizes: tuple[int | None, ...] | None = None
    infinite: bool = False

    def holds(self, array: Any) -> bool:
        """Return whether an array has the shape and only allowed numbers."""
        import numpy as np  # deferred, also below: it is only needed for arrays

        sizes = self.sizes
        if sizes is not None and (
            len(sizes) != array.ndim
            or any(w not in (None, n) for w, n in zip(sizes, array.shape, strict=True))
        ):
            return False
        return not np.isnan(array).any() if self.infinite else bool(np.isfinite(array).all())

    @property
    def text(self) -> str:
        """The shape in words."""
        word = "numbers" if self.infinite else "finite numbers"
        match self.sizes:
            case None:
                return f"an array of {word}"
            case (int(n),):
                return f"{n} {word}"
        return f"an array of {word} of shape ({', '.join('n' if n is None else str(n) for n in self.sizes)})"


class Normalised:
    """Mark of a vector of three numbers that becomes a unit vector."""


class RefusedError(Exception):
    """A refused value or part of one: its place in the argument, the value, and what is allowed."""

    def __init__(self, place: str, value: Any, allowed: str) -> None:
        self.place, self.value, self.allowed = place, value, allowed
        super().__init__(place)


@dataclass(frozen=True)
class Kind:
    """Values of one annotation.

    Args:
        text: What is allowed, in words.
        accept: Maps a value and its place to the converted value; raises `ValueError` if it is wrong, or
            `RefusedError` if a part of it is.
        hint: Maps a value to a suggestion, or an empty string.
    """

    text: str
    accept: Callable[[Any, str], Any]
    hint: Callable[[Any], str] = lambda value: ""

    def __call__(self, value: Any, place: str) -> Any:
        """Return the converted value. Raises `RefusedError`."""
        try:
            return self.accept(value, place)
        except ValueError:
            raise RefusedError(place, value, f"allowed: {self.text}{self.hint(value)}") from None

    def checked(self, name: str, owner: str, value: Any) -> Any:
        """Return the converted value. Raises `InputError` that begins with the argument's name."""
        try:
            return self(value, name)
        except RefusedError as wrong:
            raise InputError(f"{wrong.place} of {owner} is {shown(wrong.value)}", wrong.allowed) from None


ANY = Kind("any value", lambda value, place: value)


def kind_of(hint: Any, keeps: bool) -> Kind:
    """Return the kind of an annotation; with ``keeps``, arrays are kept and become read-only copies."""
    origin, parts = get_origin(hint), get_args(hint)
    general = origin or hint
    if origin is Annotated:
        mark = parts[1]
        if isinstance(mark, Range):
            return _number(parts[0], mark)
        return Kind(UNIT_VECTOR, _unit_vector) if isinstance(mark, Normalised) else _array(mark, keeps)
    if hint in (Any, object) or isinstance(hint, TypeVar):
        return ANY
    if hint in (None, type(None)):
        return _that("None", lambda value: value is None)
    if origin in (Union, types.UnionType):
        return _union(parts, keeps)
    if origin is Literal:
        return _literal(parts)
    if hint in (float, int):
        return _number(hint, Range())
    if hint is bool:
        return _that(
            "True or False", lambda value: isinstance(value, (bool, _numpy("numpy", "bool_") or bool))
        )
    if hint is str:
        return _that("a string", lambda value: isinstance(value, str))
    if general is collections.abc.Callable:
        return _that("a function", callable)
    if origin is type:
        return _that("a class", lambda value: isinstance(value, type))
    if general is _numpy("numpy", "ndarray"):
        return _array(ArrayShape(), keeps)
    if origin is tuple and parts[1:] != (Ellipsis,):
        return _tuple(parts, keeps)
    if origin in SERIES:
        return _several(parts[0], list if origin is list else tuple, keeps)
    if isinstance(origin, type) and issubclass(origin, Mapping):
        return _mapping(kind_of(parts[0], keeps), kind_of(parts[1], keeps))
    return _instance(general) if isinstance(general, type) else ANY


def _numpy(module: str, name: str) -> Any:
    """Return an object of NumPy, or None if NumPy is not imported and no annotation can refer to it."""
    return getattr(sys.modules.get(module), name, None)


def _require(right: bool) -> None:
    if not right:
        raise ValueError


def _that(text: str, holds: Callable[[Any], bool], hint: Callable[[Any], str] = lambda value: "") -> Kind:
    """Return the kind of values for which ``holds`` is true; they are not converted."""

    def accept(value: Any, place: str) -> Any:
        if holds(value):
            return value
        raise ValueError

    return Kind(text, accept, hint)


def _number(hint: type, span: Range) -> Kind:
    base = Integral if hint is int else Real
    word = "a whole number" if hint is int else "a number" if span.infinite else "a finite number"
    return _that(
        word + span.text,
        lambda value: isinstance(value, base) and not isinstance(value, bool) and span.holds(float(value)),
    )


def _literal(values: tuple[Any, ...]) -> Kind:
    names = [str(each) for each in values]

    def accept(value: Any, place: str) -> Any:
        if any(type(value) is type(each) and value == each for each in values):
            return value
        likely = value if isinstance(value, str) else ""
        raise RefusedError(place, value, not_among(names, likely, "").allowed)

    def meant(value: Any) -> str:
        likely = not_among(names, value, "").allowed if isinstance(value, str) else ""
        return f"; {likely.partition('?')[0]}?" if likely.startswith("did you mean") else ""

    return Kind(", ".join(names), accept, meant)


def _instance(kind: Any) -> Kind:
    name = kind.__name__
    protocol = getattr(kind, "_is_protocol", False)
    members = [member for member in vars(kind) if protocol and not member.startswith("_")]

    def holds(value: Any) -> bool:
        if not protocol:
            return isinstance(value, kind)
        return (
            not isinstance(value, type)
            and all(hasattr(value, each) for each in members)
            and (callable(value) or "__call__" not in vars(kind))
        )

    def made_by(value: Any) -> str:
        if name not in MADE_BY or not (isinstance(value, str) or name == "Moment"):
            return ""
        return f", for example {MADE_BY[name].format(name=value if isinstance(value, str) else '...')}"

    methods = f" (an object with {members[0]}())" if len(members) == 1 else ""
    return _that(with_article(kind) + methods, holds, made_by)


def _union(hints: tuple[Any, ...], keeps: bool) -> Kind:
    parts = frozenset(get_args(_numpy("numpy.typing", "ArrayLike")))  # itself a union
    arrays = parts if set(hints) >= parts else frozenset()
    kinds = [kind_of(each, keeps) for each in hints if each not in arrays]
    kinds += [_array(ArrayShape(), keeps)] if arrays else []
    texts = {kind.text: None for kind in kinds}
    if NAMES in texts:
        texts.pop("a string", None)

    def accept(value: Any, place: str) -> Any:
        inner: RefusedError | None = None
        for kind in kinds:
            try:
                return kind.accept(value, place)
            except ValueError:
                pass
            except RefusedError as wrong:
                inner = inner or (wrong if wrong.place != place else None)
        raise inner or ValueError

    def meant(value: Any) -> str:
        return next(filter(None, (kind.hint(value) for kind in kinds)), "")

    in_order = sorted(texts, key=lambda text: (text == "None", text == NAMES))
    return Kind(" or ".join(in_order), accept, meant)


def _require_series(value: Any) -> None:
    """Raise `ValueError` unless a value is an ordered collection and not a string."""
    _require(not isinstance(value, str | bytes | Mapping) and hasattr(value, "__iter__"))
    _require(getattr(value, "ndim", 1) == 1)


def _several(hint: Any, build: Callable[[list[Any]], Any], keeps: bool) -> Kind:
    """Return the kind of sequences of one kind; a single name counts as a sequence of one."""
    kind, names = kind_of(hint, keeps), hint is str

    def accept(value: Any, place: str) -> Any:
        if names and isinstance(value, str):
            return build([value])
        _require_series(value)
        return build([kind(each, f"{place}[{index}]") for index, each in enumerate(value)])

    return Kind(NAMES if names else f"a sequence, each {kind.text}", accept)


def _tuple(hints: tuple[Any, ...], keeps: bool) -> Kind:
    kinds = [kind_of(each, keeps) for each in hints]
    numbers = all(each is float for each in hints)

    def accept(value: Any, place: str) -> Any:
        _require_series(value)
        values = list(value)
        _require(len(values) == len(kinds))
        try:
            return tuple(kind(values[index], f"{place}[{index}]") for index, kind in enumerate(kinds))
        except RefusedError:
            _require(not numbers)  # numbers are refused as a whole
            raise

    texts = [kind.text for kind in kinds]
    if numbers:
        return Kind(f"{len(kinds)} finite numbers", accept)
    alike = len(texts) > 1 and len(set(texts)) == 1
    return Kind(f"{len(texts)}, each {texts[0]}" if alike else f"({', '.join(texts)})", accept)


def _mapping(keys: Kind, values: Kind) -> Kind:
    def accept(value: Any, place: str) -> Any:
        _require(isinstance(value, Mapping))
        try:
            for key in value:
                keys.accept(key, place)
            parts = {key: values.accept(part, place) for key, part in value.items()}
        except (ValueError, RefusedError):  # repeated to name the wrong part
            for key in value:
                keys(key, f"a key of {place}")
            parts = {key: values(part, f"{place}[{key!r}]") for key, part in value.items()}
        return value if all(parts[key] is part for key, part in value.items()) else parts

    return Kind(f"a mapping of {keys.text} to {values.text}", accept)


def _unit_vector(value: Any, place: str) -> tuple[float, ...]:
    import numpy as np

    vector = numbers_of(value)
    _require(vector.shape == (3,) and bool(np.isfinite(vector).all()) and bool(vector.any()))
    return tuple((vector / np.linalg.norm(vector)).tolist())


def _array(shape: ArrayShape, keeps: bool) -> Kind:
    """Return the kind of arrays: kept arrays become read-only copies, lists become float arrays."""

    def accept(value: Any, place: str) -> Any:
        import numpy as np

        _require(not isinstance(value, str | bytes | bool) and value is not None)
        try:
            array = value if isinstance(value, np.ndarray) else np.array(value)
            _require(array.dtype.kind in "fiub")
            array = array if array is value else array.astype(float)
        except Exception:  # from a user-defined conversion
            raise ValueError from None
        if not shape.holds(array):
            raise RefusedError(place, value if np.isfinite(array).all() else array, f"allowed: {shape.text}")
        if keeps and array.flags.writeable:
            array = array.copy() if array is value else array
            array.setflags(write=False)
        return array

    return Kind(shape.text, accept)
