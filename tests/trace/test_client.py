"""The command's side of the socket: it shows all of what the gateway holds, or says that it does not."""

from __future__ import annotations

import asyncio
import contextlib
import json
from pathlib import Path

import pytest

from gateway.errors import GatewayError
from gateway.trace.client import Lost, Seen
from gateway.trace.frames import Frame, frames
from gateway.trace.meaning import Meaning
from tests.trace.plays import answered

HELLO = b'{"trace": 1, "gateway": "hall-3", "lines": ["a"]}\n'
FRAMES = list(frames("a", answered(), Meaning(), 0.0))
SHOWN = b"".join(json.dumps(frame.as_table()).encode() + b"\n" for frame in FRAMES)
OVER = b'{"over": true}\n'


async def seen(folder: Path, said: bytes, *, is_followed: bool) -> list[Frame | Lost]:
    """Return what is shown of a gateway that says so much and ends the connection."""

    async def say(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        await reader.readline()
        writer.write(said)
        writer.close()

    def look() -> list[Frame | Lost]:
        with contextlib.closing(Seen([folder / "s"], is_followed=is_followed)) as gateway:
            return list(gateway.frames())

    server = await asyncio.start_unix_server(say, folder / "s")
    try:
        return await asyncio.to_thread(look)
    finally:
        server.close()


async def test_the_latest_frames_are_all_there_when_the_gateway_says_so(tmp_path: Path) -> None:
    """By the mark behind them."""
    assert await seen(tmp_path, HELLO + SHOWN + OVER, is_followed=False) == FRAMES


@pytest.mark.parametrize("said", [HELLO, HELLO + SHOWN, HELLO + SHOWN + SHOWN[:50], HELLO + SHOWN + OVER[:-1]])
async def test_latest_frames_that_end_too_soon_are_an_error(tmp_path: Path, said: bytes) -> None:
    """Without the mark, wherever it breaks off: a part is never shown as if it were all."""
    with pytest.raises(GatewayError, match="too soon"):
        await seen(tmp_path, said, is_followed=False)


async def test_what_is_followed_has_no_mark_at_its_end(tmp_path: Path) -> None:
    """It ends with the gateway."""
    assert await seen(tmp_path, HELLO + SHOWN, is_followed=True) == FRAMES
