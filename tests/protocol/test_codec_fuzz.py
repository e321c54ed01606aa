"""A flood of damaged answers for each codec: nothing believed that is not exact, nothing missed that is."""

from __future__ import annotations

import random
import sys
from collections.abc import Iterator
from dataclasses import dataclass

import pytest

from gateway.protocol.answers import LIMIT
from gateway.protocol.pdu import Request
from tests.protocol.dialects import DIALECTS
from tests.protocol.drive_side import Denied, Dialect, Heard, heard
from tests.soak import FACTOR

SEED = 20_260_102
INPUTS = 100_000 * FACTOR
EXCHANGES = 500  # requests and their answers that are damaged in ever new ways
NAMES = sorted({dialect.codec.name for dialect in DIALECTS})


@dataclass(frozen=True)
class Exchange:
    """A request, its frame, and what a drive may answer."""

    dialect: Dialect
    request: Request
    echo: bytes
    answers: tuple[bytes, ...]
    said: tuple[Heard | None, ...]


@dataclass
class Figures:
    """What became of the inputs."""

    accepted: int = 0
    refused: int = 0
    undetectable: int = 0


@pytest.mark.unmeasured
@pytest.mark.hazard("H17")
@pytest.mark.parametrize("name", NAMES)
def test_a_hundred_thousand_damaged_answers(name: str, capsys: pytest.CaptureFixture[str]) -> None:
    """What is said stands in the bytes as an exact answer; what stands there is said. The figures are printed."""
    rng = random.Random(f"{SEED} {name}")
    exchanges = list(_exchanges(rng, [dialect for dialect in DIALECTS if dialect.codec.name == name]))
    figures = Figures()
    for _ in range(INPUTS):
        exchange = rng.choice(exchanges)
        data = _stream(rng, exchange, rng.choice(exchanges))
        _judge(rng, exchange, data, figures)
    with capsys.disabled():
        sys.stdout.write(
            f"\n{name}: {INPUTS} inputs, {figures.accepted} accepted truly, {figures.refused} refused truly,"
            f" {figures.undetectable} changed with a right checksum, none believed falsely, none missed\n"
        )
    assert figures.accepted > INPUTS // 10
    assert figures.refused > INPUTS // 10
    assert figures.undetectable < INPUTS // 10


def _judge(rng: random.Random, exchange: Exchange, data: bytes, figures: Figures) -> None:
    decoder = exchange.dialect.codec.decoder(exchange.request)
    said = heard(decoder, [*_pieces(rng, data), b""])
    assert len(decoder.received) <= LIMIT
    exact = exchange.dialect.answers_in(exchange.request, data)
    assert said or not exact or exchange.echo in data, f"{exchange.request}: nothing found in {data.hex(' ')}"
    for one in said:
        assert one in exact, f"{exchange.request}: {data.hex(' ')} was read as {one}"
        if one not in exchange.said:
            figures.undetectable += 1
        elif isinstance(one, Denied):
            figures.refused += 1
        else:
            figures.accepted += 1


def _exchanges(rng: random.Random, dialects: list[Dialect]) -> Iterator[Exchange]:
    for _ in range(EXCHANGES):
        dialect = rng.choice(dialects)
        request = dialect.request(rng.randint)
        frames = (
            dialect.frame(request, dialect.content(request, rng.randint)),
            dialect.refusal(request, rng.randint(0, 5), rng.random() < 0.5),
        )
        answers = tuple(frame for frame in frames if frame)
        said = tuple(dialect.said(request, frame) for frame in answers)
        yield Exchange(dialect, request, dialect.codec.encode(request), answers, said)


def _stream(rng: random.Random, exchange: Exchange, other: Exchange) -> bytes:
    """Make up what may come: noise, broken answers, late answers of others, echoes."""
    frame, late = rng.choice(exchange.answers), rng.choice(other.answers)
    match rng.randrange(10):
        case 0:
            return rng.randbytes(rng.randrange(40))
        case 1:
            return bytes(rng.choices(frame + exchange.echo, k=rng.randrange(40)))
        case 2:
            return _damaged(rng, frame)
        case 3:
            return exchange.dialect.sealed(_damaged(rng, frame))
        case 4:
            return frame[: rng.randrange(len(frame))] + frame
        case 5:
            return rng.randbytes(rng.randrange(5)) + frame + rng.randbytes(rng.randrange(5))
        case 6:
            return exchange.echo + rng.randbytes(rng.randrange(3)) + rng.choice((frame, _damaged(rng, frame)))
        case 7:
            return late + rng.choice((b"", frame))
        case 8:
            cut = rng.randrange(len(frame))
            return frame[:cut] + late[cut:]
    return _damaged(rng, frame) + _damaged(rng, frame)


def _damaged(rng: random.Random, frame: bytes) -> bytes:
    """Damage a frame in one to three places: bits flipped, bytes replaced, lost, added, doubled."""
    data = bytearray(frame)
    for _ in range(rng.randint(1, 3)):
        at = rng.randrange(len(data)) if data else 0
        match rng.randrange(5) if data else 3:
            case 0:
                data[at] ^= 1 << rng.randrange(8)
            case 1:
                data[at] = rng.randrange(256)
            case 2:
                del data[at]
            case 3:
                data.insert(at, rng.randrange(256))
            case 4:
                data.insert(at, data[at])
    return bytes(data)


def _pieces(rng: random.Random, data: bytes) -> Iterator[bytes]:
    """Cut bytes into up to three pieces, none of them empty."""
    cuts = sorted(rng.choices(range(len(data) + 1), k=rng.randrange(3)))
    for start, end in zip([0, *cuts], [*cuts, len(data)], strict=True):
        if start < end:
            yield data[start:end]
