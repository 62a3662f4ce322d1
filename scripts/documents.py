"""Sections of documents that scripts write, and their tables. Only the standard library is needed."""

import csv
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path


def written(text: str, marker: str, lines: str) -> str:
    """The text with ``lines`` between the two comments of a marker."""
    between = re.compile(rf"(?<=<!-- {marker} -->\n).*?(?=<!-- end of {marker} -->)", re.DOTALL)
    return between.sub(lambda _: f"\n{lines}\n", text)


def write_sections(document: Path, sections: Mapping[str, str]) -> None:
    """Write lines between the comments of their markers."""
    text = document.read_text(encoding="utf-8")
    for marker, lines in sections.items():
        text = written(text, marker, f"{lines}\n")
    document.write_text(text, encoding="utf-8")


def table(titles: Sequence[str], rows: Iterable[Sequence[str]]) -> Iterator[str]:
    """Lines of a Markdown table."""
    yield f"| {' | '.join(titles)} |"
    yield "|" + "---|" * len(titles)
    for row in rows:
        yield f"| {' | '.join(row)} |"


def cells(lines: str) -> Iterator[list[str]]:
    """Titles and rows of a Markdown table, without marks of code."""
    titles, _, *rows = lines.replace("`", "").strip().splitlines()
    return ([cell.strip() for cell in line.strip()[1:-1].split("|")] for line in (titles, *rows))


def write_csv(path: Path, lines: str) -> None:
    """Write a Markdown table as CSV."""
    with path.open("w", encoding="utf-8", newline="") as stream:
        csv.writer(stream, lineterminator="\n").writerows(cells(lines))
