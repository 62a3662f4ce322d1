"""The launcher speaks in one line when the package cannot be imported."""

import sys

from processes_for_tests import python, run

MISMATCH = """
import sys, trajopt.versions, types
import importlib.metadata as metadata
real = metadata.version
trajopt.versions.version = lambda name: "0.0.1" if name == "casadi" else real(name)
for name in [name for name in sys.modules if name == "trajopt" or name == "trajopt.cli"]:
    del sys.modules[name]
from scripts.launch import main
sys.exit(main())
"""


def test_wheels_that_do_not_match_end_in_one_line():
    done = python(MISMATCH)
    assert done.returncode == 2
    assert done.stdout == ""
    (line,) = done.stderr.strip().splitlines()
    assert "casadi 0.0.1" in line
    assert "pip install casadi==" in line


def test_launcher_runs_the_command_line():
    done = run(sys.executable, "-m", "scripts.launch", "solve", "no-such-problem")
    assert done.returncode == 2
    assert "no-such-problem" in done.stderr
