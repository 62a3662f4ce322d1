"""Phases in minimal coordinates against one floating base with contact rows: the same motion."""

from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest
from numpy.testing import assert_allclose

import trajopt
from tests.support.derivatives import Matrices, assert_derivatives, random_unknowns
from tests.support.problems import FOOT, hop, hopper
from trajopt import FlatGround, InputError, Phase, Robot, Schedule, Solution, terms
from trajopt.certify.report import AT_POINTS
from trajopt.motion.samples import contact_places
from trajopt.robot import robot_file, stance_mode
from trajopt.solving.solving import prepare
from trajopt.solving.solving import solve as solve_on_mesh
from trajopt.transcription.timeline import StageKind
from trajopt.transcription.transcription import Transcription
from trajopt_library import problems

pytestmark = pytest.mark.long

INTERVALS = 40
# The transcriptions have different errors: measured 2.6e-4 of the optimum at 40 intervals, 2.3e-5 at 80,
# 2.0e-6 at 160. So one optimum, met to what the grid leaves.
SAME_OPTIMUM = 5e-4
SAME_MOTION = 5e-3  # rad and m


@lru_cache
def solved(coordinates: str, touchdown: str = "soft", solver: str = "ipopt") -> Solution:
    problem = problems.load("hopper-hop", coordinates=coordinates, touchdown=touchdown)
    solution = trajopt.solve(problem, intervals=INTERVALS, solver=solver)
    assert solution.converged
    return solution


@pytest.mark.parametrize("touchdown", ["soft", "impact"])
def test_minimal_and_excess_coordinates_have_the_same_optimum(touchdown):
    excess, minimal = (solved(coordinates, touchdown) for coordinates in ("excess", "minimal"))
    assert minimal.statistics.objective == pytest.approx(excess.statistics.objective, rel=SAME_OPTIMUM)
    assert_allclose(minimal.q, excess.q, atol=SAME_MOTION)
    assert minimal.statistics.variables < excess.statistics.variables
    assert minimal.statistics.constraints < excess.statistics.constraints
    assert [excess.statistics.iterations <= 60, minimal.statistics.iterations <= 60] == [True, True]


def test_optima_of_both_coordinates_approach_each_other_with_the_grid():
    apart = []
    for intervals in (40, 80):
        problem = [problems.load("hopper-hop", coordinates=name) for name in ("excess", "minimal")]
        found = [trajopt.solve(p, intervals=intervals).statistics.objective for p in problem]
        apart.append(abs(found[1] / found[0] - 1))
    assert apart[1] < apart[0] / 4


def test_a_solution_in_minimal_coordinates_is_certified_as_the_floating_robot():
    solution = solved("minimal")
    report = trajopt.check(solution)
    assert report.within(AT_POINTS)
    stance = solution.phase == 0
    places = contact_places(solution).position[stance]
    assert np.abs(places - places[0]).max() < 1e-12  # the contact is part of the coordinates
    assert solution.q.shape[1] == problems.load("hopper-hop").robot.nq


def test_ground_reactions_of_the_modes_equal_the_contact_forces():
    excess, minimal = solved("excess"), solved("minimal")
    points = excess.collocation
    weight = problems.load("hopper-hop").robot.weight
    assert_allclose(minimal.f[points] / weight, excess.f[points] / weight, atol=0.05)
    assert np.abs(minimal.f[points & (minimal.phase == 1)]).max() == 0.0


def test_impact_before_a_mode_takes_the_velocity_off_the_foot():
    excess, minimal = solved("excess", "impact"), solved("minimal", "impact")
    assert_allclose(minimal.impulse, excess.impulse, atol=1e-2 * np.abs(excess.impulse).max())
    assert np.abs(excess.impulse).max() > 0.1


def standing_hop() -> trajopt.Problem:
    """The small hopper in space: a spherical ankle holds its stance and its landing."""
    robot = hop().robot
    phases = hop().schedule.phases
    landing = replace(phases[2], footholds={FOOT: np.array([0.02, 0.0, 0.0])})
    modes = {
        "stance": stance_mode(robot, FOOT),
        "landing": stance_mode(robot, FOOT, anchor=landing.footholds[FOOT]),
    }
    return hop(schedule=Schedule((*phases[:2], landing)), modes=modes)


def hop_of_the_plane() -> trajopt.Problem:
    return problems.load("hopper-hop", coordinates="minimal", touchdown="impact")


@pytest.mark.parametrize("build", [standing_hop, hop_of_the_plane])
def test_derivatives_of_the_whole_nlp_equal_differences(build):
    nlp = prepare(build(), intervals=4).nlp
    assert_derivatives(nlp, seed=2)
    t = nlp.transcription
    jacobian = Matrices(nlp).jacobian(random_unknowns(t, 3))
    for k in range(t.layout.n_stages):
        block = jacobian[t.gap_rows[k]][:, t.layout.node(k + 1)].toarray()
        assert_allclose(block, np.eye(t.layout.forms[k + 1].size), atol=1e-12)


def test_nodes_have_the_size_of_their_mode_and_end_in_the_whole_robot():
    layout = prepare(hop_of_the_plane(), intervals=4).transcription.layout
    sizes = [layout.form_of(phase).size for phase in range(3)]
    assert sizes == [6, 10, 6]
    assert layout.forms[-1].size == 10
    kinds = [stage.kind for stage in layout.stages if stage.step == 0]
    assert kinds == [StageKind.CHANGE, StageKind.IMPACT, StageKind.CHANGE, StageKind.CHANGE]


def test_embedded_contacts_have_neither_forces_nor_rows():
    t = prepare(hop_of_the_plane(), intervals=4).transcription
    assert t.layout.n_wrench(0) == t.layout.n_wrench(2) == 0
    assert "contact_acceleration" not in t.rows.names
    assert "friction_pyramid" in t.rows.names


def test_hop_in_space_agrees_in_both_coordinates():
    # On 16 intervals excess coordinates have an optimum more, whose foot drifts by 4 mm.
    minimal = trajopt.solve(standing_hop(), intervals=24)
    excess = trajopt.solve(replace(standing_hop(), modes={}), intervals=24)
    assert [minimal.converged, excess.converged] == [True, True]
    for solution in (minimal, excess):
        assert trajopt.check(solution).within(AT_POINTS)


@pytest.mark.parametrize(
    ("phase", "words"),
    [
        (
            "glide",
            "a mode is given for phase 'glide', which does not exist; allowed: stance, flight, landing",
        ),
        ("flight", "mode of phase 'flight' stands on 'foot'"),
    ],
)
def test_mode_of_an_unknown_phase_or_without_its_contact_is_refused(phase, words):
    problem = hop_of_the_plane()
    with pytest.raises(InputError, match=words):
        replace(problem, modes={phase: problem.modes["stance"]})


def test_mode_away_from_its_foothold_is_refused():
    problem = hop_of_the_plane()
    moved = replace(problem.schedule.phases[2], footholds={"foot": np.array([0.1, 0.0, 0.0])})
    schedule = Schedule((*problem.schedule.phases[:2], moved))
    with pytest.raises(InputError, match="mode of phase 'landing' stands at"):
        replace(problem, schedule=schedule)
    nowhere = Phase(name="landing", duration=0.5, contacts=("foot",))
    with pytest.raises(InputError, match="phase 'landing' has no foothold for 'foot', on which a mode"):
        replace(problem, schedule=Schedule((*problem.schedule.phases[:2], nowhere)))


def test_limits_and_postures_of_the_whole_robot_mean_the_same_joints_in_a_mode():
    """The small hopper's mode has its joints in another order: shank, hip."""
    limit = terms.TorqueLimits(limit=np.array([10.0, 50.0]))
    t = prepare(replace(standing_hop(), terms=(limit,)), intervals=6).transcription
    torque = hop().robot.weight * hop().robot.length
    effort = t.rows.block == t.rows.names.index("torque_limits")
    phase = np.array([t.layout.phase_at(int(k)) for k in t.rows.stage])
    bounds = [t.upper_g[effort & (phase == i)][:2] * torque for i in range(3)]
    assert_allclose(bounds, [[50.0, 10.0], [10.0, 50.0], [50.0, 10.0]])
    posture = hop().robot.reference.copy()
    posture[-2:] += [0.3, -0.1]
    problem = replace(standing_hop(), terms=(terms.PostureCost(weight=1.0, q=posture),))
    costs = [guess_cost(each) for each in (problem, replace(problem, modes={}))]
    assert costs[0] == pytest.approx(costs[1], rel=1e-9)


def guess_cost(problem: trajopt.Problem) -> float:
    prepared = prepare(problem, intervals=6)
    return float(prepared.nlp.engine.f(prepared.guess))


def test_torque_limit_of_wrong_length_is_refused():
    with pytest.raises(InputError, match=r"values of shape \(3,\) for the actuated joints; allowed: \(2,\)"):
        prepare(hop(terms=(terms.TorqueLimits(limit=np.ones(3)),)), intervals=4)


def test_start_that_moves_the_contact_of_its_mode_is_refused():
    problem = hop_of_the_plane()
    moving = np.zeros(problem.robot.nv)
    moving[0] = 0.1
    with pytest.raises(InputError, match="moves the contact on which its first mode stands"):
        replace(problem, initial_v=moving)
    aside = problem.initial_q + np.eye(problem.robot.nq)[0] * 0.3
    with pytest.raises(InputError, match="mode of phase 'stance' stands at"):
        replace(problem, initial_q=aside)


def test_mode_of_another_robot_is_refused():
    other = hopper(mass=30.0)
    with pytest.raises(InputError, match="mode of phase 'stance' is of another robot"):
        replace(standing_hop(), modes={"stance": stance_mode(other, FOOT)})


def two_legs() -> trajopt.Problem:
    """Bolt stands on one point foot in minimal coordinates and on the other by contact rows, or swings it."""
    robot = Robot.from_urdf(
        robot_file("bolt_description/robots/bolt.urdf"),
        contacts=["FL_FOOT", "FR_FOOT"],
        reference={f"{leg}_{joint}": angle for leg in ("FL", "FR") for joint, angle in BENT.items()},
    )
    ground = FlatGround()
    return trajopt.Problem(
        name="two-legs",
        robot=robot,
        schedule=Schedule(
            (
                Phase(name="double", duration=0.2, contacts=("FL_FOOT", "FR_FOOT")),
                Phase(name="single", duration=0.2, contacts=("FL_FOOT",)),
            )
        ),
        terrain=ground,
        terms=(
            terms.TorqueCost(weight=1.0),
            terms.WrenchCost(weight=1e-2),
            terms.FrictionCone(contacts=("FL_FOOT",)),
            terms.FrictionCone(contacts=("FR_FOOT",)),
            terms.SwingClearance(height=0.02, terrain=ground),
        ),
        guess=lambda t: robot.reference,
    )


BENT = {"HAA": 0.0, "HFE": 0.6, "KFE": -1.2}


def test_other_contacts_keep_their_rows_beside_an_embedded_one():
    problem = two_legs()
    stance = stance_mode(problem.robot, "FL_FOOT")
    minimal = replace(problem, modes={"double": stance, "single": stance})
    t = prepare(minimal, intervals=6).transcription
    assert t.layout.n_wrench(0) == 3  # of the other foot
    assert t.layout.n_wrench(1) == 0
    excess = prepare(problem, intervals=6).transcription

    def count(found: Transcription, name: str) -> int:
        return int(np.sum(found.rows.block == found.rows.names.index(name)))

    for name in ("swing_clearance", "friction_cone"):
        assert count(t, name) == count(excess, name)
    assert count(t, "contact_acceleration") < count(excess, "contact_acceleration")
    # from its own guess either ends at one of several optima
    first = solve_on_mesh(problem, intervals=6, tolerance=1e-8)
    solutions = [first, solve_on_mesh(minimal, intervals=6, tolerance=1e-8, start=first)]
    assert [solution.converged for solution in solutions] == [True, True]
    objectives = [solution.statistics.objective for solution in solutions]
    assert objectives[1] == pytest.approx(objectives[0], rel=SAME_OPTIMUM)


def test_statics_of_a_velocity_source_hold_in_a_mode():
    problem = hop_of_the_plane()
    stance = Schedule((problem.schedule.phases[0],))
    all_terms = (terms.VelocityCost(weight=1.0), terms.PostureCost(weight=1.0), terms.FrictionCone())
    still = replace(
        problem,
        schedule=stance,
        modes={"stance": problem.modes["stance"]},
        terms=all_terms,
        actuation="velocity",
    )
    solution = trajopt.solve(still, intervals=6)
    assert solution.converged
    assert trajopt.check(solution).within(AT_POINTS)
