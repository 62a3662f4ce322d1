"""Published optima are found, and terminal rows are linear in positions and rates."""

import json
from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

import trajopt
from tests.support.command_lines import invoke
from trajopt.errors import InputError
from trajopt.problem.catalogue import published_optima
from trajopt.study.published import compared
from trajopt.terms import TerminalLinear

OPTIMA = {one.name: one for one in published_optima()}


@pytest.mark.parametrize("name", OPTIMA)
def test_a_published_optimum_is_found_within_its_tolerance(name):
    (comparison,) = compared([OPTIMA[name]])
    assert comparison.converged
    assert comparison.agrees, f"{comparison.found} is {comparison.apart:+.1e} from {comparison.published}"


@pytest.mark.parametrize("name", ["cart-pole", "two-link arm", "pendulum"])
def test_a_published_optimum_does_not_depend_on_the_mesh(name):
    optimum = OPTIMA[name]
    values = [
        optimum.value(trajopt.solve(optimum.build(), transcription=scheme, intervals=intervals))
        for scheme, intervals in (("legendre:2", 120), ("legendre:3", 60), ("radau:3", 60))
    ]
    assert_allclose(values, values[1], rtol=optimum.tolerance)


@pytest.mark.long
def test_the_command_prints_every_optimum_and_its_json():
    table, data = invoke("bench", "outside"), invoke("bench", "outside", "--json")
    assert table.exit_code == data.exit_code == 0
    assert all(name in table.stdout for name in OPTIMA)
    found = json.loads(data.stdout)
    assert {entry["name"] for entry in found} == set(OPTIMA)
    assert all(entry["agrees"] and entry["source"] for entry in found)


@pytest.mark.parametrize(
    ("position", "velocity", "value", "message"),
    [
        ([[1.0]], [[1.0, 0.0]], [0.0], r"shapes \(1, 1\) and \(1, 2\)"),
        ([[1.0]], [[0.0]], [0.0, 1.0], "and 2 values"),
        ([[0.0]], [[0.0]], [1.0], "a row of TerminalLinear is zero|a row of .* is zero"),
        ([[1.0, 0.0]], [[0.0, 0.0]], [1.0], "has 2 columns; allowed: 1"),
    ],
)
def test_terminal_rows_of_wrong_shape_are_refused(position, velocity, value, message):

    problem = OPTIMA["rest to rest"].build()

    def ends_on(**row):
        term = TerminalLinear(**{name: np.array(values) for name, values in row.items()})
        trajopt.solve(replace(problem, terms=(*problem.terms[:2], term)))

    with pytest.raises(InputError, match=message):
        ends_on(position=position, velocity=velocity, value=value)
