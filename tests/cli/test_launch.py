"""The command speaks in one line where the wheels are not those that the extension was compiled against."""

import sys

import pytest

from tests.support.processes import python, run

MISMATCH = """
import sys, trajopt.versions
import importlib.metadata as metadata
real = metadata.version
trajopt.versions.version = lambda name: "0.0.1" if name == "casadi" else real(name)
from trajopt.cli import main
sys.argv = ["trajopt", *sys.argv[1:]]
sys.exit(main())
"""


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
