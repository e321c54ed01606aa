"""The tables of docs/protocols.md, taken apart."""

from __future__ import annotations

import re
from pathlib import Path

PAGE = (Path(__file__).parents[1] / "docs" / "protocols.md").read_text(encoding="utf-8")

Table = list[list[str]]


def cells(line: str) -> list[str]:
    """Return the cells of a line of a table."""
    return [cell.strip() for cell in line.strip().strip("|").split("|")]


def tables() -> list[Table]:
    """Return the page's tables, each with its heading first and without the line below that."""
    blocks = re.findall(r"(?:^\|.*\n)+", PAGE, re.MULTILINE)
    return [[cells(line) for place, line in enumerate(block.splitlines()) if place != 1] for block in blocks]


def headed(first: str) -> Table:
    """Return the one table whose heading begins so, its heading first."""
    (found,) = [rows for rows in tables() if rows[0][0] == first]
    return found


def table(first: str) -> Table:
    """Return the rows of that table, its heading left out."""
    return headed(first)[1:]


def spans(cell: str) -> list[str]:
    """Return what stands between backticks."""
    return re.findall(r"`([^`]+)`", cell)
