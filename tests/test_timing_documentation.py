"""docs/timing.md: its sums and its table are what `check` says."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from gateway import check
from gateway.bus import traffic
from gateway.bus.plan import plan_drive
from gateway.bus.response import Stream, Traffic
from tests.test_check import FIVE, built

PAGE = (Path(__file__).parents[1] / "docs" / "timing.md").read_text(encoding="utf-8")
BAUDS = (9600, 19200, 38400)
DRIVES = (1, 2, 3, 4, 5, 6, 7, 8, 10, 12, 16, 20, 24, 28, 31)
STEP = 10  # ms


def said(drives: int, baud: int, every: str) -> str:
    """Return what `check` says of that many VF-nC3 of which five values are read."""
    return "\n".join(check.report(built([{"values": FIVE, "every": every}], drives, baud)))


def fastest(drives: int, baud: int) -> int:
    """Return the period in ms that is reachable as fast as possible, as `check` prints it."""
    found = re.search(r"asked as fast as possible, reachable about (\d+) ms", said(drives, baud, "0s"))
    assert found is not None
    return int(found[1])


def in_time(drives: int, baud: int) -> int:
    """Return the shortest period in steps of 10 ms with which every poll is answered before it falls due again."""
    (line,) = built([{"values": FIVE, "every": "1s"}], drives, baud).lines
    whole = traffic.undisturbed(line, [plan_drive(drive, line, with_selectors=True) for drive in line.drives])

    def is_kept(period: int) -> bool:
        polls = [Stream(period / 1000 if each.period == 1.0 else each.period, each.cost) for each in whole.polls]
        return Traffic(polls, whole.ahead, whole.reserved).is_kept

    period = fastest(drives, baud) // STEP * STEP
    while not is_kept(period):
        period += STEP
    return period


def table() -> list[list[str]]:
    """Return the cells of the page's table."""
    rows = [[cell.strip() for cell in row.strip("|").split("|")] for row in PAGE.splitlines() if row.startswith("| ")]
    start = next(place for place, row in enumerate(rows) if row[0] == "drives")
    return [row for row in rows[start:] if row[0].isdigit()]


@pytest.mark.unmeasured
@pytest.mark.parametrize("baud", BAUDS)
def test_the_table_is_what_check_says(baud: int) -> None:
    """As fast as possible, and the shortest period that is kept, for 1 to 31 drives."""
    column = 1 + 2 * BAUDS.index(baud)
    rows = table()
    assert [int(row[0]) for row in rows] == list(DRIVES)
    for row in rows:
        drives = int(row[0])
        assert row[column : column + 2] == [str(fastest(drives, baud)), str(in_time(drives, baud))], (drives, baud)


def test_check_says_from_which_period_on_polls_are_in_time() -> None:
    """Eight drives at 19200 baud: by the period of the table they are, a step less and they are not."""
    (row,) = (row for row in table() if row[0] == "8")
    period = int(row[4])
    assert "Every poll is answered before it falls due again" in said(8, 19200, f"{period}ms")
    less = said(8, 19200, f"{period - STEP}ms")
    assert "LATE AT TIMES" in less or "DOES NOT FIT" in less


def test_the_exchange_that_the_page_adds_up_is_the_planners() -> None:
    """Five words by the block at 19200 baud."""
    (line,) = built([{"values": FIVE, "every": "1s"}]).lines
    (drive,) = line.drives
    plan = plan_drive(drive, line, with_selectors=True)
    ((_, (read,)),) = plan.groups
    assert f"= {plan.planner.cost(read.request) * 1000:.1f} ms" in PAGE


def test_what_check_prints_on_the_page_is_what_it_prints() -> None:
    """The example of two groups that do not fit, word for word."""
    polls = [{"values": FIVE, "every": "200ms"}, {"values": ["trip_code"], "every": "2s"}]
    lines = list(check.report(built(polls, 8)))
    shown = [line for line in lines if "DOES NOT FIT" in line or "In time whatever" in line]
    shown += [line for line in lines if "asked " in line][:2]
    assert len(shown) == 4
    words = " ".join(PAGE.split())
    for line in shown:
        assert line.strip() in words, line
