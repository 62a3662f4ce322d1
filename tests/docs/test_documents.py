"""The Python of the documents runs, and what it solves is solved and passes the check."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from tests.support.repository import ROOT

NOT_OURS = {"puppy.py", "paw.py"}  # files that a reader makes
DOCUMENTS = (
    "README.md",
    "docs/robots.md",
    "docs/warm-starts.md",
    "docs/suite.md",
    "docs/watching.md",
    "docs/how-to/send-a-motion-to-a-robot.md",
    "docs/accuracy.md",
    "docs/front.md",
    "docs/refinement.md",
    "docs/diagnose.md",
    "docs/modelling/bases.md",
    "docs/modelling/coordinates.md",
    "docs/modelling/actuators.md",
    "docs/modelling/irb1600.md",
    "docs/modelling/contacts.md",
    "docs/modelling/contacts-dynamics.md",
    "docs/modelling/terrain.md",
    "docs/modelling/objectives.md",
    "docs/modelling/obstacles.md",
    "docs/modelling/periodicity.md",
    "docs/modelling/structure.md",
    "docs/modelling/reduced-models.md",
    "docs/modelling/scene.md",
)
SOURCES = ("trajopt", "problems", "robots", "scripts", "tests")
SOURCES_NAMED = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]
BLOCK = re.compile(r"^```python\n(.*?)^```$", re.DOTALL | re.MULTILINE)


def blocks(document: str) -> list[str]:
    """The Python blocks of a document, in order."""
    return BLOCK.findall((ROOT / document).read_text(encoding="utf-8"))


ALL = [(document, index) for document in DOCUMENTS for index in range(len(blocks(document)))]


@pytest.mark.parametrize("document", DOCUMENTS)
def test_documents_have_python_blocks(document: str) -> None:
    assert blocks(document)


@pytest.mark.parametrize("document", SOURCES_NAMED, ids=lambda path: str(path.relative_to(ROOT)))
def test_source_files_that_documents_name_exist(document: Path) -> None:
    text = document.read_text(encoding="utf-8")
    named = set(re.findall(r"`([\w/]+\.(?:py|cpp|hpp))`", text)) - NOT_OURS
    sources = [path for folder in SOURCES for path in (ROOT / folder).rglob("*.*")]
    missing = {name for name in named if not any(path.as_posix().endswith("/" + name) for path in sources)}
    assert missing == set()


@pytest.mark.slow
@pytest.mark.parametrize(("document", "index"), ALL)
def test_python_block_runs(
    document: str, index: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    namespace: dict[str, object] = {"__name__": "__main__"}
    exec(compile(blocks(document)[index], f"{document}, block {index}", "exec"), namespace)
    if "solution" in namespace:
        assert namespace["solution"].meta["status"] == "solved"
        assert namespace["report"].failures() == ()
        assert list(tmp_path.glob("*.npz"))
