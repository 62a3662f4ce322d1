"""Sections of documents that scripts write. Only the standard library is needed."""

import re


def written(text: str, marker: str, lines: str) -> str:
    """The text with ``lines`` between the two comments of a marker."""
    between = re.compile(rf"(?<=<!-- {marker} -->\n).*?(?=<!-- end of {marker} -->)", re.DOTALL)
    return between.sub(lambda _: f"\n{lines}\n", text)
