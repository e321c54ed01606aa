"""Five values of one drive by each form that its protocols have: how fast, and how near to what the wire allows.

Every form goes through the gateway's own exchanger over its serial line; the drive is simulated in a process of its
own. The share is measured over what bits, gaps and the drive's own time allow: 100 % is out of reach of any master.
"""

from __future__ import annotations

import statistics
import time
from collections.abc import Iterator
from dataclasses import dataclass

import uvloop

from bench import one_drive
from bench.one_drive import BAUDS, MODEL, NUMBER, VALUES
from gateway.bus.exchange import Exchanger
from gateway.errors import GatewayError
from gateway.protocol.codec import Codec
from gateway.protocol.pdu import ReadBlock, ReadWords, Request, Words
from gateway.protocol.registry import PROTOCOLS
from gateway.sim.process import SimulatedLine

WARM_UP = 0.2  # seconds

BLOCK = (ReadBlock(NUMBER, MODEL.blocks.indirect_read_address, len(VALUES)),)
SINGLES = tuple(ReadWords(NUMBER, MODEL.registers[name].address) for name in VALUES)


@dataclass(frozen=True, slots=True)
class Form:
    """One way of reading the five values."""

    title: str
    protocol: str
    requests: tuple[Request, ...]

    @property
    def codec(self) -> Codec:
        """Return the codec of the form's protocol."""
        return PROTOCOLS[self.protocol]


FORMS = (
    Form("MODBUS block, 03H at 1875H", "modbus-rtu", BLOCK),
    Form("MODBUS singles, 03H", "modbus-rtu", SINGLES),
    Form("TOSHIBA binary block, X/Y", "toshiba-binary", BLOCK),
    Form("TOSHIBA binary singles, R", "toshiba-binary", SINGLES),
    Form("TOSHIBA ASCII singles, R", "toshiba-ascii", SINGLES),
)


@dataclass(frozen=True, slots=True)
class Result:
    """The medians of a form's runs a second; of all runs, what failed, and what the line counted.

    `allowed` is how many values a second bits, gaps and the drive's own time allow, `share` what came of it.
    """

    form: str
    baud: int
    exchanges: float
    values: float
    allowed: float
    share: float
    gap_violations: int
    lost: int
    failed: int


async def read(exchanger: Exchanger, form: Form, seconds: float) -> tuple[float, int]:
    """Read the five values again and again; return the good rounds a second, and how many others there were."""
    good = failed = 0
    begun = time.monotonic()
    while (elapsed := time.monotonic() - begun) < seconds:
        try:
            answers = [await exchanger.exchange(form.codec, r, MODEL.times.processing) for r in form.requests]
        except GatewayError:
            failed += 1
            continue
        words = [word for answer in answers if isinstance(answer.reply, Words) for word in answer.reply.words]
        if len(words) != len(VALUES):
            raise SystemExit(f"{form.title}: {len(words)} words in place of {len(VALUES)}")
        good += 1
    return good / elapsed, failed


async def measure(line: SimulatedLine, form: Form, baud: int, seconds: float, runs: int) -> Result:
    """Measure one form some times on a line that runs."""
    async with one_drive.exchanging(line.port, baud) as exchanger:
        await read(exchanger, form, WARM_UP)
        line.do({"do": "reset_stats"})
        outcomes = [await read(exchanger, form, seconds) for _ in range(runs)]
    counted = line.stats()
    rate = statistics.median(rate for rate, _ in outcomes)
    allowed = 1 / one_drive.least_time(baud, form.codec, form.requests)
    return Result(
        form.title,
        baud,
        exchanges=rate * len(form.requests),
        values=rate * len(VALUES),
        allowed=allowed * len(VALUES),
        share=rate / allowed,
        gap_violations=counted["gap_violations"],
        lost=counted["lost"],
        failed=sum(failed for _, failed in outcomes),
    )


def measured(late: list[float], seconds: float, runs: int) -> Iterator[Result]:
    """Yield the result of each form at each baud rate; add how late each simulated line was to `late`."""
    for baud in BAUDS:
        for form in FORMS:
            with SimulatedLine(one_drive.simulated(baud, form.protocol)) as line:
                yield uvloop.run(measure(line, form, baud, seconds, runs))
                late.append(line.stats()["lateness_p99"])


def row(result: Result) -> str:
    """Return a result as a line of the table."""
    return (
        f"{result.form:28} {result.baud:5}  {result.exchanges:11.1f} {result.values:8.1f} {result.allowed:8.1f} "
        f"{result.share:7.1%} {result.gap_violations:3} {result.lost:5} {result.failed:6}"
    )


def ratios(results: list[Result]) -> Iterator[str]:
    """Yield how the first form stands beside each other one, a line for each baud rate."""
    for baud in BAUDS:
        first, *others = [result for result in results if result.baud == baud]
        times = ", ".join(f"{first.values / other.values:.2f} x {other.form}" for other in others)
        yield f"values a second at {baud} baud, {first.form}: {times}"


TABLE = one_drive.Table(
    title="Five values of a drive",
    head=f"{'form':28}  baud  exchanges/s values/s  allowed   share  gv  lost failed",
    seconds=2.0,
    measured=measured,
    row=row,
    ratios=ratios,
)

if __name__ == "__main__":
    one_drive.main(__doc__, TABLE)
