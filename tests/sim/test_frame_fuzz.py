from __future__ import annotations

import time
from collections.abc import Iterator
from random import Random

import pytest

from gateway.sim.frames import is_whole
from gateway.sim.options import PROTOCOLS
from tests.frames import ASCII, BINARY, FRAMES, RTU
from tests.sim.rig import Rig, binary, framed
from tests.soak import FACTOR

LEAST = 0.01  # seconds of the processor: less is nothing to compare with
INPUTS = 17_000 * FACTOR  # a protocol and a model; 100,000 in all
LONGEST = 60  # bytes
ALPHABETS = {
    RTU: bytes(range(256)),
    ASCII: b"(()RWPLSG0123456789ABCDEF*&)\r\rabf X/",
    BINARY: b"//RWPGXSs\x00\x01\x02\x05\xff\xfa\xfd\x08\x80" + bytes(range(0, 256, 7)),
}
PRINTED = {name: [f.data for f in FRAMES if f.protocol == name] for name in ALPHABETS}
DRIVES = {RTU: "modbus-rtu", ASCII: "toshiba", BINARY: "toshiba"}


def is_check_wrong(protocol: str, frame: bytes) -> bool:
    """Say whether a frame has a check that is not the one of its bytes, worked out apart from the simulation."""
    if protocol == RTU or len(frame) < 3:
        return not is_whole(frame)
    if frame.startswith(b"/"):
        return sum(frame[:-1]) % 256 != frame[-1]
    before, mark, behind = frame.partition(b"&")
    return bool(mark) and behind[:2] != f"{sum(before + mark) % 256:02X}".encode()


def refreshed(protocol: str, frame: bytes) -> bytes:
    """Return a frame with the check of its bytes, so that what is behind the check is reached."""
    if protocol == RTU:
        return framed(frame[1:-2].hex(), frame[0]) if len(frame) > 3 else frame
    if protocol == BINARY:
        return binary(frame[1:-1].hex())
    before, mark, _ = frame.partition(b"&")
    return frame if not mark else before + mark + f"{sum(before + mark) % 256:02X})\r".encode()


def mutated(frame: bytes, alphabet: bytes, rng: Random) -> bytes:
    """Return a frame with up to three bytes changed, taken away or put in."""
    data = bytearray(frame)
    for _ in range(rng.randint(0, 3)):
        place = rng.randrange(len(data) + 1)
        cut = rng.randint(0, 1)
        data[place : place + cut] = bytes(rng.choices(alphabet, k=rng.randint(0, 1)))
    return bytes(data)


def inputs(protocol: str, rng: Random) -> Iterator[bytes]:
    """Make frames: random bytes, random words of the protocol's own characters, printed ones that were damaged."""
    alphabet = ALPHABETS[protocol]
    start = {RTU: b"\x01", ASCII: b"(", BINARY: b"/"}[protocol]
    for _ in range(INPUTS):
        kind = rng.randrange(4)
        if kind == 0:
            frame = rng.randbytes(rng.randrange(LONGEST))
        elif kind == 1:
            frame = start + bytes(rng.choices(alphabet, k=rng.randrange(LONGEST // 3)))
        else:
            frame = mutated(rng.choice(PRINTED[protocol]), alphabet, rng)
        yield refreshed(protocol, frame) if rng.random() < 0.5 else frame


@pytest.mark.unmeasured
@pytest.mark.parametrize("protocol", list(ALPHABETS))
@pytest.mark.parametrize("model", ["vf-nc3", "vf-mb1"])
def test_no_bytes_break_a_drive_and_no_wrong_check_is_obeyed(protocol: str, model: str) -> None:
    """Nothing raises; a frame with a wrong check changes nothing, and is answered N0004 or not at all."""
    rng = Random(f"{protocol} {model}")
    rig = Rig(model, protocol=DRIVES[protocol])
    answered = refused = 0
    for frame in inputs(protocol, rng):
        if rig.word("number") != 1 or rig.drive.protocol != PROTOCOLS[DRIVES[protocol]] or rng.random() < 0.001:
            rig = Rig(model, protocol=DRIVES[protocol])
        rig.now = max(rig.now, rig.drive.inverter.deaf_until) + 0.01
        changes = rig.drive.inverter.memory.changes
        answer = rig.send(frame)
        answered += answer is not None
        if is_check_wrong(protocol, frame):
            assert rig.drive.inverter.memory.changes == changes, frame
            assert answer is None or is_checksum_error(answer), frame
            refused += answer is not None
        if answer is not None:
            assert len(answer) < LONGEST
            assert not is_check_wrong(protocol, answer), answer
    assert answered > INPUTS / 20
    assert (refused > 0) == (protocol != RTU)


def is_checksum_error(answer: bytes) -> bool:
    """Say whether an answer is N0004 or n0004, with a number or without."""
    if answer.startswith(b"("):
        return answer[1:].lstrip(b"0123456789")[:5] in (b"N0004", b"n0004")
    return answer[-4:-1] in (b"N\x00\x04", b"n\x00\x04")


@pytest.mark.unmeasured
@pytest.mark.parametrize(
    "frame",
    [
        b"(W0880" + b"0" * 1_000_000 + b")\r",
        b"(" * 1_000_000,
        b"(W0880" + b"0&" * 500_000 + b"\r",
        b"/" * 1_000_000,
        b"/X\xff\xff" + bytes(1_000_000),
        bytes(1_000_000),
    ],
    ids=["digits", "start codes", "checksums", "binary start codes", "a long X", "zeros"],
)
def test_a_frame_of_a_megabyte_is_done_with_at_once(frame: bytes) -> None:
    """The work goes with the length, not with its square: 16 times as long takes 256 times the work there."""
    part = taken(frame[: len(frame) // 16])
    assert taken(frame) < 64 * max(part, LEAST)


def taken(frame: bytes) -> float:
    """Return the processor time that drives of every protocol take for a frame, in seconds."""
    begun = time.process_time()
    for protocol in PROTOCOLS:
        Rig(protocol=protocol).send(frame)
        is_whole(frame)
    return time.process_time() - begun
