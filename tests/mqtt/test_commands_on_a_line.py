"""Messages that move a simulated motor in virtual time, and those that must not."""

from __future__ import annotations

import asyncio
import json
from collections.abc import Awaitable, Callable
from dataclasses import dataclass, field
from typing import Any

import pytest

from gateway.bus.worker import LineWorker
from gateway.control.door import Door, LineBell
from gateway.metrics import MqttStats
from gateway.mqtt.listener import Listener
from gateway.mqtt.message import Message
from tests import virtual
from tests.bus.rig import Bench, bench, nc3
from tests.mqtt.rig import section

ROOT = "tosvert/hall-3/d1"
CONTROL = {
    "control": "leased",
    "communication_timeout": "1.5s",
    "timeout_action": "stop",
    "frequency": {"min": 0.0, "max": 60.0},
}


@dataclass
class Stage:
    """A simulated drive behind the door, and a broker that is played."""

    bench: Bench
    listener: Listener
    results: list[dict[str, Any]] = field(default_factory=list)
    events: list[dict[str, Any]] = field(default_factory=list)
    beats: int = 0
    _news: asyncio.Event = field(default_factory=asyncio.Event)

    def say(self, topic: str, text: str, *, expiry: int, is_event: bool = False) -> bool:
        """Keep what the gateway says."""
        kept = self.results if topic.endswith("/result") else self.events
        kept.append(json.loads(text))
        self._news.set()
        return True

    def reply(self, topic: str, text: str, correlation: bytes) -> bool:
        """Take no answers: nobody here asks for them."""
        raise AssertionError(topic)

    def send(self, kind: str, payload: object, **more: Any) -> None:
        """Let a message come."""
        raw = payload.encode() if isinstance(payload, str) else json.dumps(payload).encode()
        self.listener.hear(Message(f"{ROOT}/{kind}", raw, **more))
        self.listener.hand_over(1)

    async def ask(self, payload: object, kind: str = "command", **more: Any) -> dict[str, Any]:
        """Send a command, and wait for the next result."""
        before = len(self.results)
        self.send(kind, payload, **more)
        while len(self.results) == before:
            self._news.clear()
            await self._news.wait()
        return self.results[before]

    async def beat_for(self, seconds: float) -> None:
        """Keep the lease alive for a while."""
        for _ in range(int(seconds / 0.5)):
            self.beats += 1
            self.send("heartbeat", {"source": "hmi", "n": self.beats})
            await asyncio.sleep(0.5)

    async def start(self, hertz: float = 30.0) -> None:
        """Take, arm, run."""
        for payload in ({"command": "take"}, {"command": "arm"}, {"command": "run", "frequency": hertz}):
            result = await self.ask({**payload, "source": "hmi"})
            assert result["status"] == "done", result

    @property
    def is_running(self) -> bool:
        """Say whether the drive obeys a run command."""
        return self.bench.drive.inverter.operation.is_running

    @property
    def hertz(self) -> float:
        """Return how fast the motor turns."""
        return self.bench.drive.inverter.condition.motor.frequency


def play(script: Callable[[Stage], Awaitable[None]], **control: Any) -> None:
    """Run a script against one VF-nC3."""

    async def main() -> None:
        made = bench([nc3()], drive={**CONTROL, **control})
        clock = virtual.VirtualClock()
        door = Door.of(made.configured, clock)
        line = made.configured.lines[0]
        worker = LineWorker(
            line, made.image.by_name, made.line_stats, made.drive_stats, clock, made.open, door.controls
        )
        door.connect(LineBell("a", ("d1",), worker.ring, worker.announce))
        stage = Stage(made, Listener(section(), "hall-3", door, MqttStats(), clock))
        stage.listener.begin(stage)
        task = asyncio.create_task(worker.run())
        try:
            await asyncio.sleep(3.0)
            await script(stage)
            assert not task.done()
        finally:
            task.cancel()
            await asyncio.gather(task, return_exceptions=True)

    virtual.run(main())


def test_a_motor_is_run_set_and_stopped_by_messages() -> None:
    """Each with one result, read back from the drive."""

    async def script(stage: Stage) -> None:
        await stage.start()
        await stage.beat_for(5.0)
        assert stage.hertz == 30.0
        result = await stage.ask({"value": 20.0, "source": "hmi", "id": "set"}, "set/frequency")
        assert (result["status"], result["read_back"]["frequency_command"]) == ("done", 2000)
        await stage.beat_for(5.0)
        assert stage.hertz == 20.0
        result = await stage.ask("stop")
        assert result["status"] == "done"
        await stage.beat_for(5.0)
        assert stage.hertz == 0.0
        assert [each["event"] for each in stage.events][:2] == ["taken", "armed"]

    play(script)


@pytest.mark.hazard("H01")
@pytest.mark.hazard("H02")
@pytest.mark.hazard("H03")
def test_a_retained_a_late_and_a_repeated_run_command_move_nothing() -> None:
    """Though the lease is held and the drive is armed."""

    async def script(stage: Stage) -> None:
        run = {"command": "run", "frequency": 30.0, "source": "hmi", "id": "1"}
        for payload in ({"command": "take"}, {"command": "arm"}):
            await stage.ask({**payload, "source": "hmi"})
        wall = virtual.VirtualClock().wall()
        refusals: list[tuple[dict[str, Any], dict[str, Any], str]] = [
            (run, {"is_retained": True}, "retained"),
            ({**run, "issued": wall - 10}, {}, "expired"),
            ({**run, "expires": wall - 0.1}, {}, "expired"),
            ({"command": "run", "source": "hmi"}, {"is_repeated": True}, "expired"),
        ]
        for asked, more, reason in refusals:
            result = await stage.ask(asked, **more)
            assert (result["status"], result["reason"]) == ("refused", reason)
        await stage.beat_for(1.0)
        assert not stage.is_running
        assert (await stage.ask(run))["status"] == "done"
        assert (await stage.ask("stop"))["status"] == "done"
        again = await stage.ask(run, is_repeated=True)
        assert (again["status"], again["id"]) == ("done", "1")
        await stage.beat_for(3.0)
        assert not stage.is_running

    play(script)


@pytest.mark.hazard("H10")
@pytest.mark.hazard("H29")
def test_nothing_of_a_flood_is_done_after_a_stop_in_its_midst() -> None:
    """What waited is ended by the stop; the motor does not start again."""

    async def script(stage: Stage) -> None:
        await stage.start(10.0)
        flood = [
            Message(f"{ROOT}/command", b'{"command": "run", "frequency": 20, "source": "hmi"}'),
            Message(f"{ROOT}/set/frequency", b'{"value": 20, "source": "hmi"}'),
        ]
        for message in flood * 100:
            stage.listener.hear(message)
        assert stage.listener.is_waiting
        stage.listener.hear(Message(f"{ROOT}/command", b'{"command": "stop", "id": "end"}'))
        assert not stage.listener.is_waiting
        await stage.beat_for(5.0)
        assert not stage.is_running
        assert stage.results[-1]["id"] == "end"
        assert stage.results[-1]["status"] == "done"
        ended = [result["reason"] for result in stage.results if result["command"] == "run"][1:]
        assert set(ended) == {"busy", "stopped"}

    play(script)


@pytest.mark.hazard("H05")
@pytest.mark.parametrize("beat", [lambda n: {"source": "hmi"}, lambda n: {"source": "other", "n": n}])
def test_a_heartbeat_that_proves_no_life_of_the_owner_does_not_keep_the_motor_running(
    beat: Callable[[int], object],
) -> None:
    """The same again and again, or somebody else's: stopped within the lease."""

    async def script(stage: Stage) -> None:
        await stage.start()
        for number in range(6):
            stage.send("heartbeat", beat(number))
            await asyncio.sleep(0.5)
        assert not stage.is_running
        assert "lease_lost" in [each["event"] for each in stage.events]

    play(script)


def test_raw_words_and_registers_by_number_are_written() -> None:
    """FA00 by its number, with the words that the manual shows."""

    async def script(stage: Stage) -> None:
        for payload in ("take", "arm"):
            await stage.ask({"command": payload, "source": "hmi"})
        result = await stage.ask({"value": "12.5", "source": "hmi"}, "set/FA01")
        assert (result["status"], result["raw"]) == ("done", {"frequency_command": 1250})
        result = await stage.ask({"command": "words", "address": "FA00", "words": ["C400H"], "source": "hmi"})
        assert (result["status"], result["raw"]) == ("done", {"command": 0xC400})
        await stage.beat_for(5.0)
        assert stage.hertz == 12.5
        result = await stage.ask({"value": 60.5, "source": "hmi"}, "set/FA01")
        assert (result["status"], result["reason"]) == ("refused", "range")

    play(script)


def test_a_whole_line_is_stopped_by_one_message() -> None:
    """Whoever holds the lease."""

    async def script(stage: Stage) -> None:
        await stage.start()
        await stage.beat_for(2.0)
        stage.listener.hear(Message("tosvert/hall-3/line/a/command", b"stop"))
        await stage.beat_for(5.0)
        assert not stage.is_running
        last = stage.results[-1]
        assert (last["drive"], last["command"], last["status"]) == ("d1", "stop", "done")

    play(script)
