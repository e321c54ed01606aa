"""The exception codes: every reason and every end of a command has one, and it does not mislead."""

from __future__ import annotations

from itertools import product

import pytest

from gateway.control.command import Channel, Command, Reason, Result, Source, Status, Verb
from gateway.control.state import Standing
from gateway.image import Missing
from gateway.modbus_tcp.codes import BESIDE_A_STOP, CODE_FOR, REFUSED, ExceptionCode, exception_of
from gateway.modbus_tcp.mirror_map import ENDED, OWNERS, REASONS, STANDINGS, STATUSES, UNDER_WAY

SENT_NOTHING = {1, 2, 3, 6}
COMMAND = Command("d1", Verb.RUN, Source(Channel.MODBUS_TCP, "10.0.0.7"), 0.0, 1.0)


def code(status: Status, reason: Reason) -> int | None:
    """Return the exception of a result; None for a good answer."""
    found = exception_of(Result(COMMAND, status, reason))
    return None if found is None else int(found)


def test_the_tables_are_complete() -> None:
    """Whatever is added to the words of control has to be given its codes and numbers here."""
    assert set(CODE_FOR) == set(Missing)
    assert set(REFUSED) == set(Reason)
    assert set(REASONS) == set(Reason)
    assert set(STATUSES) == set(Status)
    assert set(STANDINGS) == set(Standing)
    assert set(OWNERS) == set(Channel)


def test_the_numbers_of_the_mirror_are_told_apart() -> None:
    """No two words have one number, and 0 is nobody, nothing, none."""
    for table in (REASONS, STATUSES, STANDINGS, OWNERS):
        assert len(set(table.values())) == len(table)
    assert REASONS[Reason.NONE] == 0
    assert len({UNDER_WAY, ENDED, *STATUSES.values()}) == 2 + len(STATUSES)
    assert not {0} & {*STATUSES.values(), *STANDINGS.values(), *OWNERS.values()}


@pytest.mark.hazard("H22")
@pytest.mark.parametrize(("status", "reason"), list(product(Status, Reason)))
def test_every_end_has_its_code(status: Status, reason: Reason) -> None:
    """Done is no exception; an unknown outcome is 0BH; what was sent and failed is not told as never sent.

    But for words beside a stop: the stop was sent, and they were not.
    """
    found = code(status, reason)
    match status:
        case Status.DONE:
            assert found is None
        case Status.UNKNOWN:
            assert found == 0x0B
        case Status.FAILED:
            assert found in (0x04, 0x0B) or (reason in BESIDE_A_STOP and found == REFUSED[reason])
        case Status.REFUSED:
            assert found == REFUSED[reason]
            assert found != ExceptionCode.ACKNOWLEDGE


CODES = [
    (1, "no right, or nobody may", [Reason.NOT_PERMITTED, Reason.NOT_CONTROLLED]),
    (2, "the number", [Reason.NOT_IN_MODEL, Reason.READ_ONLY, Reason.FORBIDDEN, Reason.STORED]),
    (3, "the value", [Reason.RANGE, Reason.MALFORMED]),
    (4, "as the drive or the store is", [Reason.NO_WATCHDOG, Reason.WORN, Reason.NO_STORE]),
    (6, "not now", [Reason.NOT_OWNER, Reason.NOT_ARMED, Reason.BUSY, Reason.QUIESCED, Reason.EXPIRED,
                    Reason.SUPERSEDED, Reason.STOPPED, Reason.TOO_OFTEN, Reason.ENDING]),
    (0x0A, "the way to the drive", [Reason.LINE_DOWN, Reason.UNKNOWN_DRIVE]),
    (0x0B, "the drive is silent", [Reason.OFFLINE, Reason.NO_ANSWER]),
]  # fmt: skip


@pytest.mark.hazard("H04")
@pytest.mark.hazard("H27")
@pytest.mark.hazard("H28")
@pytest.mark.parametrize(("number", "reason"), [(row[0], reason) for row in CODES for reason in row[2]])
def test_the_table_of_refusals(number: int, reason: Reason) -> None:
    """As the documentation says."""
    assert code(Status.REFUSED, reason) == number


@pytest.mark.parametrize(
    ("number", "reason"),
    [(4, Reason.REFUSED_BY_DRIVE), (4, Reason.NOT_READ_BACK), (4, Reason.EXPIRED), (4, Reason.STILL_TRIPPED),
     (4, Reason.NO_STORE), (0x0B, Reason.NO_ANSWER), (0x0B, Reason.OFFLINE)],
)  # fmt: skip
def test_the_table_of_failures(number: int, reason: Reason) -> None:
    """Something was sent: the drive said no, holds something else, or was lost."""
    assert code(Status.FAILED, reason) == number
