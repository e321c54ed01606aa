"""The session with a broker as a state machine: whatever is lost, kept, late or repeated, the rules hold."""

from __future__ import annotations

import asyncio
import contextlib
import json
from collections.abc import Coroutine
from typing import Any, cast

import pytest
from hypothesis import Phase, settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, precondition, rule

from gateway.control.command import Verb
from gateway.image import Image
from gateway.metrics import MqttStats
from gateway.mqtt.bridge import Bridge
from tests import soak
from tests.mosquitto import LIMIT
from tests.mqtt.doors import LEASED, KeptDoor, small_site
from tests.mqtt.rig import GATEWAY, SkippingClock, section
from tests.simulation.broker import Broker, Message, Peer

pytestmark = pytest.mark.e2e
ROOT = f"tosvert/{GATEWAY}/{LEASED}"
HOARDED = 15  # messages that the broker sends at once after a connect; more it sends later, as if they were new


class Served(asyncio.Protocol):
    """One client of the broker double over TCP."""

    def __init__(self, broker: Broker) -> None:
        self._broker = broker
        self._peer: Peer
        self._transport: asyncio.Transport

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Hand the connection to the broker."""
        self._transport = cast("asyncio.Transport", transport)
        self._peer = self._broker.accept(self)

    def data_received(self, data: bytes) -> None:
        """Hand on what the client sends."""
        self._peer.feed(data)

    def connection_lost(self, exc: Exception | None) -> None:
        """Tell the broker."""
        self._peer.lost()

    def send(self, data: bytes, message: Message | None) -> None:
        """Send bytes."""
        self._transport.write(data)

    def close(self) -> None:
        """Break the connection."""
        self._transport.abort()


class Session(RuleBasedStateMachine):
    """A bridge, a broker double, and controllers that send what they like when they like."""

    def __init__(self) -> None:
        super().__init__()
        self.loop = asyncio.new_event_loop()
        self.broker = Broker(self.loop.time)
        self.clock = SkippingClock()
        self.door = KeptDoor.small(self.clock)
        self.stats = MqttStats()
        self.task: asyncio.Task[None]
        self.server: asyncio.Server | None = None
        self.port = 0
        self.number = 0
        self.beats = 0
        self.wanted: list[str] = []  # ids of commands that must come to the door, in order
        self.never: set[str] = set()  # and of those that must not
        self.hoarded = 0
        self.results: list[dict[str, Any]] = []
        self.finished = 0
        self.broker.listen(f"{ROOT}/result", lambda message: self.results.append(json.loads(message.payload)))

    @initialize(version=st.sampled_from(["5", "3.1.1"]), qos=st.sampled_from([0, 1]), is_hoarding=st.booleans())
    def begin(self, version: str, qos: int, is_hoarding: bool) -> None:
        """Start the bridge, and have it connected."""
        self.broker.is_hoarding = is_hoarding
        self.do(self._open())
        quick = {"reconnect_after": "1ms", "reconnect_at_most": "2ms"}
        made = section(url=f"mqtt://127.0.0.1:{self.port}", version=version, qos=qos, **quick)
        image = Image(small_site().drives)
        self.bridge = Bridge(made, GATEWAY, image, self.stats, self.clock, door=self.door)
        self.task = self.loop.create_task(self.bridge.run())
        self.do(self._come_through())

    def do(self, what: Coroutine[Any, Any, None]) -> None:
        """Let the loop run for as long as something takes."""
        self.loop.run_until_complete(asyncio.wait_for(what, LIMIT))

    async def _open(self) -> None:
        self.server = await self.loop.create_server(lambda: Served(self.broker), "127.0.0.1", self.port)
        self.port = self.server.sockets[0].getsockname()[1]

    async def _come_through(self) -> None:
        """Wait until the bridge hears what is sent, and has handed on what it heard before."""
        while True:
            self.beats += 1
            beat = str(self.beats).encode()
            self.broker.publish(Message(f"{ROOT}/heartbeat", beat))
            with contextlib.suppress(TimeoutError):
                async with asyncio.timeout(0.02):
                    await self._until(lambda: any(came == beat for *_, came in self.door.beats))  # noqa: B023
                    break
        assert self.bridge._listener is not None
        while self.bridge._listener.is_waiting:
            await asyncio.sleep(0)
        self.door.beats.clear()

    # ---- what controllers do

    @rule(
        verb=st.sampled_from(["run", "arm", "frequency"]),
        is_retained=st.booleans(),
        is_late=st.booleans(),
        qos=st.sampled_from([0, 1]),
    )
    def command(self, verb: str, is_retained: bool, is_late: bool, qos: int) -> None:
        """Send a command that has never been sent."""
        self.number += 1
        name = str(self.number)
        age = 60.0 if is_late else 0.0
        asked = {"command": verb, "id": name, "issued": self.clock.wall() - age}
        if verb == "frequency":
            asked["value"] = self.number
        if self.server is None:
            if self.hoarded >= HOARDED:
                return
            self.hoarded += self.broker.is_hoarding
        is_taken = self.server is not None and not is_late
        self.wanted += [name] if is_taken else []
        self.never |= set() if is_taken else {name}
        self._publish("command", asked, is_retained, qos)

    def _publish(self, kind: str, asked: object, is_retained: bool, qos: int) -> None:
        payload = asked if isinstance(asked, bytes) else json.dumps(asked).encode()
        self.broker.publish(Message(f"{ROOT}/{kind}", payload, qos, is_retained))
        if self.server is not None:
            self.do(self._come_through())

    @rule()
    @precondition(lambda self: self.server is not None)
    def stop(self) -> None:
        """Send a stop, which is at the door at once."""
        before = len(self.door.submitted)
        self._publish("command", b"stop", False, 1)
        assert Verb.STOP in [command.verb for command in self.door.submitted[before:]]

    @rule(payload=st.sampled_from([b"go", b"{", b"\xff", b'{"command": "run", "frequency": NaN}', b""]))
    @precondition(lambda self: self.server is not None)
    def nonsense(self, payload: bytes) -> None:
        """Send what is no command."""
        before = self.stats.refused["malformed"]
        self._publish("command", payload, False, 1)
        assert self.stats.refused["malformed"] > before

    # ---- what happens to the connection

    @rule(is_restart=st.booleans(), is_forgetful=st.booleans())
    @precondition(lambda self: self.server is not None)
    def lose(self, is_restart: bool, is_forgetful: bool) -> None:
        """Break the connection; nobody can come back for now."""
        self.do(self._lose(is_restart=is_restart, is_forgetful=is_forgetful))

    async def _lose(self, *, is_restart: bool, is_forgetful: bool) -> None:
        assert self.server is not None
        self.server.close()
        self.server = None
        if is_restart:
            self.broker.restart(is_forgetful=is_forgetful)
        for peer in tuple(self.broker.peers):
            peer.outlet.close()
        while self.broker.peers or self.stats.is_connected:
            await asyncio.sleep(0)

    @rule()
    @precondition(lambda self: self.server is None)
    def come_back(self) -> None:
        """Let clients connect again."""
        self.hoarded = 0
        self.do(self._open())
        self.do(self._come_through())

    @rule(kept=st.lists(st.tuples(st.booleans(), st.sampled_from([0, 1])), min_size=1, max_size=4))
    @precondition(lambda self: self.server is not None)
    def miss_commands(self, kept: list[tuple[bool, int]]) -> None:
        """Be away while commands are sent, and come back."""
        self.do(self._lose(is_restart=False, is_forgetful=False))
        for is_retained, qos in kept:
            self.command("run", is_retained, False, qos)
        self.come_back()

    @rule(doubles=st.booleans())
    def repeat(self, doubles: bool) -> None:
        """Let the broker send again what has arrived, or stop doing so."""
        self.broker.duplicates = 1.0 if doubles else 0.0

    @rule()
    def finish(self) -> None:
        """End what is open at the door: each with one result, or one that is counted."""
        before, untold, ended = len(self.results), self.stats.untold, len(self.door.open)
        self.door.finish()
        if self.server is not None:
            self.do(self._until(lambda: len(self.results) - before == ended))
        else:
            assert self.stats.untold - untold == ended
            assert len(self.results) == before

    async def _until(self, condition: Any) -> None:
        while not condition():
            await asyncio.sleep(0)

    # ---- what always holds

    @invariant()
    def everything_comes_to_the_door_once_and_in_order(self) -> None:
        """But for what an id tells to be the same again."""
        names = [command.id for command in self.door.submitted if not command.verb.is_stopping]
        assert list(dict.fromkeys(names)) == self.wanted

    @invariant()
    def nothing_old_comes_to_the_door(self) -> None:
        """Not what was kept, late, or sent while nobody listened."""
        assert not self.never & {command.id for command in self.door.submitted}

    def teardown(self) -> None:
        """End it all."""
        self.loop.run_until_complete(self._end())
        self.loop.close()

    async def _end(self) -> None:
        self.task.cancel()
        with contextlib.suppress(asyncio.CancelledError):
            await self.task
        if self.server is not None:
            self.server.close()
        for peer in tuple(self.broker.peers):
            peer.outlet.close()
        await asyncio.sleep(0)


TestSession = pytest.mark.hazard("H01")(pytest.mark.hazard("H02")(pytest.mark.hazard("H03")(Session.TestCase)))
TestSession.settings = settings(
    max_examples=20 * soak.FACTOR,
    stateful_step_count=20,
    deadline=None,
    phases=[Phase.reuse, Phase.generate],  # it goes by real time: to look for a shorter failure would take minutes
)
