"""An edge node on a real broker: births, data, deaths, rebirths, the primary host, and what foreign decoders read."""

from __future__ import annotations

import json
from collections.abc import Iterator
from typing import Any

import pytest

from gateway.control.command import Reason, Verb
from gateway.image import Image, LinkState
from gateway.mqtt import client, reasons
from gateway.sparkplug.payload import DataType
from tests.mosquitto import Mosquitto, Subscriber, free_port
from tests.mqtt import drives
from tests.mqtt.doors import LEASED, KeptDoor, small_site
from tests.mqtt.rig import Cable, Log
from tests.sparkplug.edge_rig import DCMD, NCMD, Host, running, values
from tests.sparkplug.foreign import Decoder

pytestmark = pytest.mark.e2e

BOTH = pytest.mark.parametrize("version", ["5", "3.1.1"])
REBIRTH = "Node Control/Rebirth"


@pytest.fixture(scope="module")
def broker() -> Iterator[Mosquitto]:
    """Return a broker that most tests share."""
    with Mosquitto() as running_broker:
        yield running_broker


def kept_door(clock: Any) -> KeptDoor:
    """Return a door whose commands are done at once."""
    door = KeptDoor.small(clock)
    door.is_prompt = True
    return door


def site_image() -> Image:
    """Return the drives of the small site, online."""
    image = Image(small_site().drives)
    for each in image.drives:
        each.set_link(LinkState.ONLINE)
    return image


@BOTH
async def test_a_session_from_its_birth_to_its_death(broker: Mosquitto, version: str) -> None:
    """Births, a value, a drive lost and found, the end: QoS 0, nothing retained, no number left out."""
    async with Host(broker.port) as host:
        async with running(broker.port, version=version) as edge:
            await host.until_kinds("NBIRTH", "DBIRTH pump-1")
            edge.read(output_frequency=5000)
            edge.pump.set_link(LinkState.OFFLINE, "no answer")
            await host.until_kinds("DDATA pump-1", "DDEATH pump-1", "NDATA")
            edge.pump.set_link(LinkState.ONLINE)
            await host.until_kinds("DDEATH pump-1", "DBIRTH pump-1", "NDATA")
        death, *_ = await host.until_kinds("NDEATH", *(["NDEATH"] if version == "5" else []))
        assert death.payload.seq is None
        seqs = [sent.payload.seq for sent in host.sent if sent.kind != "NDEATH"]
        assert seqs == list(range(len(seqs)))
        deaths = [sent for sent in host.sent if sent.kind == "NDEATH"]
        # with MQTT 5 the broker has to publish the will as well; with 3.1.1 it must not
        assert [values(death) for death in deaths] == [{"bdSeq": 0}] * (2 if version == "5" else 1)
        of_us = [m for m in host.messages if "STATE" not in m.topic]
        assert not any(message.is_retained for message in of_us)
        assert {message.qos for message in of_us if "NDEATH" not in message.topic} == {0}
    assert any("as sparkplug-plant-1-hall-3 (" in line and ", c1, " in line for line in broker.log), "a clean session"
    async with Subscriber(broker.port, "spBv1.0/plant-1/#") as late:
        assert late.messages == []


@BOTH
async def test_a_lost_connection_is_an_ndeath_with_the_number_of_its_birth(broker: Mosquitto, version: str) -> None:
    """The will, at QoS 1; the next session has the next number."""
    async with Host(broker.port) as host, Cable(broker.port) as cable, running(cable.port, version=version):
        for number in range(3):
            await host.until(lambda n=number: host.kinds.count("DBIRTH pump-1") == n + 1)  # type: ignore[misc]
            cable.cut()
            await host.until(lambda n=number: host.kinds.count("NDEATH") == n + 1)  # type: ignore[misc]
            await cable.plug()
        await host.until(lambda: host.kinds.count("DBIRTH pump-1") == 4)
        born = [values(sent)["bdSeq"] for sent in host.sent if sent.kind == "NBIRTH"]
        died = [values(sent)["bdSeq"] for sent in host.sent if sent.kind == "NDEATH"]
        assert born == [0, 1, 2, 3]
        assert died == [0, 1, 2]
        wills = [message for message in host.messages if "NDEATH" in message.topic]
        assert {(message.topic, message.qos) for message in wills} == {("spBv1.0/plant-1/NDEATH/hall-3", 1)}
        assert not any(message.is_retained for message in host.messages)


async def test_a_broker_that_starts_again_is_told_everything_again() -> None:
    """The newest values, in new births."""
    with Mosquitto() as own:
        async with running(own.port) as edge:
            async with Host(own.port) as host:
                await edge.until(lambda: edge.stats.connects == 1)
                await host.publish(NCMD, b"")
            own.stop()
            await edge.until(lambda: not edge.stats.is_connected)
            edge.read(output_frequency=4200)
            own.start()
            async with Host(own.port) as host:
                await host.write(NCMD, REBIRTH, True, DataType.BOOLEAN)
                born = (await host.until_kinds("NBIRTH", "DBIRTH pump-1"))[1]
                assert values(born)["output_frequency"] == 42.0


async def test_a_host_that_comes_late_asks_for_all_births(broker: Mosquitto) -> None:
    """By NCMD, as foreign encoders write it; bdSeq stays."""
    for name in ("pysparkplug", "sparkplug-payload"):
        with Decoder(name) as foreign:
            request = foreign.encode("NCMD", 5, [{"name": REBIRTH, "type": "Boolean", "value": True}])
        async with running(broker.port) as edge:
            await edge.until(lambda e=edge: e.stats.is_connected)  # type: ignore[misc]
            async with Host(broker.port) as host:
                await host.publish(NCMD, request)
                born, _ = await host.until_kinds("NBIRTH", "DBIRTH pump-1")
                assert (values(born)["bdSeq"], born.payload.seq) == (0, 0)


@BOTH
@pytest.mark.hazard("H01")
async def test_a_retained_command_is_not_carried_out(broker: Mosquitto, version: str) -> None:
    """With MQTT 5 it is not even delivered."""
    async with Host(broker.port) as host:
        await host.write(DCMD + LEASED, "Control/Run", True, DataType.BOOLEAN, "-r")
        async with running(broker.port, site_image(), kept_door, commands=True, version=version) as edge:
            await host.until_kinds("NBIRTH", f"DBIRTH {LEASED}")
            await host.write(DCMD + LEASED, "Control/Stop", True, DataType.BOOLEAN)
            await edge.until(lambda: bool(edge.door.submitted))
            assert [command.verb for command in edge.door.submitted] == [Verb.STOP]
            assert edge.stats.refused[Reason.RETAINED.value] == (version == "3.1.1")
        await host.publish(DCMD + LEASED, b"", "-r")


async def test_a_command_is_answered_by_a_metric(broker: Mosquitto) -> None:
    """Written by foreign encoders, by name and by alias; the result comes as data of the drive."""
    async with Host(broker.port) as host, running(broker.port, site_image(), kept_door, commands=True) as edge:
        (born,) = await host.until_kinds(f"DBIRTH {LEASED}")
        aliases = {metric.name: metric.alias for metric in born.payload.metrics}
        frequency = {"name": None, "alias": aliases["Control/Frequency"], "type": "Float", "value": 12.3}
        now = round(edge.clock.wall() * 1000)
        for name in ("pysparkplug", "sparkplug-payload"):
            with Decoder(name) as foreign:
                run = foreign.encode("DCMD", now, [{"name": "Control/Run", "type": "Boolean", "value": True}])
                await host.publish(DCMD + LEASED, run)
                await host.publish(DCMD + LEASED, foreign.encode("DCMD", now, [frequency]))
        await edge.until(lambda: len(edge.door.submitted) == 4)
        verbs = [(command.verb, command.value and str(command.value)) for command in edge.door.submitted]
        assert verbs == [(Verb.RUN, None), (Verb.FREQUENCY, "12.3")] * 2

        def results() -> list[Any]:
            told = [m for s in host.sent if s.kind == "DDATA" for m in s.payload.metrics]
            return [json.loads(str(m.value)) for m in told if m.alias == aliases["Control/Result"]]

        await host.until(lambda: len(results()) == 4)
        assert {(result["source"], result["status"]) for result in results()} == {("sparkplug", "done")}


@BOTH
async def test_a_primary_host_is_waited_for_and_its_loss_ends_the_session(version: str) -> None:
    """Births when it is online, NDEATH and a new connection when it is not, births when it is back."""
    with Mosquitto() as own:
        async with Host(own.port) as host:
            await host.state(False, 1000)
            async with running(own.port, primary_host="scada", version=version) as edge:
                await edge.until(lambda: edge.stats.heard == 1)
                edge.read(output_frequency=5000)
                await host.write(NCMD, REBIRTH, True, DataType.BOOLEAN)
                await edge.until(lambda: edge.stats.heard == 2)
                assert host.kinds == []
                await host.state(True, 2000, "other")
                await host.state(True, 2000)
                await host.until_kinds("NBIRTH", "DBIRTH pump-1")
                await host.state(False, 1999)  # of an older session
                await edge.until(lambda: edge.stats.ignored >= 1)
                assert edge.stats.connects == 1
                await host.state(False, 2000)
                await host.until_kinds("NBIRTH", "NDEATH")
                await edge.until(lambda: edge.stats.connects == 2 and edge.stats.heard == 5)
                assert host.kinds.count("NBIRTH") == 1
                await host.state(True, 3000)
                await host.until(lambda: host.kinds.count("NBIRTH") == 2)
                born = [values(sent)["bdSeq"] for sent in host.sent if sent.kind == "NBIRTH"]
                assert born == [0, 1]


@pytest.mark.parametrize("name", ["pysparkplug", "sparkplug-payload"])
async def test_foreign_decoders_read_what_is_sent(broker: Mosquitto, name: str) -> None:
    """Names, types, values, nulls, times, properties: births, data and deaths of a whole session."""
    async with Host(broker.port) as host:
        async with running(broker.port) as edge:
            edge.read(output_frequency=5012, torque=0xFF9C, status=1, trip_code=1)
            await host.until_kinds("NBIRTH", "DBIRTH pump-1")
            edge.read(output_frequency=3000)
            edge.clock.skip(2 * drives.LONG)
            edge.pump.sweep(edge.clock.now())
            await host.until(lambda: host.kinds.count("DDATA pump-1") >= 2)
            edge.pump.set_link(LinkState.OFFLINE, "no answer")
            await host.until_kinds("DDEATH pump-1", "NDATA")
        await host.until_kinds("NDEATH")
        with Decoder(name) as foreign:
            read = [(sent, foreign.decode(sent.kind, sent.raw, sent.device)) for sent in host.sent]
    assert {sent.kind for sent, _ in read} == {"NBIRTH", "DBIRTH", "DDATA", "DDEATH", "NDATA", "NDEATH"}
    for sent, found in read:
        assert found["timestamp"] == sent.payload.timestamp
        assert found.get("seq") == sent.payload.seq
        theirs = [(m.get("alias"), m["value"], m["timestamp"]) for m in found.get("metrics", [])]
        ours = [(m.alias, m.value, m.timestamp) for m in sent.payload.metrics]
        assert theirs == ours
    born = next(found for sent, found in read if sent.kind == "DBIRTH")
    shown = {metric["name"]: metric for metric in born["metrics"]}
    assert shown["output_frequency"]["value"] == 50.12
    assert shown["output_frequency"]["type"].upper() == "DOUBLE"
    assert shown["torque"]["value"] == -1.0
    assert shown["status"]["type"].upper() == "UINT16"
    if name == "pysparkplug":  # which leaves properties out: as Google's protobuf reads them
        raw = next(m for m in born["raw"]["metrics"] if m["name"] == "output_frequency")["properties"]
        assert dict(zip(raw["keys"], raw["values"], strict=True)) == {
            "readOnly": {"type": 11, "boolean_value": True},
            "engUnit": {"type": 12, "string_value": "Hz"},
            "Quality": {"type": 3, "int_value": 192},
        }
    if name == "sparkplug-payload":
        properties = shown["output_frequency"]["properties"]
        assert properties["Quality"] == {"type": "Int32", "value": 192}
        assert properties["engUnit"] == {"type": "String", "value": "Hz"}
        assert properties["readOnly"] == {"type": "Boolean", "value": True}
        assert shown["command"]["properties"]["Quality"]["value"] == 0
        stale = next(f for s, f in read if s.kind == "DDATA" and len(f["metrics"]) > 1)
        assert {m["properties"]["Quality"]["value"] for m in stale["metrics"]} == {500}
        assert {m["value"] for m in stale["metrics"]} == {None}


async def test_what_is_wrong_is_named_by_its_own_keys() -> None:
    """sparkplug.url, not mqtt.url; and it tries again."""
    with Log("gateway.sparkplug") as log:
        async with running(free_port()):
            await log.until_said("are host and port of sparkplug.url right?")
    for code in range(256):
        assert "mqtt." not in reasons.of_code(code, "", "sparkplug")


@BOTH
def test_commands_are_subscribed_at_qos_1_without_what_was_kept_and_a_state_with_it(version: str) -> None:
    """MQTT 3.1.1 cannot ask for that: what was retained is refused there."""
    (command,) = client.subscriptions(["a"], version)
    state = client.subscription_to_state("b", version)
    if version == "5":
        options = [(each.QoS, each.retainHandling) for _, each in (command, state)]
        assert options == [(1, 2), (1, 0)]
    else:
        assert [command, state] == [("a", 1), ("b", 1)]
