"""Figures of reports: values with unit, limit, verdict and place, printed one a line."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field, fields, is_dataclass
from typing import Any, ClassVar

import numpy as np

from trajopt.motion.meta import jsonable
from trajopt.motion.traces import Occurrence


@dataclass(frozen=True, kw_only=True)
class Figure:
    """Presentation of a figure: text, unit, the tolerance that judges it, or why none does."""

    text: str
    unit: str = ""
    tolerance: str | None = None
    margin: bool = False  # a margin must not be less than minus the tolerance
    least: bool = False  # the tolerance is the smallest value allowed
    why: str = ""  # shown instead of a tolerance
    scale: float = 1.0  # of the unit that is shown: 1e3 for ms of a time in s
    limit: Callable[[Any], float | None] = lambda report: None
    applies: Callable[[Any], bool] = lambda report: True


def figure(text: str, unit: str = "", tolerance: str | None = None, **presentation: Any) -> Any:
    """Return a field of a report with its presentation."""
    return field(metadata={"figure": Figure(text=text, unit=unit, tolerance=tolerance, **presentation)})


@dataclass(frozen=True, kw_only=True)
class MeasuredFigure:
    """A figure of a motion with its verdict.

    Args:
        text: what it is.
        value: in its unit.
        unit: as text.
        limit: the bound of the value; None if it is not judged.
        lower: whether the limit is a lower bound.
        why: why it is not judged.
        beyond: whether the value is beyond its limit.
        place: where it is worst.
        natural: the value in natural units, if it is printed too.
        open_ended: whether the value is only a lower bound.
    """

    text: str
    value: float
    unit: str = ""
    limit: float | None = None
    lower: bool = False
    why: str = ""
    beyond: bool = False
    place: Occurrence | None = None
    natural: float | None = None
    open_ended: bool = False

    def __str__(self) -> str:
        natural = "" if self.natural is None else f" ({self.natural:.3f})"
        value = "-" if math.isnan(self.value) else f"{self.value:.3g}"
        return f"{'>= ' if self.open_ended else ''}{value}{natural}"

    def line(self, width: int, form: str = ".3e", limit_form: str = ".0e") -> str:
        """Return a line of a table; ``width`` is that of the text, the forms are those of numbers."""
        allowed = self.why if self.limit is None else f"{self.limit:10{limit_form}}"
        verdict, place = "beyond" if self.beyond else "", "" if self.place is None else self.place
        measured = f"{self.text:{width}}{self.value:12{form}}  {self.unit:14}"
        return f"{measured}{allowed:>10}  {verdict:6}  {place}".rstrip()


def compared(rows: Sequence[str], columns: Mapping[str, Sequence[MeasuredFigure]]) -> list[str]:
    """Lines of a table of figures, with the texts of its ``rows`` and the titles of its columns."""
    lines = [("", *columns), *zip(rows, *columns.values(), strict=True)]
    return [f"{text:16}" + "".join(f"{cell!s:>19}" for cell in cells) for text, *cells in lines]


@dataclass(frozen=True, kw_only=True)
class FigureReport:
    """A report whose fields are figures, see `figure`, or records or mappings of figures."""

    # Properties that the JSON has beside the fields.
    DERIVED: ClassVar[tuple[str, ...]] = ()
    # Width of texts, and forms of values and limits.
    FORM: ClassVar[tuple[int, str, str]] = (38, ".4g", ".3g")

    def figures(self) -> list[MeasuredFigure]:
        """The figures that apply, with their limits and verdicts."""
        return [*_measured(self, ())]

    def to_dict(self) -> dict[str, Any]:
        """JSON-able figures."""
        return jsonable({name: getattr(self, name) for name in self.DERIVED} | asdict(self))

    def table(self) -> str:
        """The figures as text, one a line, and notes."""
        figures, head = self.figures(), f"{'':{self.FORM[0]}}{'value':>12}  {'unit':14}{'limit':>10}"
        judged = any(each.limit is not None for each in figures)
        lines = [head] * judged + [each.line(*self.FORM) for each in figures]
        return "\n".join([*lines, *(f"note: {note}" for note in getattr(self, "notes", ()))])


def _measured(record: Any, names: Sequence[str]) -> Iterator[MeasuredFigure]:
    """Figures of a record's fields, and of the records and mappings in it; ``names`` precede their texts."""
    for entry in fields(record):
        shown, value = entry.metadata.get("figure"), getattr(record, entry.name)
        if shown is None or value is None or not shown.applies(record):
            continue
        limit, text = shown.limit(record), [each for each in (*names, shown.text) if each]
        if is_dataclass(value):
            yield from _measured(value, text)
            continue
        for name, number in value.items() if isinstance(value, Mapping) else [("", value)]:
            if number is not None:
                number = number.max() if isinstance(number, np.ndarray) else number  # the worst
                yield MeasuredFigure(
                    text=", ".join([*text, name.replace("_", " ")] if name else text),
                    value=number if shown.scale == 1.0 else shown.scale * number,
                    unit=shown.unit,
                    limit=limit,
                    beyond=limit is not None and not number <= limit,
                )
