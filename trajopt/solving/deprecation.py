"""The argument ``compile`` that public functions had, accepted for one more version."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from functools import wraps
from typing import ParamSpec, TypeVar

_Arguments = ParamSpec("_Arguments")
_Returned = TypeVar("_Returned")


def accepts_compile(function: Callable[_Arguments, _Returned]) -> Callable[_Arguments, _Returned]:
    """The function, with an argument ``compile`` that has no effect but a `DeprecationWarning`."""

    @wraps(function)
    def accepting(*arguments: _Arguments.args, **settings: _Arguments.kwargs) -> _Returned:
        if settings.pop("compile", None) is not None:
            text = "functions are no longer compiled by a C compiler: leave out compile"
            warnings.warn(text, DeprecationWarning, stacklevel=2)
        return function(*arguments, **settings)

    return accepting
