"""The number of the last connection outlives the process: bdSeq goes on from it."""

from __future__ import annotations

from pathlib import Path

import pytest

from gateway.sparkplug import memory
from gateway.sparkplug.memory import Memory
from gateway.sparkplug.topics import Topics
from gateway.store.store import Store
from tests.mosquitto import Mosquitto
from tests.sparkplug.edge_rig import Host, running
from tests.store.rig import HandClock
from tests.store.rig import running as store_running

NODE = Topics("plant-1", "hall-3")


class Kept:
    """A keeper in memory."""

    def __init__(self, **texts: str) -> None:
        self.texts = texts

    async def recalled(self, key: str, within: float) -> str:
        """Return what was kept."""
        assert within == memory.PATIENCE
        return self.texts.get(key, "")

    def keep(self, key: str, text: str) -> None:
        """Keep it."""
        self.texts[key] = text


@pytest.mark.parametrize(
    ("text", "last"), [("", None), ("0", 0), ("255", 255), ("256", None), ("-1", None), ("x", None), ("\u0663", None)]
)
async def test_only_a_number_is_a_number(text: str, last: int | None) -> None:
    """From 0 to 255; whatever else stands there counts for nothing."""
    assert await Memory(Kept(**{"bdSeq plant-1/hall-3": text}), NODE).last() == last


async def test_each_edge_node_has_a_memory_of_its_own() -> None:
    """By group and name."""
    kept = Kept()
    Memory(kept, NODE).keep(7)
    assert await Memory(kept, NODE).last() == 7
    assert await Memory(kept, Topics("plant-2", "hall-3")).last() is None


@pytest.mark.e2e
async def test_numbers_go_on_after_a_restart(tmp_path: Path) -> None:
    """In births and deaths, over the end of the range; the store is opened anew each time."""
    numbers = []
    with Mosquitto() as broker:
        async with store_running(tmp_path / "state.sqlite") as store:
            store.keep("bdSeq plant-1/hall-3", "253")
        for _ in range(4):
            async with Host(broker.port) as host, store_running(tmp_path / "state.sqlite") as store:
                async with running(broker.port, keeper=store):
                    (born,) = await host.until_kinds("NBIRTH")
                (died, *_) = await host.until_kinds("NDEATH")
            (first, *_), (last,) = born.payload.metrics, died.payload.metrics
            assert (first.name, first.value) == (last.name, last.value)
            numbers.append(first.value)
    assert numbers == [254, 255, 0, 1]


@pytest.mark.e2e
async def test_a_disk_that_does_not_answer_holds_nobody_up(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Counting begins at 0, as it does where nothing is kept."""
    monkeypatch.setattr(memory, "PATIENCE", 0.01)
    never = Store(tmp_path / "state.sqlite", 1000, HandClock())
    with Mosquitto() as broker:
        async with Host(broker.port) as host, running(broker.port, keeper=never):
            (born,) = await host.until_kinds("NBIRTH")
            assert born.payload.metrics[0].value == 0
