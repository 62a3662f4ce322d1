"""Terms of the user's own between their points: what a solve judges, records, and leaves to the check."""

from dataclasses import dataclass, replace

import casadi as ca
import numpy as np
import pinocchio as pin
import pytest
from typing_extensions import override

import trajopt
from trajopt import terms
from trajopt.certify.report import BETWEEN
from trajopt.errors import InputError
from trajopt.motion.solution import Solution
from trajopt.solving.solving import prepare
from trajopt.terms import Context, Cost, NodeConstraint, PointConstraint, Rows
from trajopt.terms.interfaces import NodePlace
from trajopt.transcription import transcribe

# A step of time as a fraction of an interval, and the error of central differences with it.
STEP, ACCURACY = 1e-5, 1e-6
# Rounding of a violation that is evaluated twice, by symbols and by numeric Pinocchio.
ROUNDING = 1e-9


@dataclass(frozen=True, kw_only=True)
class ToolAcceleration(PointConstraint):
    most: float

    @override
    def rows(self, context, units):
        return Rows.create(context.frame("tool0").acceleration[:3], -self.most, self.most, 9.81)


@dataclass(frozen=True, kw_only=True)
class ToolHeight(NodeConstraint):
    least: float

    @override
    def acts_at(self, place: NodePlace) -> bool:
        return True

    @override
    def rows(self, context, units, place):
        return Rows.create(context.frame("tool0").position[2], self.least, np.inf, units.length)


@dataclass(frozen=True, kw_only=True)
class Own(PointConstraint):
    made: object

    @override
    def rows(self, context, units):
        return Rows.create(self.made(context), -1e3, 1e3, 1.0)


@dataclass(frozen=True, kw_only=True)
class TorqueRate(Cost):
    @override
    def residual(self, context, units):
        return ca.jtimes(context.torque, context.xi, context.dxi) * units.time / units.torque


def tool_motion(motion, rate: float = 4000.0) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Times (n,), heights (n,) and accelerations (n, 3) of the tool at a rate in Hz."""
    samples, data = motion.sample(rate=rate), motion.model.createData()
    frame, heights, accelerations = motion.model.getFrameId("tool0"), [], []
    for q, v, a in zip(samples.q, samples.v, samples.a, strict=True):
        pin.forwardKinematics(motion.model, data, q, v, a)
        pin.updateFramePlacements(motion.model, data)
        heights.append(data.oMf[frame].translation[2])
        accelerations.append(
            pin.getFrameClassicalAcceleration(motion.model, data, frame, pin.LOCAL_WORLD_ALIGNED).linear
        )
    return samples.t, np.array(heights), np.array(accelerations)


@pytest.fixture(scope="module")
def reach():
    return trajopt.load("ur5-reach")


@pytest.fixture(scope="module")
def limited(reach):
    return replace(reach, terms=(*reach.terms, ToolAcceleration(most=2.0)))


@pytest.fixture(scope="module")
def coarse(limited):
    return trajopt.solve(limited, transcription="legendre:2", intervals=4)


def test_a_limit_of_ones_own_that_is_missed_between_points_fails_the_check(coarse):
    report = trajopt.check(coarse)
    assert coarse.converged
    assert "term_excess" in report.failures()
    assert report.places["term_excess"].name == "tool_acceleration"
    assert "tool_acceleration" in report.table()


def test_the_recorded_excess_is_that_of_the_sampled_motion(coarse):
    (stated,) = coarse.statistics.terms_between
    t, _, accelerations = tool_motion(coarse)
    largest = np.abs(accelerations).max(axis=1) / 2.0 - 1
    assert stated.excess == pytest.approx(np.interp(stated.time, t, largest), abs=1e-3)
    assert 0.7 * largest.max() < stated.excess <= largest.max() + ROUNDING
    assert max(coarse.statistics.excess_by_interval) == stated.excess
    assert len(coarse.statistics.excess_by_interval) == coarse.n_intervals


def test_the_file_says_what_the_solve_judged(coarse, tmp_path):
    coarse.save(tmp_path / "coarse.npz")
    read = Solution.load(tmp_path / "coarse.npz")
    assert read.statistics.terms_between == coarse.statistics.terms_between
    assert trajopt.check(read).term_excess == trajopt.check(coarse).term_excess


@pytest.mark.long
def test_the_mesh_is_refined_where_a_term_is_missed(limited):
    motion = trajopt.solve(limited)
    assert motion.success
    assert trajopt.check(motion).term_excess <= BETWEEN
    assert np.abs(tool_motion(motion)[2]).max() <= 2.0 * (1 + 2 * BETWEEN)


@pytest.mark.long
def test_a_node_constraint_is_judged_between_nodes(reach):
    free = trajopt.solve(reach, transcription="legendre:2", intervals=3)
    _, heights, _ = tool_motion(free)
    lowest = min(heights[0], heights[-1]) - 1e-3
    motion = trajopt.solve(
        replace(reach, terms=(*reach.terms, ToolHeight(least=lowest))),
        transcription="legendre:2",
        intervals=3,
    )
    (stated,) = motion.statistics.terms_between
    missed = max(0.0, lowest - tool_motion(motion)[1].min())
    assert stated.term == "tool_height"
    assert stated.excess * reach.robot.length <= missed + ROUNDING


def test_terms_that_the_check_judges_are_not_judged_twice(reach):
    assert trajopt.solve(reach, intervals=4).statistics.terms_between == ()


def test_rows_of_ones_own_on_a_library_term_are_judged():
    @dataclass(frozen=True, kw_only=True)
    class Half(terms.TorqueLimits):
        @override
        def rows(self, context: Context, units) -> Rows | None:
            return Rows.create(context.torque, -1.0, 1.0, 1.0)

    assert terms.TorqueLimits().in_check
    assert not Half().in_check
    assert terms.FrictionCone().in_check
    assert not terms.FrictionCone(friction=0.2).in_check


@pytest.mark.parametrize(
    ("term", "name"),
    [
        (TorqueRate(weight=1.0), "torque_rate"),
        (Own(made=lambda c: ca.jtimes(c.torque, c.xi, c.dxi)), "own"),
        (Own(made=lambda c: ca.SX(np.ones(2))), "own"),
        (Own(made=lambda c: c.parameter(np.ones(2))), "own"),
    ],
)
def test_a_term_that_cannot_vary_is_refused_by_name(reach, term, name):
    with pytest.raises(InputError, match=f"^{name} cannot vary") as caught:
        transcribe(replace(reach, terms=(*reach.terms, term)))
    assert len(str(caught.value).splitlines()) == 1


def of_frame(context: Context) -> ca.SX:
    name = "tool0" if context.robot.base == "fixed" else context.robot.contacts[0].frame
    frame = context.frame(name)
    return ca.vertcat(
        ca.mtimes(frame.rotation, frame.position) * frame.velocity[1], ca.sumsqr(frame.velocity), context.q[0]
    )


def along(context: Context) -> ca.SX:
    expression = ca.vertcat(of_frame(context), context.v[:4], ca.sin(context.xi) * context.dxi[1])
    return ca.vertcat(expression, context.rate(expression))


def along_forces(context: Context) -> ca.SX:
    wrenches = [wrench * wrench[0] for wrench in context.wrenches.values()]
    expression = ca.vertcat(of_frame(context), context.a[:6], context.torque[0] ** 2, *wrenches)
    return ca.vertcat(expression, context.rate(expression))


@pytest.mark.parametrize(
    ("name", "actuation", "made"),
    [
        (name, *case)
        for name in ("ur5-reach", "solo12-jump")
        for case in (("torque", along), ("jerk", along_forces))
    ],
)
def test_the_rate_of_an_expression_is_its_slope_along_the_motion(name, actuation, made):
    problem = trajopt.load(name)
    added = replace(problem, terms=(*problem.terms, Own(made=made)), actuation=actuation)
    prepared = prepare(added, transcription="radau:3", intervals=6)
    t, noise = prepared.transcription, 0.05 * np.random.default_rng(0).normal(size=len(prepared.guess))
    for node, form in enumerate(t.layout.forms):
        noise[t.layout.node(node).start + form.rotations] = 0.0  # quaternions have the length 1
    x = prepared.guess + noise
    parts = prepared.nlp.parts["groups"][0]
    group = t.groups[0]
    stage = int(group.stages[0])
    loads = tuple(contact.name for contact in t.layout.contacts[int(t.layout.phase_of[stage])])
    window = x[t.layout.window(stage)]
    own = np.flatnonzero(np.array(t.rows.names)[t.rows.block[group.rows[0]]] == "own")

    def at(fraction: float) -> np.ndarray:
        z = t.collocation.moment_gather(stage, fraction, loads).toarray() @ window
        return parts["value"]([z[None], group.parameters[:1]])[1][0, own]

    half = len(own) // 2
    seconds = STEP * t.layout.steps[stage]
    slope = (at(0.4 + STEP)[:half] - at(0.4 - STEP)[:half]) / (2 * seconds)
    assert at(0.4)[half:] == pytest.approx(slope, rel=ACCURACY, abs=ACCURACY * np.abs(slope).max())


@pytest.mark.parametrize(
    "made", [lambda c: c.torque, lambda c: c.frame("tool0").acceleration, lambda c: c.ddxi, lambda c: c.a]
)
def test_accelerations_and_torques_have_no_rate(reach, made):
    with pytest.raises(InputError, match="asks for the rate of an acceleration, torque"):
        transcribe(replace(reach, terms=(*reach.terms, Own(made=lambda c: c.rate(made(c))))))


def test_a_node_has_no_rates(reach):
    @dataclass(frozen=True, kw_only=True)
    class AtNode(NodeConstraint):
        @override
        def rows(self, context: Context, units, place: NodePlace) -> Rows:
            return Rows.create(context.rate(context.q), 0, 0, 1.0)

    with pytest.raises(InputError, match="asks for a rate at a node"):
        transcribe(replace(reach, terms=(*reach.terms, AtNode())))
