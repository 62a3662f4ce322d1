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
