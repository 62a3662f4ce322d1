"""Starts: what takes long to load is loaded when it is needed; wheels that do not match are one line."""

import sys

import pytest

from tests.support.processes import python, run

HEAVY = {"casadi", "pinocchio", "scipy", "matplotlib", "numpy", "meshcat", "osqp", "coal"}
# Problems are built of these two; a list of them needs nothing else that is heavy but NumPy.
MODELS = {"numpy", "casadi", "pinocchio", "coal"}
LOADED = "print(*sorted({name.partition('.')[0] for name in sys.modules} & set(sys.argv[1:])))"
HELP = """
from click.testing import CliRunner
from trajopt.cli.commands import COMMANDS, main
for words in ([], *([name] for name in COMMANDS)):
    result = CliRunner().invoke(main, [*words, "--help"])
    assert result.exit_code == 0, result.output
    assert "Usage:" in result.output
"""


LIST = """
from click.testing import CliRunner
from trajopt.cli.commands import main
assert CliRunner().invoke(main, ["list"]).exit_code == 0
"""
MISMATCH = """
import sys, trajopt.versions
import importlib.metadata as metadata
real = metadata.version
trajopt.versions.version = lambda name: "0.0.1" if name == "casadi" else real(name)
from trajopt.cli import main
sys.argv = ["trajopt", *sys.argv[1:]]
sys.exit(main())
"""


@pytest.mark.parametrize(
    "code", ["import trajopt", "import trajopt.cli", HELP], ids=["library", "cli", "help"]
)
def test_nothing_heavy_is_loaded_at_the_start(code: str) -> None:
    assert _heavy_after(code) == set()


def test_a_list_of_problems_loads_what_problems_are_built_of() -> None:
    assert _heavy_after(LIST) <= MODELS


def _heavy_after(code: str) -> set[str]:
    """What is heavy and loaded by a process of its own that has run the code."""
    done = python(f"import sys\n{code}\n{LOADED}", *HEAVY)
    assert done.returncode == 0, done.stderr
    return set(done.stdout.split())


@pytest.mark.long
def test_wheels_that_do_not_match_end_in_one_line():
    done = python(MISMATCH, "solve", "ur5-reach")
    assert done.returncode == 2
    assert done.stdout == ""
    (line,) = done.stderr.strip().splitlines()
    assert "casadi 0.0.1" in line
    assert "pip install casadi==" in line


@pytest.mark.long
def test_package_runs_the_command_line():
    done = run(sys.executable, "-m", "trajopt", "solve", "no-such-problem")
    assert done.returncode == 2
    assert "no-such-problem" in done.stderr
