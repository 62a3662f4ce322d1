"""Starts: what takes long to load is loaded when it is needed; wheels that do not match are one line."""

import sys
from pathlib import Path
from typing import Any

import pytest

from tests.support.processes import python, run

START = {"click", "lazy_loader", "platformdirs", "typing_extensions"}
MODELS = {"numpy", "casadi", "pinocchio", "coal"}
PHYSICS = {"mujoco", "glfw", "piqp"}
DRAWING = {"matplotlib", "mpl_toolkits", "PIL", "cycler", "dateutil", "fontTools", "kiwisolver", "packaging"}
PAGE = {"meshcat", "IPython", "PIL", "colorama", "pygments", "tornado", "traitlets", "umsgpack", "zmq"}
# What a command may load besides `START`, third-party packages alone. OSQP and PIQP need SciPy for sparse
# programs (guesses of walks), diagnosis for factorisations, and each mesh once: its hull is then in
# the cache.
MAY_LOAD = {
    "list": MODELS,
    "list --json": set(),  # from the cache, where the first has left it
    "solve hopper-hop -o hop.npz": MODELS,
    "solve ur5-reach --intervals 4 -o reach.npz": MODELS,
    "check hop.npz": MODELS,
    "simulate hop.npz": MODELS | PHYSICS,
    "drive ur5 --script place.csv --seconds 0.1": MODELS | PHYSICS,
    "replay hop.npz --html hop.html": MODELS | PAGE,
    "plot hop.npz -o hop.svg": MODELS | DRAWING | {"pyparsing"},
}
LOADED = """
packages = {name.partition(".")[0] for name in set(sys.modules) - begin} - set(sys.stdlib_module_names)
print(*(name for name in packages if name[0] != "_" and sys.modules[name].__spec__))
"""
HELP = """
from click.testing import CliRunner
from trajopt.cli.commands import COMMANDS, main
for words in ([], *([name] for name in COMMANDS)):
    result = CliRunner().invoke(main, [*words, "--help"])
    assert result.exit_code == 0, result.output
    assert "Usage:" in result.output
"""
COMMAND = """
from click.testing import CliRunner
from trajopt.cli.commands import main
result = CliRunner().invoke(main, {words})
assert result.exit_code in (0, 1), result.output
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
    assert _loaded_by(code) <= START


@pytest.mark.long
def test_commands_load_the_packages_that_they_need(tmp_path: Path) -> None:
    (tmp_path / "place.csv").write_text("time,x,y,z\n0.0,0.5,0.2,0.5\n")
    for command, packages in MAY_LOAD.items():
        loaded = _loaded_by(COMMAND.format(words=command.split()), cwd=tmp_path)
        assert loaded <= START | packages, command


def _loaded_by(code: str, **options: Any) -> set[str]:
    """Third-party packages that a process of its own has loaded for the code."""
    done = python(f"import sys\nbegin = set(sys.modules)\n{code}\n{LOADED}", **options)
    assert done.returncode == 0, done.stderr
    return set(done.stdout.split()) - {"trajopt", "trajopt_library"}


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
