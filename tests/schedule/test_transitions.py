"""Free durations, impacts and sources of velocity: stages and nodes beyond plain intervals."""

import math
from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from numpy.testing import assert_allclose

import trajopt
from tests.support.derivatives import Matrices, assert_derivatives, random_unknowns
from tests.support.problems import (
    FOOT,
    REACH,
    hop,
    hopper,
    landing,
    lean,
    one_joint_arm,
    phases,
    reach,
    still,
)
from tests.support.refusals import refused_calls
from trajopt import InputError, Moment, Phase, Problem, Schedule, terms
from trajopt.certify.report import AT_POINTS
from trajopt.dynamics import contact_jacobian
from trajopt.solving.solving import prepare
from trajopt.transcription.nlp import Nlp
from trajopt.transcription.timeline import StageKind
from trajopt_library import problems

pytestmark = pytest.mark.long

# What a solver leaves in rows that are met to 1e-7 of their units.
SOLVED = 1e-5
# A bang-bang input has its switch within an interval: the optimum is met to the length of one, squared.
SWITCH = 2e-3


def moving_start() -> Problem:
    """The pushed hopper with a free duration: its start moves, whatever the time scale."""
    phase = Phase(name="stance", duration=0.1, contacts=(FOOT,), duration_bounds=(0.05, 0.3))
    return replace(lean(), schedule=Schedule((phase,)))


VARIANTS = {
    "free": lambda: landing(free=True),
    "impact": lambda: landing(impact=True),
    "free impact": lambda: landing(free=True, impact=True),
    "velocity": still,
    "moving start": moving_start,
}


def nlp_of(name: str, scheme: str = "legendre:2") -> Nlp:
    return prepare(VARIANTS[name](), transcription=scheme, intervals=6).nlp


@pytest.mark.parametrize("scheme", ["legendre:2", "hermite-simpson"])
@pytest.mark.parametrize("name", VARIANTS)
def test_derivatives_of_the_whole_nlp_equal_differences(name, scheme):
    if name == "velocity" and scheme == "hermite-simpson":
        scheme = "radau:2"  # statics at both ends of an interval say everything twice
    nlp = nlp_of(name, scheme)
    layout = nlp.transcription.layout
    time_scales = np.concatenate(
        [
            np.arange(layout.node(k).start, layout.node(k).stop)[form.time_scales]
            for k, form in enumerate(layout.forms)
        ]
    )
    assert_derivatives(nlp, seed=0, ones=time_scales.astype(int))


@pytest.mark.parametrize("name", VARIANTS)
def test_next_state_enters_its_gap_rows_with_an_identity_block(name):
    nlp = nlp_of(name)
    t = nlp.transcription
    x = random_unknowns(t, 3)
    for k, form in enumerate(t.layout.forms):
        x[t.layout.node(k)][form.time_scales] = 1.1
    jacobian = Matrices(nlp).jacobian(x)
    for k in range(t.layout.n_stages):
        block = jacobian[t.gap_rows[k]][:, t.layout.node(k + 1)].toarray()
        assert_allclose(block, np.eye(t.layout.forms[k + 1].size), atol=1e-12)


def test_stages_between_phases_are_only_those_that_are_needed():
    kinds = {
        name: [stage.kind for stage in nlp_of(name).transcription.layout.stages if stage.step == 0.0]
        for name in VARIANTS
    }
    assert kinds == {
        "free": [StageKind.CHANGE, StageKind.CHANGE],
        "impact": [StageKind.IMPACT],
        "free impact": [StageKind.CHANGE, StageKind.IMPACT, StageKind.CHANGE],
        "velocity": [],
        "moving start": [],
    }


def test_velocity_source_has_neither_rates_nor_torques_nor_accelerations():
    layout = nlp_of("velocity").transcription.layout
    nv, foot = hopper().nv, 3
    assert layout.forms[0].size == 4 + 5
    assert layout.n_control(0) == 2 * (nv + foot)
    arm = replace(
        reach(terms=(terms.VelocityCost(weight=1.0),)),
        terms=(terms.VelocityCost(weight=1.0),),
        actuation="velocity",
    )
    names = prepare(arm, intervals=4).transcription.rows.names
    assert names == ("defect",)


@pytest.mark.parametrize(
    ("term", "lacks"),
    [
        (terms.TorqueCost(weight=1.0), "torques"),
        (terms.TorqueLimits(), "torques"),
        (terms.AccelerationCost(weight=1.0), "accelerations"),
    ],
)
def test_terms_that_a_velocity_source_cannot_have_are_refused(term, lacks):
    with pytest.raises(InputError, match=f"asks for {lacks}, which a source of velocity does not have"):
        prepare(replace(still(), terms=(term,)), intervals=2)


def test_acceleration_source_has_accelerations_but_no_torques():
    problem = replace(reach(), actuation="acceleration")
    assert trajopt.solve(problem, fixed_mesh=True).converged
    with pytest.raises(InputError, match="asks for torques, which a source of acceleration does not have"):
        trajopt.solve(replace(problem, terms=(terms.TorqueCost(weight=1.0),)), fixed_mesh=True)


def test_minimum_time_of_a_double_integrator_is_that_of_full_torque_both_ways():
    """Without gravity a joint of inertia I turns by an angle in T = 2 sqrt(I angle / torque)."""
    torque = 30.0
    model = one_joint_arm().model
    inertia = pin.crba(model, model.createData(), np.zeros(1))[0, 0]
    all_terms = (terms.TimeCost(weight=1.0), terms.TorqueLimits(limit=np.array([torque])))
    problem = reach(terms=all_terms)
    phase = replace(problem.schedule.phases[0], duration_bounds=(0.05, 3.0))
    solution = trajopt.solve(replace(problem, schedule=Schedule((phase,))), intervals=20)
    assert solution.converged
    exact = 2 * math.sqrt(inertia * REACH / torque)
    assert solution.meta["durations"] == pytest.approx([exact], rel=SWITCH)
    assert solution.t[-1] == pytest.approx(solution.meta["durations"][0])
    assert trajopt.check(solution).within(AT_POINTS)


def test_velocity_limits_hold_at_nodes_of_a_free_duration():
    robot = replace(one_joint_arm(), velocity_limit=np.array([2.0]))
    problem = reach(
        terms=(terms.TimeCost(weight=1.0), terms.AccelerationCost(weight=1e-3), terms.VelocityLimits())
    )
    phase = replace(problem.schedule.phases[0], duration_bounds=(0.05, 3.0))
    solution = trajopt.solve(replace(problem, robot=robot, schedule=Schedule((phase,))), intervals=12)
    assert solution.converged
    assert np.abs(solution.v).max() == pytest.approx(2.0, rel=SOLVED)


def test_duration_keeps_within_its_bounds_and_a_fixed_one_is_a_free_one_without_room():
    fixed = trajopt.solve(landing(), intervals=10)
    narrow = tuple(
        replace(phase, duration_bounds=(phase.duration, phase.duration))
        for phase in landing().schedule.phases
    )
    free = trajopt.solve(replace(landing(), schedule=Schedule(narrow)), intervals=10)
    assert [fixed.converged, free.converged] == [True, True]
    assert free.statistics.objective == pytest.approx(fixed.statistics.objective, rel=SOLVED)
    assert_allclose(free.q, fixed.q, atol=1e-3)


def test_start_that_moves_keeps_its_velocity_whatever_the_duration():
    solution = trajopt.solve(moving_start(), intervals=6)
    assert solution.converged
    assert_allclose(solution.v[0], moving_start().initial_v, atol=SOLVED)
    assert solution.meta["durations"][0] != pytest.approx(0.1)


def test_impact_obeys_its_law_and_loses_energy():
    problem = landing(impact=True)
    solution = trajopt.solve(problem, intervals=16)
    assert solution.converged
    model, after = solution.model, int(solution.impact_index[0])
    q, before, behind = solution.q[after], solution.v[after - 1], solution.v[after]
    assert_allclose(solution.q[after - 1], q, atol=1e-12)
    mass = pin.crba(model, model.createData(), q)
    jacobian = contact_jacobian(model, q, [(FOOT, 3)])
    impulse = solution.impulse[0, 0, :3]
    assert_allclose(mass @ (behind - before), jacobian.T @ impulse, atol=SOLVED)
    assert_allclose(jacobian @ behind, 0.0, atol=SOLVED)
    assert np.linalg.norm(jacobian @ before) > 0.01
    assert np.hypot(*impulse[:2]) <= 0.7 * impulse[2] + SOLVED
    assert behind @ mass @ behind < before @ mass @ before


def test_landing_with_an_impact_is_never_worse_than_at_zero_velocity():
    """Zero foot velocity is an impact without impulse: a larger set of motions."""
    soft = trajopt.solve(landing(), intervals=16)
    hard = trajopt.solve(replace(landing(impact=True), terms=hop().terms), intervals=16)
    assert hard.statistics.objective < soft.statistics.objective


@pytest.mark.parametrize(
    "bounds", [(0.0, 1.0), (0.5, 0.2), (0.6, 1.0), (0.1, math.inf), (math.nan, 1.0), 0.5, ("a", "b")]
)
def test_duration_bounds_that_make_no_sense_are_refused(bounds):
    with pytest.raises(InputError, match=r"duration_bounds of [pP]hase 'p'"):
        Phase(name="p", duration=0.5, duration_bounds=bounds)


def test_kinematic_reach_of_an_arm_solves_with_less_than_a_dynamic_one():
    dynamic = problems.load("ur5-reach")
    keep = [term for term in dynamic.terms if type(term).__name__ in ("FramePose", "PositionLimits")]
    kinematic = replace(
        dynamic, actuation="velocity", terms=(terms.VelocityCost(weight=1.0), terms.VelocityLimits(), *keep)
    )
    sizes = [prepare(p).transcription.layout.n_unknowns for p in (dynamic, kinematic)]
    assert sizes[1] < sizes[0]
    solution = trajopt.solve(kinematic, fixed_mesh=True)
    assert solution.converged
    # Least squares of rates between two postures is a straight line in the joints.
    line = np.linspace(solution.q[0], solution.q[-1], 31)
    nodes = solution.q[np.searchsorted(solution.t, np.linspace(0, solution.t[-1], 31) - 1e-9)]
    assert_allclose(nodes, line, atol=1e-3)


def bounded(problem: Problem, scheme: str = "legendre:1") -> dict[int, tuple[bool, bool]]:
    """Nodes with bounds or rows of limits: of positions, of rates; the start left out."""
    t = prepare(problem, transcription=scheme, intervals=6).transcription
    found = {}
    for k, form in enumerate(t.layout.forms[1:], start=1):
        finite = np.isfinite(t.upper_x[t.layout.node(k)])
        rates = finite[form.rates].any() or any(
            t.rows.names[b] == "velocity_limits" and s == k and p < 0
            for b, s, p in zip(t.rows.block, t.rows.stage, t.rows.point, strict=True)
        )
        if finite[form.additive].any() or rates:
            found[k] = (bool(finite[form.additive].any()), bool(rates))
    return found


def limited(schedule: Schedule, *phases: str) -> Problem:
    return hop(
        schedule=schedule, terms=(terms.PositionLimits(during=phases), terms.VelocityLimits(during=phases))
    )


def test_limits_of_a_phase_hold_at_its_nodes_whatever_lies_between_phases():
    """Two intervals a phase: nodes 2 and 4 end stance and flight; changes of time scale add one each."""
    both = (True, True)
    fixed, free = phases(free=False, impact=False), phases(free=True, impact=False)
    assert bounded(limited(fixed, "flight")) == {2: both, 3: both, 4: both}
    assert bounded(limited(free, "flight")) == {3: both, 4: both, 6: both}


def test_limits_across_an_impact_are_those_of_each_side():
    schedule = phases(free=False, impact=True)
    assert bounded(limited(schedule, "flight")) == {2: (True, True), 3: (True, True), 4: (True, True)}
    assert bounded(limited(schedule, "landing")) == {5: (True, True), 6: (True, True), 7: (True, True)}
    assert bounded(limited(schedule, "flight", "landing"))[5] == (False, True)


def test_limits_of_a_scheme_with_a_point_at_the_end_are_not_repeated_after_a_change():
    assert bounded(limited(phases(free=True, impact=False), "flight"), "radau:2") == {3: (True, True)}


@pytest.mark.parametrize("fraction", [0.0, 0.5, 1.0])
def test_frame_height_acts_at_one_node_of_its_phase(fraction):
    for impact in (False, True):
        raised = terms.FrameHeight(frame=FOOT, height=0.0, at=Moment("flight", fraction))
        problem = hop(schedule=phases(free=False, impact=impact), terms=(raised,))
        rows = prepare(problem, intervals=6).transcription.rows
        assert np.sum(rows.block == rows.names.index("frame_height")) == 1


test_impacts_and_sources_of_velocity_need_contacts = refused_calls(
    (
        lambda: Schedule(
            (Phase(name="down", duration=1.0, contacts=(FOOT,)), Phase(name="up", duration=1.0, impact=True))
        ),
        "'up' begins with an impact, but no contact begins with it",
    ),
    (
        lambda: replace(hop(), actuation="velocity"),
        "'flight' has no contact, which a velocity source cannot model",
    ),
    (lambda: replace(lean(), actuation="velocity"), "initial_v of a velocity source is not zero"),
    (
        lambda: replace(lean(), actuation="springs"),
        "actuation of Problem 'hop' is 'springs'; allowed: torque, acceleration, velocity",
    ),
    (
        lambda: nlp_of("velocity", "hermite-simpson"),
        "'hermite-simpson' states the balance of a velocity source twice",
    ),
    (
        lambda: Schedule((Phase(name="p", duration=1.0, contacts=(FOOT,), impact=True),)),
        "the first phase 'p' begins with an impact",
    ),
    (
        lambda: replace(landing(impact=True), dynamics=(terms.BaseDynamics(),)),
        "begins with an impact, but the dynamics hold no contacts",
    ),
    (
        lambda: Phase(name="p", duration=1.0, contacts=(FOOT,), impact="no"),
        "impact of Phase 'p' is 'no'; allowed: True or False",
    ),
    (
        lambda: hop(terms=(terms.TorqueCost,)),
        r"terms\[0\] of Problem 'hop' is the class TorqueCost; allowed: a Term",
    ),
)
