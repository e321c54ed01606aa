"""The reckoning of the time-outs: what a good exchange waits for at the worst, by hand and on a scripted line."""

from __future__ import annotations

import math
import re
from decimal import Decimal
from functools import cache
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from gateway import site
from gateway.bus import refresh
from gateway.bus.blocks import Planner
from gateway.bus.exchange import Exchanger
from gateway.bus.refresh import OWN_TIME
from gateway.errors import BadReply, NoReply
from gateway.metrics import LineStats
from gateway.protocol.pdu import Identify, ReadBlock, ReadWords, Request, WriteRam, WriteStored
from gateway.protocol.timing import LineTiming
from tests import virtual

BAUD = 19200
GAP = 3.5 * 11 / BAUD
MARGIN = 0.050
NC3, MB1 = 0.015, 0.010  # seconds of processing
EEPROM = 0.050


def built(*drives: dict[str, Any], **line: Any) -> site.Site:
    """Return a site of one line: drives p1, p2 ..., VF-nC3, commanded with a lease and an F803 of 1.5 s."""
    entries = [
        {
            "name": f"p{place}",
            "number": place,
            "model": "vf-nc3",
            "control": "leased",
            "communication_timeout": "1.5s",
            "timeout_action": "stop",
            **drive,
        }
        for place, drive in enumerate(drives, 1)
    ]
    section = {"name": "a", "port": "/dev/ttyUSB0", "baud": BAUD, "drive": entries, **line}
    return site.build({"gateway": {"name": "g"}, "line": [section]}, "test", Path())


def read_only(**more: Any) -> dict[str, Any]:
    """Return a drive that nobody commands."""
    return {"control": "off", "communication_timeout": None, "timeout_action": None, **more}


def by_hand(request: int, answer: int, processing: float = NC3) -> float:
    """Return the time of an exchange of that many characters: four gaps, 11 and 12 bits, margin, own time."""
    return 4 * GAP + request * 11 / BAUD + processing + MARGIN + answer * 12 / BAUD + 0.003


def good(request: int, answer: int, processing: float = NC3) -> float:
    """Return the time of an exchange of that many characters that is answered in time: two gaps, and no margin."""
    return 2 * GAP + request * 11 / BAUD + processing + answer * 12 / BAUD + 0.003


@pytest.mark.hazard("H06")
@pytest.mark.hazard("H30")
def test_modbus_rtu_by_hand() -> None:
    """One commanded VF-nC3 and one that is read only.

    06H to the EEPROM, 8 and 8 characters, 50 ms in the drive, is under way; an identification, 7 and 64 characters,
    is lost; the 5 words of the block come in 15. Nobody else is stopped; no broadcast, for the other drive may not be
    stopped.
    """
    line = built({}, read_only()).lines[0]
    (pump,) = refresh.refreshes(line)
    assert pump.worst.blocking.seconds == pytest.approx(by_hand(8, 8, EEPROM))
    assert pump.worst.blocking.what == "p1: write to the EEPROM"
    assert pump.worst.lost.seconds == pytest.approx(by_hand(7, 64))
    assert pump.worst.lost.what == "p1: identification"
    assert pump.worst.turns == {"p1": pytest.approx(good(8, 15))}
    assert (pump.worst.stopping, pump.worst.broadcasts) == (0, 0)
    assert pump.worst.lead == pytest.approx(0.1206042 + 0.1200313 + 0.0359688, abs=1e-6)
    assert pump.interval == pytest.approx(0.5)
    assert pump.is_kept
    assert pump.margin == pytest.approx(1 - 0.2766042 / 0.5, abs=1e-6)


@pytest.mark.hazard("H06")
@pytest.mark.hazard("H30")
def test_toshiba_ascii_by_hand() -> None:
    """Two commanded VF-nC3: P of 17 and 17 characters is longer than R of 13 and 17; F803 goes to RAM.

    The broadcast is answered by a drive numbered 00, if there is one: it takes as long as any write.
    """
    line = built(*[{"protocol": "toshiba-ascii"}] * 2).lines[0]
    worst = refresh.worst_case(line)
    assert worst.blocking.seconds == pytest.approx(by_hand(17, 17))
    assert worst.blocking.what == "p1: write"
    assert worst.lost == worst.blocking
    assert worst.turns == {"p1": pytest.approx(good(17, 17)), "p2": pytest.approx(good(17, 17))}
    assert worst.stopping == pytest.approx(good(17, 17))
    assert worst.broadcasts == pytest.approx(by_hand(17, 17))
    assert worst.lead == pytest.approx(3 * 0.0963854 + 3 * 0.0423750, abs=1e-6)
    assert worst.least_timeout == Decimal("1.3")


@pytest.mark.hazard("H06")
@pytest.mark.hazard("H30")
def test_toshiba_binary_by_hand() -> None:
    """A VF-nC3 and a VF-MB1: X of 6 characters, its 5 words in 16; P of 8 and 8; the VF-MB1 answers sooner."""
    line = built({"protocol": "toshiba-binary"}, {"protocol": "toshiba-binary", "model": "vf-mb1"}).lines[0]
    worst = refresh.worst_case(line)
    assert worst.blocking.seconds == pytest.approx(by_hand(6, 16))
    assert worst.blocking.what == "p1: block read"
    assert worst.lost == worst.blocking
    assert worst.turns == {"p1": pytest.approx(good(6, 16)), "p2": pytest.approx(good(6, 16, MB1))}
    assert worst.stopping == pytest.approx(good(6, 16))  # of the slower one
    assert worst.broadcasts == pytest.approx(by_hand(8, 8))
    assert worst.lead == pytest.approx(2 * 0.0894583 + 2 * 0.0354479 + 0.0304479 + 0.0856042, abs=1e-6)
    assert worst.least_timeout == Decimal("1.1")


@pytest.mark.hazard("H30")
def test_three_drives_with_a_time_out_of_one_and_a_half_seconds_are_kept() -> None:
    """VF-nC3 by MODBUS-RTU at 19200 baud, with 50 ms of margin: what the ordinary line looks like."""
    least = {count: refresh.worst_case(built(*[{}] * count).lines[0]).least_timeout for count in (1, 3, 6, 8)}
    assert least == {1: Decimal("1.0"), 3: Decimal("1.3"), 6: Decimal("1.6"), 8: Decimal("1.8")}


@pytest.mark.hazard("H30")
@pytest.mark.parametrize("protocol", ["modbus-rtu", "toshiba-ascii", "toshiba-binary"])
def test_a_turn_is_the_longest_keepalive_as_the_planner_reckons_it(protocol: str) -> None:
    """A longer poll takes no keepalive's turn: not eight words by a direct block."""
    line = built({"protocol": protocol}).lines[0]
    (drive,) = line.drives
    planner = Planner(drive.number, drive.model, drive.codec, line.timing, NC3)
    short: list[Request] = [ReadWords(1, 0xFD00), WriteRam(1, 0xFA00, 0)]
    if planner.has_block:
        short.append(ReadBlock(1, 0x1875, 5))
    turn = refresh.turn(line, drive)
    assert max(planner.cost(request) for request in short) == turn
    assert refresh.worst_case(line).turns == {"p1": pytest.approx(turn + OWN_TIME)}
    if drive.codec.forms.has_direct_block:
        assert planner.cost(ReadWords(1, 0xFD00, 8)) > turn


def test_a_broadcast_that_nobody_answers_takes_its_frame_and_the_drives_processing() -> None:
    """MODBUS number 0: nobody waits for an answer."""
    worst = refresh.worst_case(built({}, {"model": "vf-mb1"}).lines[0])
    assert worst.broadcasts == pytest.approx(2 * GAP + 8 * 11 / BAUD + NC3 + 0.003)


def test_only_drives_whose_eeprom_may_be_written_block_the_line_by_that() -> None:
    """F803 is set in the EEPROM in MODBUS-RTU; selectors where asked for, anything where allowed."""

    def blocking(**drive: Any) -> str:
        return refresh.worst_case(
            built({"communication_timeout": None, "timeout_action": None, **drive}).lines[0]
        ).blocking.what

    assert blocking() == "p1: identification"
    for asked in ({"communication_timeout": "1s"}, {"provision": True}, {"allow_stored": True}):
        assert blocking(**asked) == "p1: write to the EEPROM"
    assert blocking(control="off", allow_stored=True) == "p1: identification"
    assert blocking(protocol="toshiba-ascii", communication_timeout="1s") == "p1: write"


@pytest.mark.hazard("H30")
def test_a_dead_or_slow_neighbour_blocks_the_line_though_nobody_commands_it() -> None:
    """F805 of 0.5 s in a drive that is only read is waited for whenever it is asked."""
    line = built({}, read_only(wait_time="500ms")).lines[0]
    worst = refresh.worst_case(line)
    assert worst.blocking.what == "p2: identification"
    assert worst.blocking.seconds == pytest.approx(by_hand(7, 64, NC3 + 0.5))


@pytest.mark.hazard("H30")
def test_the_shortest_time_out_that_is_told_is_kept_and_a_step_less_is_not() -> None:
    """In steps of 0.1 s, as F803 has them."""
    for count in (1, 2, 5, 8):
        line = built(*[{}] * count).lines[0]
        worst = refresh.worst_case(line)
        least = float(worst.least_timeout)
        assert refresh.unkept(line, worst, "p1", least) == ""
        assert "TOO SHORT" in refresh.unkept(line, worst, "p1", least - 0.1)


@pytest.mark.hazard("H06")
def test_a_drive_whose_time_out_is_not_configured_counts_for_the_others() -> None:
    """Its own F803 may be set at its panel: it is watched over when it is known."""
    line = built({}, {"communication_timeout": None}).lines[0]
    (pump,) = refresh.refreshes(line)
    assert pump.drive == "p1"
    assert set(pump.worst.turns) == {"p1", "p2"}


@pytest.mark.hazard("H30")
def test_what_cannot_be_kept_is_told_with_the_sum_and_what_to_do() -> None:
    """Key, drive, every term, and the remedies; what is kept is not spoken of. It contradicts nothing."""
    configured = built(*[{"communication_timeout": "1s"}] * 2, {"communication_timeout": "1.3s"})
    first, second = refresh.too_short(configured)
    assert first == (
        "line[0].drive[0] (p1).communication_timeout: F803 1.0 s: a good exchange is due every 0.333 s;"
        " worst case 0.411 s = 0.121 an exchange under way (p1: write to the EEPROM)"
        " + 0.120 a lost exchange (p1: identification) + 0.072 turn of p2, p3 + 0.036 stop of another drive"
        " + 0.027 emergency stop of the whole line + 0.036 its own turn: TOO SHORT;"
        " set communication_timeout to 1.3 s or more;"
        " or lower answer_margin (50 ms) as far as adapter or network permit;"
        " or raise F800 and line.baud to 38400; or command fewer than 3 drives on this line"
    )
    assert second.startswith("line[0].drive[1] (p2)")
    assert refresh.refusals(configured) == []
    assert refresh.too_short(built(*[{"communication_timeout": "1.3s"}] * 3)) == []


def test_many_drives_are_counted_and_not_named() -> None:
    """A sum of eight drives is still read."""
    (pump, *_) = refresh.refreshes(built(*[{}] * 8).lines[0])
    assert "turn of 7 other drives" in str(pump)


@pytest.mark.hazard("H06")
@pytest.mark.parametrize(
    ("drive", "key", "reason"),
    [
        ({"communication_timeout": "2250ms"}, "communication_timeout", "F803: 2.25 is not a multiple of 0.1 s"),
        ({"on_loss": "quiesce", "communication_timeout": None}, "on_loss", "give communication_timeout as well"),
    ],
)
def test_a_time_out_that_cannot_be_had_is_refused(drive: dict[str, Any], key: str, reason: str) -> None:
    """No step of F803; left to an F803 that nobody sets. Whether it can be kept is another matter."""
    (refusal,) = refresh.refusals(built(drive))
    assert refresh.too_short(built(drive)) == []
    assert refusal.startswith(f"line[0].drive[0] (p1).{key}: ")
    assert reason in refusal


# ---- the longest exchange, against the code that makes it


class ScriptedLine:
    """A quiet line on which one request is followed by one run of bytes, at some time, or by nothing."""

    is_pty = False
    may_be_simulated = False
    is_low_latency = None

    def __init__(self, timing: LineTiming, delay: float, size: int) -> None:
        self._timing, self._delay, self._left = timing, delay, size
        self._clock = virtual.VirtualClock()
        self._alarm = self._clock.alarm()
        self._next = float("inf")

    async def quiet(self) -> float:
        """Be quiet at once."""
        return self._clock.now()

    async def write(self, frame: bytes, _not_after: float = math.inf) -> float:
        """Wait for the gap, then send."""
        await self._alarm.wait_until(self._clock.now() + self._timing.gap)
        begun = self._clock.now()
        self._next = begun + self._timing.request(len(frame)) + self._delay + self._timing.answer(1)
        return begun

    async def read(self, deadline: float) -> bytes:
        """Bring one character after another, at the speed of the line."""
        if not self._left or self._next > deadline:
            await self._alarm.wait_until(deadline)
            return b""
        await self._alarm.wait_until(self._next)
        self._next += self._timing.answer(1)
        self._left -= 1
        return b"\0"

    async def drain(self, silence: float, limit: float) -> int:
        """Throw away what still comes."""
        end, thrown = self._clock.now() + limit, 0
        while (now := self._clock.now()) < end and await self.read(min(now + silence, end)):
            thrown += 1
        return thrown

    def close(self) -> None:
        """Do nothing."""


@cache
def lines(margin: str) -> site.Line:
    """Return a line of one drive with that margin."""
    return built({}, answer_margin=margin).lines[0]


REQUESTS = [ReadWords(1, 0xFD00), ReadBlock(1, 0x1875, 5), Identify(1), WriteStored(1, 0x0803, 15)]


async def elapsed(line: site.Line, request: Request, delay: float, share: float) -> float:
    """Return how long an exchange takes whose answer is that late, and that share of the longest, in zeros."""
    drive, clock = line.drives[0], virtual.VirtualClock()
    size = int(share * drive.codec.answer_size(request))
    exchanger = Exchanger(ScriptedLine(line.timing, delay, size), line.timing, line.margin, clock, LineStats())
    processing = EEPROM if isinstance(request, WriteStored) else NC3
    begun = clock.now()
    with pytest.raises((NoReply, BadReply)):
        await exchanger.exchange(drive.codec, request, processing)
    return clock.now() - begun


@pytest.mark.hazard("H30")
@given(st.sampled_from(REQUESTS), st.floats(0, 0.2), st.floats(0, 1), st.sampled_from(["10ms", "50ms", "250ms"]))
def test_no_exchange_takes_longer_than_is_reckoned(request: Request, delay: float, share: float, margin: str) -> None:
    """Silence, and damaged answers of any length at any time: in time, just too late, far too late."""
    line = lines(margin)
    took = virtual.run(elapsed(line, request, delay, share))
    assert took <= refresh.at_most(line, line.drives[0], request) - OWN_TIME + 1e-9


@pytest.mark.parametrize("request_", REQUESTS, ids=lambda request: type(request).__name__)
def test_what_is_reckoned_is_nearly_reached(request_: Request) -> None:
    """The longest damaged answer that begins at the last moment: what is left is one gap."""
    line = built({}).lines[0]
    drive = line.drives[0]
    processing = EEPROM if isinstance(request_, WriteStored) else NC3
    last = GAP + processing + MARGIN
    took = max(virtual.run(elapsed(line, request_, last + GAP * part / 20, 1.0)) for part in range(-20, 20))
    reckoned = refresh.at_most(line, drive, request_) - OWN_TIME
    assert reckoned - 1.01 * GAP <= took <= reckoned


# ---- docs/scheduling.md


PAGE = (Path(__file__).parents[2] / "docs" / "scheduling.md").read_text(encoding="utf-8")
COLUMN = re.compile(r"(?P<protocol>[a-z-]+), (?P<baud>\d+) baud, (?P<margin>\d+) ms")


def table() -> list[tuple[int, str, str]]:
    """Return (drives, heading, shortest F803) for each cell of the page's table."""
    rows = [[cell.strip() for cell in row.strip("|").split("|")] for row in PAGE.splitlines() if row.startswith("|")]
    start = next(place for place, row in enumerate(rows) if row[0] == "drives")
    headings, cells = rows[start][1:], [row for row in rows[start + 2 :] if row[0].isdigit()]
    return [(int(row[0]), heading, cell) for row in cells for heading, cell in zip(headings, row[1:], strict=True)]


def test_the_pages_table_is_what_is_reckoned() -> None:
    """The shortest F803 for one to eight drives in four settings of a line."""
    cells = table()
    assert len(cells) == 16
    for drives, heading, cell in cells:
        asked = COLUMN.fullmatch(heading)
        assert asked is not None, heading
        line = built(
            *[{"protocol": asked["protocol"], "communication_timeout": "100s"}] * drives,
            baud=int(asked["baud"]),
            answer_margin=f"{asked['margin']}ms",
        ).lines[0]
        assert str(refresh.worst_case(line).least_timeout) == cell, (drives, heading)


def test_the_pages_sum_is_what_check_says() -> None:
    """The one of config/everything.toml."""
    (line,) = site.load(Path(__file__).parents[2] / "config" / "everything.toml").lines
    (pump,) = refresh.refreshes(line)
    assert f"pump-1: {pump}" in " ".join(PAGE.split())
