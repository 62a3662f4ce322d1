"""The argument ``compile`` of earlier versions: accepted, with a warning."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from typing import Any

import pytest
from numpy.testing import assert_array_equal

import trajopt
from tests.support.problems import reach
from trajopt.errors import InputError
from trajopt.solving.reference import converged_reference

# Calls that end in an error at once.
REFUSED: dict[str, Callable[..., Any]] = {
    "continuation": lambda **settings: trajopt.continuation(lambda value: reach(), [], **settings),
    "solve_ladder": lambda **settings: trajopt.solve_ladder(reach(), [], **settings),
    "diagnose": lambda **settings: trajopt.diagnose("missing.npz", **settings),
    "converged_reference": lambda **settings: converged_reference(reach(), max_time=0.0, **settings),
}


def test_compile_has_no_effect_but_one_warning_at_the_call():
    with pytest.warns(
        DeprecationWarning, match="no longer compiled by a C compiler: leave out compile"
    ) as told:
        solution = trajopt.solve(reach(), intervals=4, compile="quick")
    assert [warning.filename for warning in told] == [__file__]
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert_array_equal(trajopt.solve(reach(), intervals=4).q, solution.q)


@pytest.mark.parametrize("function", REFUSED.values(), ids=REFUSED.keys())
def test_public_functions_accept_compile(function: Callable[..., Any]):
    with pytest.warns(DeprecationWarning, match="leave out compile"), pytest.raises(InputError):
        function(compile="none")
