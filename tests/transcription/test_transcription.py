"""The sparse NLP of a problem: derivatives, rows, scales, bounds; redundant contact rows; wrong terms."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import pinocchio as pin
import pytest
from numpy.testing import assert_allclose

import trajopt
from tests.support.derivatives import Matrices, assert_derivatives, random_unknowns
from tests.support.problems import SCHEME_ORDERS, hop, hopper, lean, reach
from tests.support.redundant_contacts import corners, solo, solo_hop
from trajopt import InputError, Phase, Problem, Schedule
from trajopt.certify.report import AT_POINTS
from trajopt.solving.solving import prepare, solve
from trajopt.terms import (
    AccelerationCost,
    Cost,
    NodeConstraint,
    PostureCost,
    Rows,
    TorqueCost,
    TorqueLimits,
    WrenchCost,
)
from trajopt.transcription import transcribe
from trajopt.transcription.nlp import Nlp
from trajopt.transcription.redundancy import independent_rows
from trajopt_library import problems, robots

# The identity block comes out of divisions of scales by themselves.
ROUNDING = 1e-12
PROBLEMS = {"hop": hop, "sole": lambda: hop("surface"), "reach": lambda: reach(gravity=True, terms=ALL_COSTS)}
ALL_COSTS = (TorqueCost(weight=1.0), AccelerationCost(weight=0.1), TorqueLimits(limit=np.array([30.0])))


@lru_cache
def nlp_of(name: str, transcription: str) -> Nlp:
    problem = PROBLEMS[name]() if name in PROBLEMS else problems.load(name)
    return prepare(problem, transcription=transcription, intervals=6).nlp


@pytest.mark.long
@pytest.mark.parametrize("transcription", SCHEME_ORDERS)
@pytest.mark.parametrize("name", PROBLEMS)
def test_derivatives_of_the_whole_nlp_equal_differences(name, transcription):
    assert_derivatives(nlp_of(name, transcription), seed=0)


@pytest.mark.parametrize("transcription", ["legendre:2", "hermite-simpson"])
def test_derivatives_of_a_quadruped_jump_equal_differences(transcription):
    assert_derivatives(nlp_of("solo12-jump", transcription), seed=1)


@pytest.mark.parametrize("transcription", SCHEME_ORDERS)
def test_next_state_enters_its_gap_rows_with_an_identity_block(transcription):
    nlp = nlp_of("hop", transcription)
    t = nlp.transcription
    jacobian = Matrices(nlp).jacobian(random_unknowns(t, 3))
    for k in range(t.layout.n_intervals):
        block = jacobian[t.gap_rows[k]][:, t.layout.node(k + 1)].toarray()
        assert_allclose(block, np.eye(t.layout.forms[0].size), atol=ROUNDING)
        outside = jacobian[t.gap_rows[k]][:, int(t.layout.node_offset[k + 1]) + t.layout.forms[0].size :]
        assert outside.nnz == 0


def test_every_row_depends_on_its_own_stage_and_gap_rows_on_the_next_state():
    nlp = nlp_of("hop", "legendre:2")
    t = nlp.transcription
    column_stage = np.searchsorted(t.layout.node_offset, nlp.column, side="right") - 1
    later = column_stage - t.rows.stage[nlp.row]
    gap = np.isin(nlp.row, np.concatenate(t.gap_rows))
    assert set(later[gap]) == {0, 1}
    assert set(later[~gap]) == {0}


def test_rows_of_a_stage_are_gaps_then_points_then_node():
    t = nlp_of("hop", "legendre:2").transcription
    assert np.all(np.diff(t.rows.stage) >= 0)
    for k in range(t.layout.n_intervals):
        stage = np.flatnonzero(t.rows.stage == k)
        n = t.layout.forms[0].size
        assert_allclose(stage[:n], t.gap_rows[k])
        points = t.rows.point[stage[n:]]
        kinds = np.where(points < 0, t.layout.scheme_of(0).s, points)  # rows at the node come last
        assert np.all(np.diff(kinds) >= 0)
        assert set(points) >= {0, 1}


def test_inactive_contact_makes_no_unknown_and_no_row():
    t = transcribe(hop(terms=()), "legendre:2", 8)
    layout, robot = t.layout, hopper()
    n, landing = layout.forms[0].size, int(layout.intervals_of(2)[0])
    counts = np.bincount(t.rows.stage, minlength=layout.n_intervals + 1) - n
    for k, phase in enumerate(layout.phase_of):
        touching = len(layout.contacts[phase])
        unknowns = layout.node_offset[k + 1] - layout.node_offset[k]
        assert unknowns == n + 2 * (robot.nv + 3 * touching)
        landing_rows = 4 if k == landing else 0  # height and velocity of the new contact
        assert counts[k] == 2 * (robot.n_unactuated + 3 * touching) + landing_rows


def test_intervals_are_shared_by_duration_with_one_for_each_phase_at_least():
    schedule = Schedule(tuple(Phase(name=str(i), duration=d) for i, d in enumerate((0.1, 0.3, 1.6))))
    assert schedule.intervals(20) == (1, 3, 16)
    assert schedule.intervals(3) == (1, 1, 1)
    assert [sum(schedule.intervals(total)) for total in range(3, 60)] == list(range(3, 60))
    layout = transcribe(hop(), "legendre:1", 16).layout
    assert layout.intervals == (6, 4, 6)
    assert layout.node_times[-1] == pytest.approx(0.8)


@pytest.mark.parametrize("intervals", [2, 0, -5])
def test_fewer_intervals_than_phases_are_refused(intervals):
    with pytest.raises(InputError, match=f"{intervals} intervals for 3 phases; allowed: at least 3"):
        transcribe(hop(), "legendre:1", intervals)


@pytest.mark.parametrize("intervals", [10.0, "10", True])
def test_number_of_intervals_that_is_no_whole_number_is_refused(intervals):
    with pytest.raises(InputError, match="allowed: a whole number"):
        transcribe(hop(), "legendre:1", intervals)


def test_number_of_intervals_may_come_out_of_an_array():
    assert transcribe(hop(), "legendre:1", np.arange(9)[8]).layout.n_intervals == 8


def test_start_is_fixed_and_limits_bound_the_later_nodes():
    problem = hop()
    t = transcribe(problem, "legendre:1", 8)
    layout, robot = t.layout, problem.robot
    start = layout.coordinates.node_from_pinocchio(problem.initial_q, problem.initial_v)
    assert_allclose(t.lower_x[layout.node(0)] * t.scale[layout.node(0)], start)
    assert_allclose(t.upper_x[layout.node(0)], t.lower_x[layout.node(0)])
    upper = t.upper_x[layout.node(3)] * t.scale[layout.node(3)]
    assert_allclose(upper[layout.forms[0].rates][6:], robot.velocity_limit[6:])
    assert_allclose(upper[layout.forms[0].additive][3:], robot.position_upper[7:])
    assert np.all(np.isinf(upper[:7]))
    assert np.all(np.isinf(upper[layout.forms[0].rates][:6]))
    controls = slice(layout.node(3).stop, layout.node(4).start)
    assert np.all(np.isinf([t.lower_x[controls], t.upper_x[controls]]))


def test_unknowns_are_measured_in_weight_length_and_time_of_the_robot():
    t = transcribe(hop(), "legendre:1", 8)
    layout, robot = t.layout, hopper()
    unit_time = np.sqrt(robot.length / 9.81)
    node, window = t.scale[layout.node(0)], t.scale[layout.node_offset[0] : layout.node_offset[1]]
    assert_allclose(node[:4], 1.0)
    assert_allclose(node[4:9], [robot.length] * 3 + [1.0, robot.length])
    assert_allclose(node[layout.forms[0].rates][[0, 3]], [robot.length / unit_time, 1 / unit_time])
    assert_allclose(window[layout.local_derivative(0, 0)][[0, 3]], [9.81, 9.81 / robot.length])
    assert_allclose(window[layout.local_wrench(0, 0)], robot.weight)


def heavier(problem: Problem, factor: float) -> Problem:
    """The same problem for a robot whose masses, inertias and efforts are ``factor`` times as large."""
    model = problem.robot.model.copy()
    for i in range(model.njoints):
        inertia = model.inertias[i]
        model.inertias[i] = pin.Inertia(factor * inertia.mass, inertia.lever, factor * inertia.inertia)
    model.armature = factor * model.armature
    limit = factor * problem.robot.torque_limit
    return replace(problem, robot=replace(problem.robot, model=model, torque_limit=limit))


def test_optimum_in_natural_units_does_not_depend_on_the_mass():
    options = {"transcription": "legendre:2", "intervals": 8, "tolerance": 1e-8}
    light, heavy = (solve(problem, **options) for problem in (lean(), heavier(lean(), 40.0)))
    assert [light.converged, heavy.converged] == [True, True]
    assert heavy.statistics.objective == pytest.approx(light.statistics.objective, rel=1e-6)
    assert_allclose(heavy.q, light.q, atol=1e-4)
    assert_allclose(heavy.f / 40.0, light.f, atol=1e-3 * hopper().weight)


def test_dynamics_and_contact_rows_are_there_without_being_asked_for():
    t = transcribe(hop(terms=()), "legendre:1", 8)
    assert {"defect", "base_dynamics", "contact_acceleration", "contact_landing"} == set(t.rows.names)


@pytest.mark.parametrize(
    ("scheme", "bounded"),
    [("legendre:2", [1, 2, 3, 4]), ("radau:2", []), ("hermite-simpson", []), ("semi-implicit-euler", [4])],
)
def test_nodes_that_coincide_with_a_point_get_no_second_limit(scheme, bounded):
    t = transcribe(problems.load("ur5-reach"), scheme, 4)
    finite = [k for k in range(1, 5) if np.any(np.isfinite(t.upper_x[t.layout.node(k)]))]
    assert finite == bounded


# The price of the wrenches themselves differs between one sole and four corners: a millionth of the torques'.
SAME_OPTIMUM = 1e-5
# Singular values of independent rows in natural units, far above those of dependent ones (1e-10).
INDEPENDENT = 1e-6


def smallest_singular_value(problem: Problem) -> float:
    """Of the equality rows near the guess."""
    nlp = prepare(problem, intervals=6).nlp
    t = nlp.transcription
    x = trajopt.transcription.guess.perturbed(t, trajopt.transcription.guess.initial_guess(t), 0, 1e-2)
    jacobian = nlp.jacobian(x).toarray()
    equal, free = t.lower_g == t.upper_g, t.lower_x < t.upper_x
    return float(np.linalg.svd(jacobian[equal][:, free], compute_uv=False)[-1])


def test_feet_on_legs_in_parallel_planes_keep_two_lateral_rows():
    kept = independent_rows(solo(), solo().reference, (), solo().contacts)
    assert [len(rows) for rows in kept.values()] == [3, 2, 3, 2]
    assert all({0, 2} <= set(rows) for rows in kept.values())


@pytest.mark.long
def test_hop_on_redundant_feet_has_independent_rows_and_solves():
    problem = solo_hop()
    assert smallest_singular_value(problem) > INDEPENDENT
    solution = trajopt.solve(problem, intervals=20)
    assert solution.converged
    assert solution.statistics.iterations <= 60
    assert solution.statistics.redundant_contact_rows == {
        "stance": ["FR_FOOT y", "HR_FOOT y"],
        "landing": ["FR_FOOT y", "HR_FOOT y"],
    }
    assert trajopt.check(solution).within(AT_POINTS)


@pytest.mark.parametrize("name", ["solo12-jump", "talos-wall", "hopper-hop", "solo12-slope", "ur5-pull"])
def test_contacts_that_are_independent_keep_all_rows(name):
    problem = problems.load(name)
    for index, phase in enumerate(problem.schedule.phases):
        contacts = [problem.robot.contact(contact) for contact in phase.contacts]
        q = problem.guess(sum(p.duration for p in problem.schedule.phases[:index]) + phase.duration / 2)
        kept = independent_rows(problem.robot, q, (), contacts)
        assert kept == {contact.name: contact.rows for contact in contacts}


def test_straight_legs_are_singular_by_posture_and_keep_their_rows():
    robot = robots.load("solo12")
    q = robot.reference.copy()
    q[7:] = 0.0
    assert independent_rows(robot, q, (), robot.contacts) == {c.name: c.rows for c in robot.contacts}


def test_four_corners_of_a_foot_keep_six_rows_and_three_heights():
    robot = corners()
    kept = independent_rows(robot, robot.reference, (), robot.contacts)
    assert sum(len(rows) for rows in kept.values()) == 6
    assert sum(2 in rows for rows in kept.values()) == 3


def test_rows_of_contacts_that_held_before_are_kept_first():
    robot = corners()
    last = robot.contacts[3]
    kept = independent_rows(robot, robot.reference, (last,), robot.contacts[:3])
    assert kept[last.name] == (0, 1, 2)
    assert sum(len(rows) for rows in kept.values()) == 6


@pytest.mark.long
@pytest.mark.parametrize("family", ["biped-gait", "biped-run"])
@pytest.mark.parametrize("robot", ["talos", "g1"])
def test_soles_that_roll_have_independent_rows_through_every_phase(family, robot):
    """From heel to flat, from flat to toe and over the end: edges that hold are not imposed again."""
    problem = problems.load(family, robot=robot, feet="heel-toe")
    assert smallest_singular_value(problem) > INDEPENDENT


@pytest.mark.long
def test_foot_of_corners_moves_its_robot_like_a_sole():
    """Standing, to another posture, cheapest in torque: how corners share the sole's wrench costs nothing."""
    optima = []
    for robot in (hop("surface").robot, corners()):
        names = tuple(contact.name for contact in robot.contacts)
        posture = robot.reference.copy()
        posture[-2:] += [0.1, -0.05]
        terms = (TorqueCost(weight=1.0), PostureCost(weight=10.0, q=posture), WrenchCost(weight=1e-7))
        stance = Schedule((Phase(name="stance", duration=0.5, contacts=names),))
        problem = hop("surface", robot=robot, schedule=stance, terms=terms)
        assert smallest_singular_value(problem) > INDEPENDENT
        solution = trajopt.solve(problem, intervals=8)
        assert solution.converged
        assert trajopt.check(solution).contact_acceleration < 1e-6  # of all twelve rows
        optima.append(solution.statistics.objective)
    assert optima[1] == pytest.approx(optima[0], rel=SAME_OPTIMUM)


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
    assert f"in {Path(__file__).name}, line " in said
    for made, meant in (
        (lambda context: context.velocities, "context.v"),
        (lambda context: context.frame("tool0").velocities, "velocity"),
    ):
        assert f"; did you mean {meant}? in" in refused(problem, OwnCost(weight=1.0, made=made))


@pytest.mark.parametrize("setting", [{"tolerance": "1e-6"}, {"max_iterations": 0.5}, {"toleranc": 1e-6}])
def test_settings_of_a_solve_are_checked_before_it_begins(problem, setting):
    with pytest.raises(InputError, match=rf"\b{next(iter(setting))}\b"):
        trajopt.solve(problem, **setting)


def test_fields_of_an_own_term_are_checked_by_the_problem(problem):
    with pytest.raises(InputError, match="made of OwnRows is 3; allowed: a function"):
        replace(problem, terms=(*problem.terms, OwnRows(made=3)))
