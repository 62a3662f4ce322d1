"""Terms of the user's own that return what they may not: errors name the term and what is expected."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import casadi as ca
import numpy as np
import pytest

import trajopt
from trajopt.errors import InputError
from trajopt.terms import Cost, NodeConstraint, Rows
from trajopt.transcription import transcribe

FOREIGN = ca.SX.sym("foreign")


@dataclass(frozen=True, kw_only=True)
class OwnCost(Cost):
    made: Callable[[Any], Any]

    def residual(self, context, units):
        return self.made(context)


@dataclass(frozen=True, kw_only=True)
class OwnRows(NodeConstraint):
    made: Callable[[Any], Any]

    def rows(self, context, units, place):
        return self.made(context)


@pytest.fixture(scope="module")
def problem():
    return trajopt.load("ur5-reach")


def refused(problem, term) -> str:
    with pytest.raises(InputError) as caught:
        transcribe(replace(problem, terms=(*problem.terms, term)))
    assert len(str(caught.value).splitlines()) == 1
    return str(caught.value)


@pytest.mark.parametrize("result", [None, 1.0, "a", np.ones(3), ca.MX.sym("m"), (1, 2), ca.SX(2, 3)])
def test_a_residual_that_is_no_column_is_refused_with_the_costs_name(problem, result):
    said = refused(problem, OwnCost(weight=1.0, made=lambda context: result))
    assert "own_cost in phase" in said
    assert "column (n,) of type casadi.SX" in said


@pytest.mark.parametrize("result", [None, 1.0, "a", np.ones(3), ca.MX.sym("m"), (1, 2)])
def test_rows_that_are_none_are_refused_with_the_terms_name(problem, result):
    said = refused(problem, OwnRows(made=lambda context: result))
    assert "own_rows in phase" in said
    assert "Rows.create" in said


@pytest.mark.parametrize("bounds", [([0, 1], 1, 1), (0, None, 1), (0, 1, None), (0, "a", 1), (2, 1, 1)])
def test_bounds_of_another_length_or_kind_are_refused(problem, bounds):
    assert "own_rows in phase" in refused(problem, OwnRows(made=lambda c: Rows.create(c.xi, *bounds)))


def test_symbols_that_are_not_of_the_context_are_named(problem):
    for term in (
        OwnCost(weight=1.0, made=lambda context: FOREIGN),
        OwnRows(made=lambda context: Rows.create(FOREIGN, 0, 1, 1)),
    ):
        assert "depends on foreign, which the context does not have" in refused(problem, term)


def test_what_fails_in_a_term_names_file_and_line(problem):
    said = refused(problem, OwnCost(weight=1.0, made=lambda context: context.nothing))
    assert "own_cost" in said
    assert "in test_term_results.py, line " in said


@pytest.mark.parametrize("setting", [{"tolerance": "1e-6"}, {"max_iterations": 0.5}, {"toleranc": 1e-6}])
def test_settings_of_a_solve_are_checked_before_it_begins(problem, setting):
    with pytest.raises(InputError, match=rf"\b{next(iter(setting))}\b"):
        trajopt.solve(problem, **setting)


def test_fields_of_an_own_term_are_checked_by_the_problem(problem):
    with pytest.raises(InputError, match="made of OwnRows is 3; allowed: a function"):
        replace(problem, terms=(*problem.terms, OwnRows(made=3)))
