"""The command line ends a solver that does not return from a step."""

import subprocess
import sys

STUCK = """
import time
from trajopt import progress
progress.GRACE = 0.1
with progress.watched("stuck", 0.1) as watch:
    watch({"iteration": 0, "objective": 0.0, "primal": 0.0, "dual": 0.0, "restoration": False})
    time.sleep(30.0)
"""

RETURNING = STUCK.replace("time.sleep(30.0)", "pass") + "\ntime.sleep(1.0)\nprint('done')"


def test_a_solver_beyond_its_time_limit_ends_the_program_in_one_line():
    done = subprocess.run([sys.executable, "-c", STUCK], capture_output=True, text=True)
    assert done.returncode == 1
    (line,) = done.stderr.strip().splitlines()
    assert "time limit of 0.1 s" in line


def test_a_solver_that_returns_is_left_alone():
    done = subprocess.run([sys.executable, "-c", RETURNING], capture_output=True, text=True)
    assert done.returncode == 0
    assert done.stdout.strip() == "done"
