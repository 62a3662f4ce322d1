"""Links between documents: files exist, and so do headings; the site's own links are tested by its build."""

import re
from pathlib import Path

import pytest

from tests.support.repository import ROOT

DOCUMENTS = sorted([*ROOT.glob("*.md"), *(ROOT / "docs").rglob("*.md")])
CODE = re.compile(r"^ *```.*?^ *```$|`[^`\n]*`", re.DOTALL | re.MULTILINE)
LINK = re.compile(r"\]\(([^)\s]+)\)")
HEADING = re.compile(r"^#{1,6} +(.+)$", re.MULTILINE)
# Pages that only the site has, by folder.
GENERATED = ("docs/reference/", "docs/tutorials/", "docs/contributing.md", "docs/changelog.md")


def anchors(document: Path) -> set[str]:
    """Names of a document's headings as code hosts and MkDocs make them."""
    text = re.sub(r"^```.*?^```$", "", document.read_text(encoding="utf-8"), flags=re.DOTALL | re.MULTILINE)
    headings = (re.sub(r"\]\([^)]*\)", "", heading).lower() for heading in HEADING.findall(text))
    slugs = {re.sub(r" +", "-", re.sub(r"[^\w\s-]", "", heading).strip()) for heading in headings}
    return slugs | set(re.findall(r'<a id="([^"]+)">', text))


@pytest.mark.parametrize("document", DOCUMENTS, ids=lambda path: str(path.relative_to(ROOT)))
def test_links_lead_to_files_and_headings(document: Path) -> None:
    text = CODE.sub("", document.read_text(encoding="utf-8"))
    for link in LINK.findall(text):
        if re.match(r"[a-z]+:", link):
            continue
        path, _, anchor = link.partition("#")
        target = (document.parent / path).resolve() if path else document
        if str(target.relative_to(ROOT)).startswith(GENERATED) and not target.exists():
            continue
        assert target.exists(), link
        if anchor and target.suffix == ".md":
            assert anchor in anchors(target), link
