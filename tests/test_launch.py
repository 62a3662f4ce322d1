"""The command speaks in one line where the wheels are not those that the extension was compiled against."""

import subprocess
import sys

# Seconds after which a command that should end at once is ended.
LIMIT = 120

MISMATCH = """
import sys, trajopt.versions
import importlib.metadata as metadata
real = metadata.version
trajopt.versions.version = lambda name: "0.0.1" if name == "casadi" else real(name)
from trajopt.cli import main
sys.argv = ["trajopt", *sys.argv[1:]]
sys.exit(main())
"""


def test_wheels_that_do_not_match_end_in_one_line():
    done = subprocess.run(
        [sys.executable, "-c", MISMATCH, "solve", "ur5-reach"], capture_output=True, text=True, timeout=LIMIT
    )
    assert done.returncode == 2
    assert done.stdout == ""
    (line,) = done.stderr.strip().splitlines()
    assert "casadi 0.0.1" in line
    assert "pip install casadi==" in line


def test_package_runs_the_command_line():
    done = subprocess.run(
        [sys.executable, "-m", "trajopt", "solve", "no-such-problem"],
        capture_output=True,
        text=True,
        timeout=LIMIT,
    )
    assert done.returncode == 2
    assert "no-such-problem" in done.stderr
