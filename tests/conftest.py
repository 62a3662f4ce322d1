"""What every test shares: assertions of helpers say what they found, and which tests are quick."""

import os
import sys
from pathlib import Path

# Before OpenMP is loaded: rounding depends on the number of threads, `trajopt suite` measures with one.
os.environ.setdefault("OMP_NUM_THREADS", "1")
# Where no bytecode is to lie beside the sources, it lies in pytest's cache: workers, and processes that tests
# start, compile some thousand modules otherwise (20 s for each worker).
if sys.dont_write_bytecode:
    sys.dont_write_bytecode = False
    os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
    sys.pycache_prefix = str(Path(__file__).parents[1] / ".pytest_cache" / "bytecode")
    os.environ["PYTHONPYCACHEPREFIX"] = sys.pycache_prefix

import pytest

pytest.register_assert_rewrite("tests.support", "tests.extremes")


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Mark as ``quick`` the first case of each test that is neither ``long`` nor ``slow``."""
    seen = set()
    for item in items:
        test = item.nodeid.partition("[")[0]
        if test not in seen and not {"long", "slow"} & {mark.name for mark in item.iter_markers()}:
            seen.add(test)
            item.add_marker(pytest.mark.quick)


@pytest.fixture(scope="session", autouse=True)
def solved_motions(tmp_path_factory: pytest.TempPathFactory) -> None:
    """Where all workers of a session keep the solutions of `tests.support.solved_problems.motion`."""
    base = tmp_path_factory.getbasetemp()
    folder = (base.parent if "PYTEST_XDIST_WORKER" in os.environ else base) / "motions"
    folder.mkdir(exist_ok=True)
    os.environ["SOLVED_MOTIONS"] = str(folder)


@pytest.fixture
def noted(tmp_path: Path) -> Path:
    """A folder in which cases of ``t-fated`` note that they run."""
    folder = tmp_path / "noted"
    folder.mkdir()
    return folder
