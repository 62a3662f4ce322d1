"""The Python of the documents passes `mypy --strict`, as a user's own code beside the library would."""

import subprocess
import sys
import textwrap
from pathlib import Path

import pytest

from tests.support.pages import ANY_BLOCK, PAGES
from tests.support.repository import ROOT

CONTRIBUTING = ROOT / "CONTRIBUTING.md"
# Packages without types, those that only an installed wheel has as folders, and a file that a reader makes.
UNTYPED = ("casadi", "mujoco", "pinocchio", "scipy", "trajopt_library", "puppy")
SETTINGS = "[mypy]\n" + "".join(
    f"[mypy-{name}.*,{name}]\nignore_missing_imports = true\n" for name in UNTYPED
)


@pytest.mark.slow
def test_python_of_the_documents_has_right_types(tmp_path: Path) -> None:
    for page in PAGES:
        if page == CONTRIBUTING:  # extends the library itself
            continue
        for number, block in enumerate(ANY_BLOCK.findall(page.read_text(encoding="utf-8"))):
            name = "_".join(page.relative_to(ROOT).with_suffix("").parts).replace("-", "_")
            (tmp_path / f"{name}_{number}.py").write_text(textwrap.dedent(block), encoding="utf-8")
    (tmp_path / "mypy.ini").write_text(SETTINGS, encoding="utf-8")
    command = [sys.executable, "-m", "mypy", "--strict", "--config-file", "mypy.ini", "."]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout
