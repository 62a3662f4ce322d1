"""Fronts, settings and plans of sweeps."""

import itertools
import math
from dataclasses import replace

import numpy as np
import pytest

from tests.support.problems import hop, reach
from trajopt.errors import InputError
from trajopt.study.sweep.plan import OTHER_SCHEMES, make_plan, own_setting
from trajopt.study.sweep.setting import WORDS, Setting, cone_of, with_cone
from trajopt.study.sweep.summary import dominators, front
from trajopt.terms import FrictionCone, FrictionPyramid

BASE = Setting(transcription="legendre:2", intervals=10)
NAN, INF = math.nan, math.inf


# Fronts


@pytest.mark.parametrize(
    ("points", "expected"),
    [
        ([], []),
        ([(1.0, 1.0)], [0]),
        ([(2.0, 1.0), (1.0, 2.0), (2.0, 2.0)], [1, 0]),
        ([(1.0, 1.0), (1.0, 1.0)], [0, 1]),  # equal points do not dominate each other
        ([(1.0, 2.0), (1.0, 1.0)], [1]),  # as fast, more accurate
        ([(1.0, 1.0), (2.0, 1.0)], [0]),  # as accurate, faster
        ([(INF, 1e-9), (1.0, 1.0), (NAN, 0.0), (0.5, INF), (0.1, NAN)], [1]),
        ([(NAN, NAN)], []),
        ([(1.0, 0.0), (2.0, 0.0)], [0]),
    ],
)
def test_the_front_holds_what_nothing_dominates(points: list[tuple[float, float]], expected: list[int]):
    assert front(points) == expected


def test_the_front_is_that_of_the_definition():
    points = [tuple(row) for row in np.random.default_rng(0).integers(1, 12, (60, 2)).astype(float)]

    def dominated(point: tuple[float, float]) -> bool:
        return any(other[0] <= point[0] and other[1] <= point[1] and other != point for other in points)

    found = front(points)
    assert sorted(found) == [i for i, point in enumerate(points) if not dominated(point)]
    assert found == sorted(found, key=lambda i: points[i])


def test_a_slower_point_has_to_gain():
    points = [(1.0, 1.0), (2.0, 0.96), (3.0, 0.94), (4.0, 0.5)]
    assert front(points, gain=0.05) == [0, 2, 3]
    assert dominators(points, gain=0.05) == [None, 0, None, None]


def test_dominators_are_on_the_front_and_ahead():
    points = [(1.0, 1.0), (4.0, 0.01), (5.0, 1.1), (5.0, 0.02), (INF, 1.0)]
    assert dominators(points) == [None, None, 1, 1, None]


def test_a_point_without_error_is_ahead_of_all():
    assert dominators([(1.0, 0.0), (2.0, 0.0), (2.0, 1.0)]) == [None, 0, 0]


# Settings


def test_no_word_belongs_to_two_axes():
    words = [word for words in WORDS.values() for word in words]
    assert len(words) == len(set(words))


@pytest.mark.long
def test_a_setting_is_its_words():
    for values in itertools.product(*WORDS.values()):
        setting = replace(BASE, tolerance=3e-4, **dict(zip(WORDS, values, strict=True)))
        assert Setting.parse(setting.name, replace(BASE, intervals=3)) == setting
        assert Setting.parse(setting.label(BASE), BASE) == setting
        assert Setting(**setting.to_dict()) == setting


def test_labels_tell_only_what_differs():
    assert BASE.label(BASE) == "legendre:2@10"
    changed = replace(BASE, hessian="gauss-newton", tolerance=1e-3)
    assert changed.label(BASE) == "legendre:2@10 1e-3 gauss-newton"


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("ipotp", "'ipotp' is no word of a setting; allowed: SCHEME@INTERVALS"),
        ("legendre:9", "unknown transcription 'legendre:9'"),
        ("legendre:2@x", "'legendre:2@x' is no grid"),
        ("@0", "intervals is 0; allowed: 1 to 100000"),
        ("@1000000000", "intervals is 1000000000"),
        ("ipopt ipopt", "setting 'ipopt ipopt' gives its solver twice"),
        ("1e-3 1e-4", "setting '1e-3 1e-4' gives its tolerance twice"),
        ("2", "tolerance is 2"),
        ("nan", "tolerance is nan"),
    ],
)
def test_wrong_words_are_refused_in_one_line(text: str, words: str):
    with pytest.raises(InputError) as caught:
        Setting.parse(text, BASE)
    assert str(caught.value).startswith(words)


# Plans


def test_the_default_plan_holds_the_grid_each_factor_and_no_setting_twice():
    problem = hop()
    plan = make_plan(problem)
    own = own_setting(problem)
    assert plan.settings[0] == plan.base == own
    assert own.cone == "smooth"
    assert len(set(plan.settings)) == len(plan.settings)
    assert plan.left_out == ()
    for axis, words in WORDS.items():
        tried = {getattr(setting, axis) for setting in plan.settings}
        assert tried >= set(words) - {"own"}
    grids = {(setting.transcription, setting.intervals) for setting in plan.settings}
    least = len(problem.schedule.phases)
    counts = {max(least, round(share * problem.default_intervals)) for share in (0.2, 0.5, 1, 2)}
    assert grids >= set(itertools.product(("legendre:1", "legendre:2", "legendre:3"), counts))
    assert grids >= {(name, problem.default_intervals) for name in OTHER_SCHEMES}


def test_what_a_problem_does_not_have_is_left_out_and_said():
    plan = make_plan(reach())
    assert {setting.model for setting in plan.settings} == {"full"}
    assert {setting.cone for setting in plan.settings} == {"own"}
    assert [note.split(":")[0] for note in plan.left_out] == ["cone smooth, pyramid", "model two-stage"]


def test_named_axes_are_varied_alone_and_grids_together():
    named = {"transcription": ["legendre:1", "radau:2"], "intervals": [5, 9], "tolerance": [1e-3, 1e-4]}
    plan = make_plan(reach(), {**named, "hessian": ["gauss-newton"]})
    assert {setting.hessian for setting in plan.settings} == {"gauss-newton"}
    labels = {setting.label(plan.base) for setting in plan.settings}
    grid = {"legendre:1@5", "legendre:1@9", "radau:2@5", "radau:2@9"}
    assert labels == grid | {"legendre:2@10", "legendre:2@10 1e-3", "legendre:2@10 1e-4"}


def test_a_full_plan_is_the_product():
    named = {"intervals": [5, 9], "hessian": ["exact", "gauss-newton"], "tolerance": [1e-3, 1e-4, 1e-5]}
    plan = make_plan(reach(), named, full=True)
    assert len(plan.settings) == 1 + 2 * 2 * 3  # the problem's own beside them


def test_a_fixed_axis_holds_in_the_default_plan():
    plan = make_plan(hop(), {"hessian": ["gauss-newton"], "transcription": ["legendre:1"]})
    assert {setting.hessian for setting in plan.settings} == {"gauss-newton"}
    assert {setting.transcription for setting in plan.settings} == {"legendre:1"}
    assert {setting.solver for setting in plan.settings} == set(WORDS["solver"])


@pytest.mark.long
@pytest.mark.parametrize(
    ("named", "words"),
    [
        ({"solver": ["snopt"]}, "unknown solver 'snopt'; allowed: ipopt"),
        ({"transcription": ["legendre:7"]}, "unknown transcription 'legendre:7'"),
        ({"tolerance": [0.0]}, "tolerance is 0"),
        ({"intervals": [0, 5]}, "intervals is 0"),
        ({"cone": ["smooth"]}, "problem 'reach' has no friction term of point contacts"),
        ({"model": ["two-stage"]}, "problem 'reach' has no base rows"),
        ({"intervals": list(range(1, 3000))}, "the product of all named values is too large"),
    ],
)
def test_a_plan_that_cannot_be_is_refused(named: dict[str, list], words: str):
    with pytest.raises(InputError) as caught:
        make_plan(reach(), named)
    assert str(caught.value).startswith(words)


def test_fewer_intervals_than_phases_are_refused():
    with pytest.raises(InputError, match="2 intervals for 3 phases"):
        make_plan(hop(), {"intervals": [2, 10]})


def test_cones_are_exchanged_with_their_values():
    problem = hop()
    (own,) = [term for term in problem.terms if isinstance(term, FrictionCone)]
    changed = with_cone(problem, "pyramid")
    (new,) = [term for term in changed.terms if isinstance(term, FrictionPyramid)]
    assert (new.friction, new.contacts, new.phases) == (own.friction, own.contacts, own.phases)
    assert cone_of(changed) == "pyramid"
    assert with_cone(changed, "smooth").terms == problem.terms
    assert with_cone(problem, "smooth") is with_cone(problem, "own") is problem
    assert cone_of(reach()) is None


def test_terms_of_both_kinds_are_told_apart():
    problem = hop()
    both = replace(problem, terms=(*problem.terms, FrictionPyramid()))
    assert cone_of(both) == "own"
    assert cone_of(with_cone(both, "smooth")) == "smooth"
    with pytest.raises(InputError, match="no friction term"):
        with_cone(reach(), "smooth")
