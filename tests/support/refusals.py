"""Bad input in Python: an `InputError` of one line."""

from collections.abc import Callable

import pytest

from trajopt import InputError


def assert_refused_in_one_line(make: Callable[[], object], words: str) -> None:
    """``make()`` raises an error of one line that has the ``words``."""
    with pytest.raises(InputError) as caught:
        make()
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)
