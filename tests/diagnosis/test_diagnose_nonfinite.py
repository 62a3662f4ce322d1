"""The first value or slope that is not finite is found with its term, its place and its input."""

from dataclasses import dataclass, replace

import casadi as ca
import numpy as np
import pytest

from tests.support.problems import hop, reach
from trajopt.diagnosis.diagnose import diagnose
from trajopt.diagnosis.diagnosis import Diagnosis
from trajopt.robot.units import Units
from trajopt.solving.solving import prepare, solve
from trajopt.terms import Context, Cost, NodeConstraint, NodePlace, PointConstraint, Rows


@dataclass(frozen=True, kw_only=True)
class RootOfPosition(PointConstraint):
    """The root of a joint's position less ``least``: no number where the joint is below it."""

    joint: int = -1
    least: float = 0.5

    def rows(self, context: Context, units: Units) -> Rows:
        return Rows.create(ca.sqrt(context.xi[self.joint] - self.least), 0, np.inf, 1.0)


@dataclass(frozen=True, kw_only=True)
class SpeedCost(Cost):
    """The length of the joints' rates, not squared: no slope at rest."""

    def residual(self, context: Context, units: Units) -> ca.SX:
        return ca.sqrt(ca.norm_2(context.dxi[-2:]))


@dataclass(frozen=True, kw_only=True)
class LogOfForce(PointConstraint):
    """The logarithm of a contact's normal force less half the weight."""

    def rows(self, context: Context, units: Units) -> Rows | None:
        if not context.contacts:
            return None
        force = context.wrenches["foot"][2] / units.force
        return Rows.create(ca.log(force - 2.0), -np.inf, np.inf, 1.0)


@dataclass(frozen=True, kw_only=True)
class RootOfHeight(NodeConstraint):
    """The root of a foot's height less a metre, at the middle of the flight."""

    def acts_at(self, place: NodePlace) -> bool:
        return place.phase.name == "flight" and place.index == 1

    def rows(self, context: Context, units: Units, place: NodePlace) -> Rows:
        return Rows.create(ca.sqrt(context.frame("foot").position[2] - 10.0), 0, np.inf, 1.0)


def with_term(term: object) -> Diagnosis:
    problem = hop()
    return diagnose(prepare(replace(problem, terms=(*problem.terms, term))))


def test_a_root_of_a_negative_number_names_term_place_and_joint():
    found = with_term(RootOfPosition(during="flight")).nonfinite
    assert found is not None
    assert (found.output, found.terms, found.phase) == ("rows", ("root_of_position",), "flight")
    assert found.point == 0
    assert [entry.name for entry in found.inputs] == ["shank position"]
    assert found.inputs[0].value == pytest.approx(0.0, abs=0.5)
    assert "shank position" in found.row


def test_a_slope_without_value_names_the_cost_and_the_rates():
    found = with_term(SpeedCost(weight=1.0, during="landing")).nonfinite
    assert found is not None
    assert found.terms == ("speed_cost",)
    assert found.output in ("gradient", "jacobian", "hessian")
    assert {entry.name for entry in found.inputs} == {"hip rate", "shank rate"}
    assert found.phase == "landing"


def test_a_logarithm_of_a_force_names_the_contact():
    found = with_term(LogOfForce(during="stance")).nonfinite
    assert found is not None
    assert found.terms == ("log_of_force",)
    assert [entry.name for entry in found.inputs] == ["foot force z"]


def test_a_node_term_is_found_at_its_node():
    found = with_term(RootOfHeight()).nonfinite
    assert found is not None
    assert (found.terms, found.phase, found.point) == (("root_of_height",), "flight", None)
    assert "base z position" in [entry.name for entry in found.inputs]


def test_an_unknown_that_is_no_number_is_named_itself():
    prepared = prepare(hop())
    names = diagnose(prepared)
    assert names.nonfinite is None
    wrong = prepared.guess.copy()
    layout = prepared.transcription.layout
    phase, k = 1, int(layout.intervals_of(1)[0])
    window = np.arange(layout.n_unknowns)[layout.window(k)]
    wrong[window[layout.local_derivative(phase, 0)[-1]]] = np.nan
    found = diagnose(replace(prepared, guess=wrong))
    assert found.nonfinite is not None
    assert [entry.name for entry in found.nonfinite.inputs] == ["shank acceleration"]
    assert found.max_violation is None
    assert found.ranks == ()
    assert any("the guess itself is not finite" in advice.remedy for advice in found.advice)


def test_a_solve_that_cannot_start_is_diagnosed_from_its_solution():
    problem = reach()
    broken = replace(problem, terms=(*problem.terms, RootOfPosition(least=0.2)))
    solution = solve(broken)
    assert solution.statistics.status == "not_finite"
    found = diagnose(solution, broken)
    assert found.nonfinite is not None
    assert [entry.name for entry in found.nonfinite.inputs] == ["joint position"]
    assert "root_of_position" in str(found)
