"""What a program printed against what a document says it prints."""

import re

NUMBER = re.compile(r"[-+]?(?:\d+\.\d*|\.\d+|\d+)(?:[eE][-+]?\d+)?")
# In a document: anything, to the end of the line.
REST = "..."


def unit_of(number: str) -> float:
    """One unit in the last digit of a number as it is written."""
    mantissa, _, exponent = number.lower().partition("e")
    decimals = len(mantissa.partition(".")[2])
    return float(10.0 ** (int(exponent or 0) - decimals)) if decimals or exponent else 0.0


def difference(stated: str, printed: str) -> str:
    """Where printed lines are not those stated, numbers to the stated digits; empty where they are.

    Whole numbers are equal; times and what else may change are left out by ``...``.
    """
    expected, lines = stated.strip().splitlines(), printed.strip().splitlines()
    if len(expected) != len(lines):
        return f"{len(lines)} lines are printed, {len(expected)} stated: {printed.strip()}"
    for one, other in zip(expected, lines, strict=True):
        head, cut, _ = one.partition(REST)
        texts = NUMBER.split(head.strip()), NUMBER.split(other.strip())
        numbers = NUMBER.findall(head), NUMBER.findall(other)
        same = texts[1][: len(texts[0]) - 1] == texts[0][:-1] if cut else texts[0] == texts[1]
        near = all(abs(float(a) - float(b)) <= 1.01 * unit_of(a) for a, b in zip(*numbers, strict=False))
        if not (same and near):
            return f"printed: {other.strip()}\nstated:  {one.strip()}"
    return ""
