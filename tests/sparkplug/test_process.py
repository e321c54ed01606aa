"""The gateway as a process between a simulated drive and a host: commands that move the motor, and deaths."""

from __future__ import annotations

import contextlib
import json
import subprocess
import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pytest

from gateway.sparkplug.payload import DataType, Metric, Payload, Value, decode, encode
from tests.controlled import CONTROL, F803, LEASE, Stage, plant, staged
from tests.mosquitto import Mosquitto, program
from tests.processes import LIMIT, until
from tests.sparkplug.rig import Sent, parted

pytestmark = pytest.mark.e2e

NODE = "spBv1.0/plant-1/{}/hall-3"
STATE = "spBv1.0/STATE/scada"
PUMP = "spBv1.0/plant-1/DCMD/hall-3/pump-1"


@dataclass
class Host:
    """A host application: what it has heard, and what it writes."""

    broker: Mosquitto
    heard: Path
    beats: int = 0
    aliases: dict[int, str] = field(default_factory=dict)

    @property
    def sent(self) -> list[Sent]:
        """Return what the edge node sent."""
        found = []
        for line in self.heard.read_text(encoding="utf-8").splitlines(keepends=True):
            if line.endswith("\n"):
                topic, payload = line.split()
                raw = bytes.fromhex(payload)
                found.append(Sent(*parted(topic), decode(raw), raw))
        return found

    @property
    def shown(self) -> dict[str, Value]:
        """Return the newest value of each metric of the drive, as a host has it."""
        values: dict[str, Value] = {}
        names: dict[int | None, str] = {}
        for sent in self.sent:
            if sent.device != "pump-1":
                continue
            names |= {metric.alias: metric.name for metric in sent.payload.metrics if metric.name}
            values |= {names[metric.alias]: metric.value for metric in sent.payload.metrics}
        return values

    def kinds(self) -> list[str]:
        """Return the kinds of what was sent."""
        return [sent.kind for sent in self.sent]

    def publish(self, topic: str, payload: bytes, *options: str) -> None:
        """Publish bytes."""
        arguments = [program("mosquitto_pub"), "-h", "127.0.0.1", "-p", str(self.broker.port), "-t", topic, "-s"]
        subprocess.run([*arguments, *options], input=payload, check=True)

    def state(self, is_online: bool) -> None:
        """Say whether it is online, at QoS 1 and retained."""
        text = json.dumps({"online": is_online, "timestamp": round(time.time() * 1000)})
        self.publish(STATE, text.encode(), "-q", "1", "-r")

    def write(self, *metrics: tuple[str, Value, DataType]) -> None:
        """Write metrics of the drive at once."""
        made = tuple(Metric(name, None, None, datatype, value) for name, value, datatype in metrics)
        self.publish(PUMP, encode(Payload(round(time.time() * 1000), made)))

    def press(self, *names: str) -> None:
        """Press buttons, one after the other, in one message."""
        self.write(*((f"Control/{name}", True, DataType.BOOLEAN) for name in names))

    def arm(self) -> None:
        """Take and arm, and wait until that is told; an arm while F803 is being set is refused, and asked again."""
        self.press("Take")

        def is_armed() -> bool:
            if self.shown.get("Control/Standing") == "armed":
                return True
            self.press("Arm")
            self.beat()
            return False

        until(is_armed, "an armed drive")

    def beat(self) -> None:
        """Send another number as a sign of life."""
        self.beats += 1
        self.write(("Control/Heartbeat", self.beats, DataType.INT64))

    def beat_until(self, condition: Any, what: str) -> None:
        """Keep the lease alive until something holds."""

        def beaten() -> bool:
            self.beat()
            return bool(condition())

        until(beaten, what)

    def results(self) -> list[dict[str, Any]]:
        """Return the results that were told, in order."""
        found = []
        names: dict[int | None, str] = {}
        for sent in self.sent:
            names |= {metric.alias: metric.name for metric in sent.payload.metrics if metric.name}
            told = [m for m in sent.payload.metrics if sent.kind == "DDATA" and names[m.alias] == "Control/Result"]
            found += [json.loads(str(metric.value)) for metric in told]
        return found


@contextlib.contextmanager
def listening(broker: Mosquitto, folder: Path) -> Iterator[Host]:
    """Listen as a host while the `with` block lasts."""
    path = folder / "heard"
    with path.open("w") as output:
        arguments = ["-h", "127.0.0.1", "-p", str(broker.port), "-F", "%t %x", "-q", "1", "-t", "spBv1.0/plant-1/#"]
        process = subprocess.Popen(
            ["stdbuf", "-oL", "mosquitto_sub", *arguments, "-T", "spBv1.0/plant-1/DCMD/#"], stdout=output
        )
        try:
            yield Host(broker, path)
        finally:
            process.kill()
            process.wait(LIMIT)


@contextlib.contextmanager
def scene(folder: Path, control: str = CONTROL) -> Iterator[tuple[Stage, Host]]:
    """Start a line, a broker, a host that is online, and the gateway; wait until the drive is born."""
    with plant(folder) as (line, broker), listening(broker, folder) as host:
        more = f"""[sparkplug]
url = "mqtt://127.0.0.1:{broker.port}"
group_id = "plant-1"
primary_host = "scada"
commands = true
reconnect_at_most = "1s"
"""
        host.state(True)
        with staged(line, broker, folder, control, more) as stage:
            until(lambda: host.shown.get("output_frequency") == 0.0, "the value of a born drive")
            yield stage, host


@pytest.mark.hazard("H05")
def test_a_host_takes_arms_and_runs_a_motor_and_its_death_stops_it(tmp_path: Path) -> None:
    """All by DCMD; heartbeats keep the lease, and STATE offline ends it though they went on until then."""
    with scene(tmp_path) as (stage, host):
        host.arm()
        host.write(("Control/Frequency", 30.0, DataType.DOUBLE), ("Control/Run", True, DataType.BOOLEAN))
        host.beat_until(lambda: host.shown.get("output_frequency") == 30.0, "30 Hz, as the host sees it")
        assert stage.drive["frequency"] == 30.0
        done = dict.fromkeys(r["command"] for r in host.results() if r["status"] == "done")
        assert list(done) == ["take", "arm", "frequency", "run"]
        assert host.shown["Control/Owner"] == "sparkplug scada"
        for _ in range(3):
            host.beat()
        began = stage.now
        host.state(False)
        until(lambda: not stage.is_running, "a stopped motor")
        assert stage.now - began < LEASE + F803
        assert "the primary host scada is offline" in stage.until_event("lease_lost")["reason"]
        until(lambda: "NDEATH" in host.kinds(), "NDEATH")


@pytest.mark.hazard("H05")
def test_a_host_that_stays_online_without_heartbeats_loses_its_lease(tmp_path: Path) -> None:
    """Its STATE is retained and says online all the time; the motor is stopped all the same."""
    with scene(tmp_path) as (stage, host):
        host.arm()
        host.write(("Control/Frequency", 20.0, DataType.DOUBLE), ("Control/Run", True, DataType.BOOLEAN))
        host.beat_until(lambda: stage.is_running, "a running motor")
        host.state(True)
        until(lambda: not stage.is_running, "a stopped motor")
        assert "the lease of sparkplug scada has ended" in stage.until_event("lease_lost")["reason"]
        assert "NDEATH" not in host.kinds()


def test_a_killed_gateway_is_an_ndeath_of_its_birth(tmp_path: Path) -> None:
    """The broker says it, with the number that the NBIRTH had."""
    with scene(tmp_path, control="") as (stage, host):
        stage.process.kill()
        until(lambda: "NDEATH" in host.kinds(), "NDEATH")
        numbers = {sent.kind: [m.value for m in sent.payload.metrics if m.name == "bdSeq"] for sent in host.sent
                   if sent.kind in ("NBIRTH", "NDEATH")}  # fmt: skip
        assert numbers["NBIRTH"] == numbers["NDEATH"] == [0]


def test_a_gateway_that_ends_says_so_itself(tmp_path: Path) -> None:
    """By NDEATH, before it disconnects."""
    with scene(tmp_path, control="") as (stage, host):
        stage.process.terminate()
        stage.process.wait(LIMIT)
        until(lambda: "NDEATH" in host.kinds(), "NDEATH")


def test_a_drive_that_is_lost_dies_and_comes_back(tmp_path: Path) -> None:
    """DDEATH when it is lost, DBIRTH with values when it answers again."""
    with scene(tmp_path, control="") as (stage, host):
        stage.line.unplug()
        until(lambda: "DDEATH" in host.kinds(), "DDEATH")
        stage.line.plug()
        until(lambda: host.kinds().count("DBIRTH") == 2, "a second DBIRTH")
        until(lambda: host.shown["output_frequency"] == 0.0, "its values")
