"""Pickling and copying of problems, robots and solutions, beyond what works for plain fields.

Read-only mappings are pickled as dictionaries. Values of a `cached_property` are left out and recomputed on
demand. Arrays become read-only again afterwards.
"""

import copyreg
from functools import cached_property
from types import MappingProxyType
from typing import Any, TypeVar

_Class = TypeVar("_Class", bound=type)


def picklable(target: _Class) -> _Class:
    """Make instances of a frozen dataclass pickle and copy, unless the class defines how."""
    if not hasattr(target, "__setstate__"):
        given: Any = target
        given.__getstate__, given.__setstate__ = _state, _restore
    return target


def _state(thing: Any) -> dict[str, Any]:
    kind = type(thing)
    kept = (name for name in vars(thing) if not isinstance(getattr(kind, name, None), cached_property))
    return {name: vars(thing)[name] for name in kept}


def _restore(thing: Any, state: dict[str, Any]) -> None:
    vars(thing).update(state)
    _protect(tuple(state.values()))


def _protect(value: Any) -> None:
    """Make arrays read-only, also those in tuples and read-only mappings."""
    if type(value).__module__ == "numpy" and hasattr(value, "setflags"):
        value.setflags(write=False)
    elif isinstance(value, tuple | MappingProxyType):
        for each in value.values() if isinstance(value, MappingProxyType) else value:
            _protect(each)


def _proxy(content: dict[Any, Any]) -> MappingProxyType[Any, Any]:
    return MappingProxyType(content)


def _reduced(proxy: MappingProxyType[Any, Any]) -> tuple[Any, ...]:
    return _proxy, (dict(proxy),)


copyreg.pickle(MappingProxyType, _reduced)
