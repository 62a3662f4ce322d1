"""What takes long to load is loaded when it is needed, not when the library or the command line starts."""

import subprocess
import sys

import pytest

HEAVY = {"casadi", "pinocchio", "scipy", "matplotlib", "numpy", "meshcat", "osqp", "coal"}
# Seconds after which a start that should take a fraction of one is ended.
LIMIT = 120
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


@pytest.mark.parametrize(
    "code", ["import trajopt", "import trajopt.cli", HELP], ids=["library", "cli", "help"]
)
def test_nothing_heavy_is_loaded_at_the_start(code: str) -> None:
    assert _heavy_after(code) == set()


def test_a_list_of_problems_loads_what_problems_are_built_of() -> None:
    assert _heavy_after(LIST) <= MODELS


def _heavy_after(code: str) -> set[str]:
    """What is heavy and loaded by a process of its own that has run the code."""
    done = subprocess.run(
        [sys.executable, "-c", f"import sys\n{code}\n{LOADED}", *HEAVY],
        capture_output=True,
        text=True,
        timeout=LIMIT,
    )
    assert done.returncode == 0, done.stderr
    return set(done.stdout.split())
