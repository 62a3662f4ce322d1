"""The sparse NLP of a problem: derivatives, rows, unknowns, scales, bounds."""

from dataclasses import replace
from functools import lru_cache

import numpy as np
import pinocchio as pin
import pytest
from numpy.testing import assert_allclose

from tests.support.derivatives import Matrices, assert_derivatives, random_unknowns
from tests.support.problems import SCHEME_ORDERS, hop, hopper, lean, reach
from trajopt.errors import InputError
from trajopt.problem.problem import Problem
from trajopt.schedule.schedule import Phase, Schedule
from trajopt.solving.solving import prepare, solve
from trajopt.terms import AccelerationCost, TorqueCost, TorqueLimits
from trajopt.transcription.nlp import Nlp
from trajopt.transcription.transcription import transcribe
from trajopt_library import problems

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
