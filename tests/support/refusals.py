"""Bad input in Python: an `InputError` of one line."""

import re
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import pytest

from trajopt import InputError


@contextmanager
def refused(pattern: str) -> Iterator[None]:
    """What is done within raises an error of one line in which ``pattern`` is found."""
    with pytest.raises(InputError, match=pattern) as caught:
        yield
    assert "\n" not in str(caught.value)


def assert_refused_in_one_line(make: Callable[[], object], words: str) -> None:
    """``make()`` raises an error of one line that has the ``words``."""
    with refused(re.escape(words)):
        make()


def refusals(make: Callable[..., object], *cases: tuple) -> Callable[..., None]:
    """A test of cases ``(*arguments, pattern)``: ``make(*arguments)`` is refused, with the pattern."""

    @pytest.mark.parametrize("case", cases, ids=[case[-1] for case in cases])
    def test(case: tuple) -> None:
        *arguments, pattern = case
        with refused(pattern):
            make(*arguments)

    return test


def refused_calls(*cases: tuple[Callable[[], object], str]) -> Callable[..., None]:
    """A test of cases ``(call, pattern)``: ``call()`` is refused, with the pattern."""
    return refusals(lambda call: call(), *cases)
