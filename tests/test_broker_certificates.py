"""The gateway's certificates at brokers: how long they hold, and what is said before they hold no more."""

from __future__ import annotations

import logging
import time
from pathlib import Path
from typing import Any

import pytest
from prometheus_client.core import Metric

from gateway import site
from gateway.broker_certificates import Watches, report
from gateway.image import Image
from gateway.metrics import MqttStats, Stats
from gateway.modbus_tcp.certificate_files import DAY, LOOK_EVERY
from gateway.site import Site
from gateway.web import page
from gateway.web.exposition import families
from tests.modbus_tcp.certificates import Authority, Key
from tests.web.rig import table

BEGAN = time.time()


class Calendar:
    """A clock that is put forward by the day."""

    def __init__(self) -> None:
        self.seconds = 0.0

    def now(self) -> float:
        """Return monotonic seconds."""
        return self.seconds

    def wall(self) -> float:
        """Return UTC seconds."""
        return BEGAN + self.seconds

    def alarm(self) -> Any:
        """Nobody waits here."""
        raise NotImplementedError


class Plant:
    """A gateway with two brokers, one of them by TLS, and Sparkplug by that one's connection."""

    def __init__(self, folder: Path, **tls: object) -> None:
        self.authority = Authority(folder, ends=365.0)
        self.key = Key.make(folder / "client.key")
        self.certificate = self.issue(20.0)
        files = {"ca": str(self.authority.path), "certificate": str(self.certificate), "key": str(self.key.path)}
        brokers = [
            {"name": "plant", "url": "mqtts://plant", "tls": {**files, **tls}},
            {"name": "cloud", "url": "mqtts://cloud"},
        ]
        self.site: Site = site.build(table(mqtt=brokers, sparkplug={"group_id": "g"}), "test", folder)
        self.clock = Calendar()
        self.stats = Stats(started=BEGAN, brokers={"plant": MqttStats(), "cloud": MqttStats()})
        self.watches = Watches(self.site.config, self.stats, self.clock)

    def issue(self, days: float, begins: float = -1.0) -> Path:
        """Write the client's certificate anew; it holds for so many days."""
        return self.authority.issue("client", self.key, begins=begins, ends=days)

    def metrics(self) -> dict[str, Metric]:
        """Return all metrics by name."""
        image = Image(self.site.drives)
        return {family.name: family for family in families(self.site, image, self.stats, self.clock.now())}


@pytest.fixture
def plant(tmp_path: Path) -> Plant:
    """Return a plant whose client certificate holds for 20 days."""
    return Plant(tmp_path)


@pytest.mark.hazard("H32")
def test_it_is_warned_once_a_day_by_the_channel_of_the_broker(plant: Plant, caplog: pytest.LogCaptureFixture) -> None:
    """From `warn_days` before it expires on; and said in other words when it has."""
    for third in range(22 * 3):
        plant.clock.seconds = third * DAY / 3
        plant.watches.pulse()
    of_broker = [record for record in caplog.records if record.name == "gateway.mqtt.plant"]
    warnings = [record for record in of_broker if record.levelno == logging.WARNING]
    path = plant.certificate
    assert warnings[0].getMessage() == f"mqtt.tls.certificate {path} expires in 20.0 days: then the broker refuses it"
    assert 19 <= len(warnings) <= 21
    told = of_broker[-1]
    assert told.levelno == logging.ERROR
    assert told.getMessage() == f"mqtt.tls.certificate {path} has expired: the broker refuses it until it is renewed"
    assert {record.name for record in caplog.records} == {"gateway.mqtt.plant", "gateway.sparkplug"}


def test_nothing_is_said_of_what_holds_for_longer(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    """`warn_days` says for how much longer."""
    plant = Plant(tmp_path, warn_days=10)
    plant.watches.pulse()
    assert caplog.messages == []
    plant.clock.seconds = 10.1 * DAY
    plant.watches.pulse()
    assert "expires in 9.9 days" in caplog.text


def test_a_renewed_certificate_is_seen(plant: Plant, caplog: pytest.LogCaptureFixture) -> None:
    """Within ten seconds, without a restart; so is one that cannot be read, whose time is then not known."""
    plant.watches.pulse()
    before = plant.stats.brokers["plant"].certificates["certificate"]
    caplog.clear()
    plant.issue(200.0)
    plant.clock.seconds = LOOK_EVERY
    plant.watches.pulse()
    assert plant.stats.brokers["plant"].certificates["certificate"] == pytest.approx(before + 180 * DAY, abs=60)
    assert caplog.messages == []
    plant.certificate.write_text("nothing", encoding="ascii")
    for looks in (2, 3):
        plant.clock.seconds = looks * LOOK_EVERY
        plant.watches.pulse()
    assert "certificate" not in plant.stats.brokers["plant"].certificates
    assert caplog.text.count(f"mqtt.tls.certificate: {plant.certificate}: no certificate in it") == 1
    plant.issue(200.0, begins=100.0)
    plant.clock.seconds = 4 * LOOK_EVERY
    plant.watches.pulse()
    assert "is not valid yet: the broker refuses it; is the clock right?" in caplog.text


def test_an_old_authority_beside_one_that_holds_is_no_alarm(plant: Plant, caplog: pytest.LogCaptureFixture) -> None:
    """The system's bundle has some; and where one takes the place of another, both are in the file for a while."""
    folder = plant.authority.path.parent / "old"
    folder.mkdir()
    both = Authority(folder, ends=40.0).path.read_text(encoding="ascii") + plant.authority.path.read_text("ascii")
    plant.authority.path.write_text(both, encoding="ascii")
    plant.issue(300.0)
    tls = plant.site.config.brokers[0]
    for day, text in ((0, ""), (15, "expires in 25.0 days: then the broker's certificate is not trusted"), (41, "")):
        caplog.clear()
        plant.clock.seconds = day * DAY
        plant.watches.pulse()
        assert text in caplog.text if text else caplog.messages == []
        expires = (plant.stats.brokers["plant"].certificates["ca"] - BEGAN) / DAY
        assert expires == pytest.approx(365.0 if day == 41 else 40.0, abs=0.1)
        assert not list(report(tls, BEGAN + day * DAY))[1].startswith("WARNING")


def test_metrics_and_the_document_have_the_times(plant: Plant) -> None:
    """By broker, and of Sparkplug's connection; a broker without a certificate has none."""
    plant.watches.pulse()
    found = plant.metrics()
    (own, ca) = (plant.stats.brokers["plant"].certificates[what] for what in ("certificate", "ca"))
    told = {
        (name, *sample.labels.values()): sample.value
        for name in ("tosvert_mqtt_certificate_expires_seconds", "tosvert_sparkplug_certificate_expires_seconds")
        for sample in found[name].samples
    }
    assert told == {
        ("tosvert_mqtt_certificate_expires_seconds", "plant", "ca"): ca,
        ("tosvert_mqtt_certificate_expires_seconds", "plant", "certificate"): own,
        ("tosvert_sparkplug_certificate_expires_seconds", "ca"): ca,
        ("tosvert_sparkplug_certificate_expires_seconds", "certificate"): own,
    }
    health = page.judge(plant.site, Image(plant.site.drives), plant.stats, 0.0)
    document = page.as_document(health, plant.site, plant.stats, BEGAN)["certificates"]
    assert set(document) == {"mqtt/plant", "sparkplug"}
    assert document["mqtt/plant"]["ca"].endswith("Z")


def test_check_says_how_long_they_hold(plant: Plant) -> None:
    """Before anything runs; a file that is not there may be on another machine, and is no error here."""
    tls, plain = plant.site.config.brokers
    assert list(report(plain, BEGAN)) == []
    own, ca = report(tls, BEGAN)
    assert own.startswith(f"certificate {plant.certificate} holds until 20")
    assert ca.startswith(f"ca {plant.authority.path} holds until 20")
    assert next(report(tls, BEGAN + 21 * DAY)).startswith(f"WARNING: certificate {plant.certificate} has expired on")
    assert next(report(tls, BEGAN - 9 * DAY)) == f"WARNING: certificate {plant.certificate} is not valid yet"
    plant.certificate.unlink()
    assert next(report(tls, BEGAN)).startswith(f"WARNING: mqtt.tls.certificate: {plant.certificate}: [Errno 2]")
