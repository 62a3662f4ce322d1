"""Meshes: schemes by phase and intervals of unequal width, from the layout to the file and back."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from tests.support.problems import hop, lean
from trajopt.certify.check import check
from trajopt.errors import InputError
from trajopt.motion.energy_use import energy
from trajopt.schedule import END, Moment, Phase, end_of, middle_of, start_of
from trajopt.solution.grid import interpolated, mesh_of
from trajopt.solution.solution import Solution
from trajopt.solving.solving import prepare, solve
from trajopt.terms import NodePlace
from trajopt.terms.interfaces import nodes_of
from trajopt.transcription.mesh import Mesh, PhaseMesh, equal_fractions
from trajopt.transcription.transcription import transcribe

# Step of central differences, and what their truncation and rounding leave of entries of order one.
STEP, DIFFERENCES = 1e-6, 1e-6
# The solver's tolerance grows by what follows a point within its interval.
CONSISTENT = 1e-5
# Of sums of products.
ROUNDING = 1e-12

UNEVEN = Mesh(
    phases=(
        PhaseMesh(scheme="legendre:2", widths=(0.25, 0.25, 0.125, 0.125, 0.25)),
        PhaseMesh(scheme="legendre:3", widths=(0.3, 0.7)),
        PhaseMesh(scheme="radau:2", widths=(0.1, 0.1, 0.2, 0.3, 0.3)),
    )
)


@pytest.fixture(scope="module")
def uneven():
    return solve(hop(), mesh=UNEVEN)


@pytest.mark.long
def test_intervals_have_the_widths_and_the_points_of_their_phase(uneven):
    assert uneven.converged
    durations = [phase.duration for phase in hop().schedule.phases]
    steps = np.concatenate([T * np.array(m.widths) for T, m in zip(durations, UNEVEN.phases, strict=True)])
    assert_allclose(np.diff(uneven.interval_t, axis=1)[:, 0], steps, rtol=1e-12)
    methods = [phase.method for phase in UNEVEN.phases for _ in phase.widths]
    for method, rows, (start, end) in zip(methods, uneven.intervals, uneven.interval_t, strict=True):
        points = [row for row in rows if uneven.collocation[row]]
        assert_allclose((uneven.t[points] - start) / (end - start), method.c, atol=1e-12)


def test_uneven_mesh_holds_the_dynamics_and_joins_its_intervals(uneven):
    found = check(uneven).to_dict()
    for name in ("base_residual", "actuated_residual", "contact_acceleration", "state_jump"):
        assert found[name] < CONSISTENT, name


def test_file_tells_its_mesh(uneven, tmp_path):
    assert mesh_of(Solution.load(uneven.save(tmp_path / "hop.npz"))) == UNEVEN
    assert uneven.statistics.transcription == "legendre:2,legendre:3,radau:2"


def test_mesh_of_a_file_without_one_follows_from_its_times():
    even = solve(hop(), transcription="legendre:2", intervals=12, max_iterations=0)
    old = even.with_statistics(mesh=None)
    assert mesh_of(old) == mesh_of(even) == Mesh.uniform("legendre:2", hop().schedule.intervals(12))


def vars_of(solution):
    return {name: getattr(solution, name) for name in Solution.__dataclass_fields__}


def test_derivatives_on_an_uneven_mesh_are_those_of_differences():
    prepared = prepare(hop(), mesh=UNEVEN)
    engine, x = prepared.nlp.engine, prepared.guess
    direction = np.random.default_rng(0).normal(size=x.size)
    ahead, behind = (np.array(engine.g(x + sign * STEP * direction)) for sign in (1, -1))
    product = np.zeros(prepared.transcription.n_rows)
    np.add.at(product, prepared.nlp.row, np.array(engine.jacobian(x)) * direction[prepared.nlp.column])
    scale = np.abs(product).max()
    assert_allclose(product / scale, (ahead - behind) / (2 * STEP) / scale, atol=DIFFERENCES)


def test_mesh_of_equal_widths_is_the_uniform_transcription():
    mesh = Mesh.uniform("legendre:2", hop().schedule.intervals(10))
    given, plain = transcribe(hop(), mesh=mesh), transcribe(hop(), "legendre:2", 10)
    assert_array_equal(given.linear.toarray(), plain.linear.toarray())
    assert len(given.groups) == len(plain.groups)
    assert_allclose(given.layout.node_times, plain.layout.node_times)


@pytest.mark.long
def test_solution_on_a_split_mesh_starts_where_the_coarse_one_ends(uneven):
    split = Mesh(phases=tuple(phase.split([2] * phase.count) for phase in UNEVEN.phases))
    cold = solve(hop(), mesh=split)
    warm = solve(hop(), mesh=split, start=uneven)
    assert warm.converged
    assert warm.statistics.iterations < cold.statistics.iterations
    assert warm.statistics.objective == pytest.approx(cold.statistics.objective, rel=1e-4)


def test_multipliers_of_an_uneven_mesh_return_to_their_own_mesh(uneven):
    again = solve(hop(), mesh=UNEVEN, start=uneven)
    assert again.converged
    assert again.statistics.iterations <= 2


def test_one_scheme_for_each_phase_is_named_with_commas():
    names = "legendre:1,radau:3,trapezoidal"
    mesh = transcribe(hop(), names, 9).layout.mesh
    assert [phase.scheme for phase in mesh.phases] == names.split(",")
    assert mesh.transcription == names


def test_velocity_source_takes_an_uneven_mesh():
    mesh = Mesh(phases=(PhaseMesh(scheme="radau:2", widths=(0.2, 0.3, 0.5)),) * len(lean().schedule.phases))
    found = solve(lean(), mesh=mesh)
    assert found.converged
    assert found.n_intervals == 3 * len(lean().schedule.phases)


def test_node_nearest_to_a_fraction_goes_by_time():
    phase = Phase(name="flight", duration=0.2)
    place = NodePlace(phase, 0, (0.0, 0.1, 0.2, 0.45, 1.0), last=False)
    assert place.nearest(0.5) == 3
    assert NodePlace(phase, 0, equal_fractions(5), last=False).nearest(0.5) == 2
    assert NodePlace(phase, 0, equal_fractions(4), last=False).nearest(1.0) == 4


def test_the_end_of_a_phase_is_the_start_of_the_next_one():
    before, phase = Phase(name="stance", duration=0.3), Phase(name="flight", duration=0.2)
    end = NodePlace(before, 4, equal_fractions(4), last=False)
    shared = NodePlace(phase, 0, equal_fractions(5), last=False, before=end)
    alone = NodePlace(phase, 0, equal_fractions(5), last=False)  # after an impact
    assert [shared.is_at(moment) for moment in (end_of("stance"), start_of("flight"))] == [True, True]
    assert [alone.is_at(moment) for moment in (end_of("stance"), start_of("flight"))] == [False, True]
    assert end.is_at(end_of("stance"))
    assert end.is_at(Moment("stance", 0.9))
    assert not end.is_at(END)
    assert not shared.is_at(middle_of("flight"))


@pytest.mark.parametrize(("impact", "counts"), [(False, [4, 5]), (True, [5, 5])])
def test_the_last_node_of_a_phase_is_its_own_before_an_impact_and_at_the_end(impact, counts):
    phases = Phase(name="flight", duration=0.2), Phase(name="stance", duration=0.3, impact=impact)
    nodes = [list(nodes_of(phases, index, equal_fractions(4))) for index in range(2)]
    assert [len(own) for own in nodes] == counts
    assert [place.last for own in nodes for place in own] == [False] * (sum(counts) - 1) + [True]
    assert sum(place.is_at(end_of("flight")) for own in nodes for place in own) == 1


def test_step_at_a_node_is_the_wider_of_its_intervals():
    phase, fractions = Phase(name="flight", duration=0.2), (0.0, 0.1, 0.4, 1.0)
    steps = [NodePlace(phase, index, fractions, last=False).step for index in range(4)]
    assert_allclose(steps, [0.1, 0.3, 0.6, 0.6])


@pytest.mark.parametrize(
    ("widths", "scheme", "message"),
    [
        ((), "legendre:2", r"widths of a phase's intervals are \(\); allowed: positive, 1 in sum"),
        ((0.5, 0.6), "legendre:2", "1 in sum"),
        ((1.5, -0.5), "legendre:2", "positive"),
        ((float("nan"), 1.0), "legendre:2", "positive"),
        ((1.0,), "euler", "unknown transcription 'euler'"),
    ],
)
def test_phase_meshes_that_are_none_are_refused(widths, scheme, message):
    with pytest.raises(InputError, match=message):
        PhaseMesh(scheme=scheme, widths=widths)


def test_meshes_that_do_not_fit_are_refused():
    one = Mesh.uniform("legendre:2", [4])
    with pytest.raises(InputError, match="mesh has 1 phases, problem 'hop' 3"):
        transcribe(hop(), mesh=one)
    with pytest.raises(InputError, match="mesh is given with a transcription or intervals"):
        solve(hop(), mesh=UNEVEN, intervals=12)
    with pytest.raises(InputError, match="names 2 schemes for 3 phases"):
        transcribe(hop(), "legendre:2,legendre:3", 12)


def test_energy_and_shared_wrenches_take_every_phases_own_scheme(uneven):
    torque, rates = uneven.tau, uneven.v[:, uneven.n_unactuated :]
    expected, methods = 0.0, [phase.method for phase in UNEVEN.phases for _ in phase.widths]
    for method, rows, (start, end) in zip(methods, uneven.intervals, uneven.interval_t, strict=True):
        points = [row for row in rows if uneven.collocation[row]]
        expected += (end - start) * method.b1 @ np.abs(torque[points] * rates[points]).sum(axis=1)
    # Energy given back counts as drawn when as much of it is lost as of what is drawn.
    assert energy(uneven, recovered=-1.0) == pytest.approx(expected)
    assert_allclose(interpolated(uneven, uneven.f), uneven.f, atol=ROUNDING * np.abs(uneven.f).max())
