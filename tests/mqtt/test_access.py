"""What the broker is shown, and what is said where it cannot be read."""

from __future__ import annotations

import ssl
import subprocess
from pathlib import Path

import pytest

from gateway.clock import SystemClock
from gateway.config import MqttSection
from gateway.errors import BadConfig
from gateway.metrics import MqttStats
from gateway.mqtt import access
from gateway.mqtt.bridge import Bridge
from tests.mqtt import drives
from tests.mqtt.certificates import Authority


def section(url: str = "mqtts://broker.example", **settings: object) -> MqttSection:
    """Return MQTT settings."""
    return MqttSection.model_validate({"url": url, **settings})


def test_ports_are_the_registered_ones_unless_given() -> None:
    """1883, and 8883 with TLS."""
    assert access.read(section("mqtt://broker.example")).port == 1883
    assert access.read(section()).port == 8883
    given = access.read(section("mqtt://[::1]:7000"))
    assert (given.host, given.port) == ("::1", 7000)


def test_secrets_come_from_where_they_are_said_to_be(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """And show nowhere."""
    (tmp_path / "password").write_text("geheim\n", encoding="utf-8")
    monkeypatch.setenv("MQTT_USER", "pump")
    shown = access.read(section(user={"env": "MQTT_USER"}, password={"file": str(tmp_path / "password")}))
    assert (shown.user, shown.password) == ("pump", "geheim")
    assert "geheim" not in repr(shown)
    assert "pump" not in repr(shown)


@pytest.mark.hazard("H32")
def test_tls_always_verifies() -> None:
    """Certificate and name, 1.2 at least."""
    context = access.read(section()).tls
    assert context is not None
    assert context.verify_mode is ssl.CERT_REQUIRED
    assert context.check_hostname
    assert context.minimum_version is ssl.TLSVersion.TLSv1_2
    assert access.read(section("mqtt://broker.example")).tls is None


@pytest.mark.hazard("H32")
def test_a_bridge_is_not_built_on_what_cannot_be_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The daemon does not start, and says which file or variable it was."""
    monkeypatch.delenv("NO_SUCH", raising=False)
    settings = section(user="pump", password={"env": "NO_SUCH"})
    with pytest.raises(BadConfig, match="NO_SUCH"):
        Bridge(settings, "hall-3", drives.image(), MqttStats(), SystemClock())
    with pytest.raises(BadConfig, match=r"mqtt\.tls\.ca: .*nowhere\.pem"):
        access.read(section(tls={"ca": str(tmp_path / "nowhere.pem")}))
    (tmp_path / "empty.pem").write_text("nothing", encoding="utf-8")
    with pytest.raises(BadConfig, match=r"mqtt\.tls\.ca: .*empty\.pem"):
        access.read(section(tls={"ca": str(tmp_path / "empty.pem")}))


@pytest.mark.e2e
def test_a_key_with_a_passphrase_is_refused_and_never_asked_for(tmp_path: Path) -> None:
    """OpenSSL would ask at the terminal, where nobody is."""
    certificate, key = Authority(tmp_path).issue("pump")
    assert access.read(section(tls={"certificate": str(certificate), "key": str(key)})).tls is not None
    locked = tmp_path / "locked.key"
    subprocess.run(
        ["openssl", "pkey", "-in", str(key), "-aes128", "-passout", "pass:x", "-out", str(locked)], check=True
    )
    with pytest.raises(BadConfig, match="its key without a passphrase"):
        access.read(section(tls={"certificate": str(certificate), "key": str(locked)}))
