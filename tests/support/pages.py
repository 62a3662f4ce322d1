"""The documents, and the Python in them."""

import re

from tests.support.repository import ROOT

PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").rglob("*.md"))]
# Python that is more than a block: the tutorial saves it to files, which its own test does.
ANY_BLOCK = re.compile(r"^ *```(?:python|py)\b[^\n]*\n(.*?)^ *```$", re.DOTALL | re.MULTILINE)
