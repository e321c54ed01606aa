"""LED block mode (FA80 = 1): the block carries the display's text, which must not be taken for values."""

from __future__ import annotations

import asyncio

from gateway.image import Quality
from tests.bus.rig import FIVE, Bench, bench, nc3, run

TEXT = {0x64, 0x41, 0x74}  # "dAtA", as the display shows it after power-on


def test_text_is_never_taken_for_values() -> None:
    """FA80 turns 1 in the middle of polling: no letter appears as a value, and the values go on by other reads."""

    async def play(stage: Bench) -> None:
        image = stage.image.by_name["d1"]
        seen: set[int] = set()

        def look(_image: object, names: object) -> None:
            now = asyncio.get_running_loop().time()
            samples = [image.sample(name, now) for name in FIVE]
            seen.update(sample.word for sample in samples if sample.quality is Quality.GOOD)

        await asyncio.sleep(3.0)
        image.subscribe(look)
        stage.drive.set_by_panel("block_mode", 1)
        await asyncio.sleep(5.0)
        assert not seen & TEXT
        assert stage.value("d1", "output_frequency") == "50.00"
        assert image.quality("alarm", asyncio.get_running_loop().time()) is Quality.GOOD
        stage.drive.set_by_panel("block_mode", 0)
        await asyncio.sleep(10.0)
        assert not seen & TEXT
        assert any(set(FIVE) <= set(names) for _, names, _ in stage.applied[-10:])

    run(lambda: bench([nc3(running_at=50.0)]), play)


def test_a_drive_found_in_that_mode_is_read_without_the_block() -> None:
    """Left behind by somebody else: single reads, and the block again when FA80 is 0."""

    async def play(stage: Bench) -> None:
        stage.drive.set_by_panel("block_mode", 1)
        await asyncio.sleep(5.0)
        assert stage.value("d1", "output_frequency") == "50.00"
        assert not any(set(FIVE) <= set(names) for _, names, _ in stage.applied)
        stage.drive.set_by_panel("block_mode", 0)
        await asyncio.sleep(10.0)
        assert any(set(FIVE) <= set(names) for _, names, _ in stage.applied[-10:])

    run(lambda: bench([nc3(running_at=50.0)]), play)
