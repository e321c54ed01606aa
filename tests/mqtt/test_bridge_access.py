"""Users, passwords and certificates, against a real Mosquitto."""

from __future__ import annotations

import logging
import ssl
import subprocess
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

from tests.mosquitto import Mosquitto, Subscriber
from tests.mqtt.certificates import Authority
from tests.mqtt.rig import FREQUENCY, ROOT, STATUS, Impostor, Log, running

pytestmark = pytest.mark.e2e
PASSWORD = "correct-horse-battery"  # noqa: S105  (of a broker that lives for a second)


@pytest.fixture(scope="module")
def authority(tmp_path_factory: pytest.TempPathFactory) -> Authority:
    """Make an authority that broker and gateway trust."""
    return Authority(tmp_path_factory.mktemp("ca"))


@dataclass(frozen=True, slots=True)
class Guarded:
    """A broker that wants a user and a password."""

    broker: Mosquitto
    options: tuple[str, ...]


@pytest.fixture
def guarded(tmp_path: Path) -> Iterator[Guarded]:
    """Run a broker that knows one user, who may publish below one topic and read everything."""
    passwords, rules = tmp_path / "passwords", tmp_path / "rules"
    subprocess.run(
        ["mosquitto_passwd", "-c", "-b", str(passwords), "pump", PASSWORD], check=True, capture_output=True
    )
    rules.write_text("user pump\ntopic read #\ntopic write tosvert/hall-3/#\n", encoding="utf-8")
    with Mosquitto("allow_anonymous false", f"password_file {passwords}", f"acl_file {rules}") as broker:
        yield Guarded(broker, ("-u", "pump", "-P", PASSWORD))


@pytest.mark.parametrize("version", ["5", "3.1.1"])
async def test_user_and_password_open_the_door(guarded: Guarded, tmp_path: Path, version: str) -> None:
    """The password from a file."""
    (tmp_path / "secret").write_text(PASSWORD + "\n", encoding="utf-8")
    settings: dict[str, Any] = {"user": "pump", "password": {"file": str(tmp_path / "secret")}, "version": version}
    port = guarded.broker.port
    async with Subscriber(port, options=guarded.options) as heard, running(port, **settings) as made:
        made.read(output_frequency=6000)
        await heard.until_payload(FREQUENCY, "60.00")


@pytest.mark.parametrize("version", ["5", "3.1.1"])
async def test_a_wrong_password_is_told_once_and_a_corrected_one_is_taken(
    guarded: Guarded, tmp_path: Path, version: str
) -> None:
    """What to change is said, the secret is not; the file is read anew for each try."""
    secret = tmp_path / "secret"
    secret.write_text("wrong-horse", encoding="utf-8")
    settings: dict[str, Any] = {"user": "pump", "password": {"file": str(secret)}, "version": version}
    with Log() as log:
        async with running(guarded.broker.port, **settings):
            await log.until(lambda lines: len(lines) >= 3)
            assert len(log.lines(logging.WARNING)) == 1
            assert "refused: Not authorized" in log.lines()[0]
            assert "mqtt.password" in log.lines()[0]
            secret.unlink()
            await log.until_said("secret file")
            secret.write_text(PASSWORD, encoding="utf-8")
            async with Subscriber(guarded.broker.port, options=guarded.options) as heard:
                await heard.until_payload(STATUS, "online")
    assert not any(word in line for line in log.lines() for word in ("wrong-horse", PASSWORD))


async def test_a_broker_that_does_not_let_one_publish_is_reported(guarded: Guarded, tmp_path: Path) -> None:
    """MQTT 5 with QoS 1: the only case in which a broker says so."""
    (tmp_path / "secret").write_text(PASSWORD, encoding="utf-8")
    settings: dict[str, Any] = {
        "user": "pump",
        "password": {"file": str(tmp_path / "secret")},
        "base": "elsewhere",
        "qos": 1,
    }
    with Log() as log:
        async with running(guarded.broker.port, **settings):
            await log.until_said("refuses messages: Not authorized (reason code 87H); correct mqtt.user")
    assert len(log.lines(logging.WARNING)) == 1


def tls_lines(authority: Authority, name: str, alternative: str, *, is_client_asked: bool) -> list[str]:
    """Return the configuration of a broker with TLS."""
    certificate, key = authority.issue(name, alternative)
    lines = [f"cafile {authority.certificate}", f"certfile {certificate}", f"keyfile {key}"]
    return [*lines, f"require_certificate {'true' if is_client_asked else 'false'}", "allow_anonymous true"]


@pytest.mark.parametrize("version", ["5", "3.1.1"])
async def test_tls_with_a_client_certificate(authority: Authority, version: str) -> None:
    """Both sides show who they are; values and state come through."""
    certificate, key = (str(path) for path in authority.issue("pump"))
    ca = str(authority.certificate)
    with Mosquitto(*tls_lines(authority, "broker", "IP:127.0.0.1", is_client_asked=True)) as broker:
        tls = {"ca": ca, "certificate": certificate, "key": key}
        settings: dict[str, Any] = {"url": f"mqtts://127.0.0.1:{broker.port}", "tls": tls}
        options = ("--cafile", ca, "--cert", certificate, "--key", key)
        async with Subscriber(broker.port, options=options) as heard:
            async with running(0, **settings, version=version, qos=1) as made:
                await heard.until_payload(STATUS, "online")
                for word in range(1, 51):
                    made.read(output_frequency=word, torque=word)
                await heard.until_payload(FREQUENCY, "0.50")
                await heard.until(lambda: '"torque":0.50' in heard.newest()[f"{ROOT}/state"])
            await heard.until_payload(STATUS, "offline")


async def test_all_of_a_tls_record_is_read(authority: Authority) -> None:
    """Two packets in one record: the socket is silent about the second, which TLS holds already."""
    certificate, key = authority.issue("impostor", "IP:127.0.0.1")
    context = ssl.create_default_context(ssl.Purpose.CLIENT_AUTH)
    context.load_cert_chain(certificate, key)
    accepts_and_throws_out = bytes.fromhex("20 03 00 00 00 e0 02 89 00")
    async with Impostor(accepts_and_throws_out, context) as broker:
        with Log() as log:
            async with running(0, url=f"mqtts://127.0.0.1:{broker.port}", tls={"ca": str(authority.certificate)}):
                await log.until_said("Server busy (reason code 89H)")


@pytest.mark.hazard("H32")
async def test_a_missing_client_certificate_is_explained(authority: Authority) -> None:
    """TLS 1.3 says so after the handshake only."""
    with Mosquitto(*tls_lines(authority, "strict", "IP:127.0.0.1", is_client_asked=True)) as broker, Log() as log:
        settings: dict[str, Any] = {
            "url": f"mqtts://127.0.0.1:{broker.port}",
            "tls": {"ca": str(authority.certificate)},
        }
        async with running(0, **settings):
            await log.until_said("set mqtt.tls.certificate and mqtt.tls.key")


@pytest.mark.filterwarnings("ignore:unclosed <ssl.SSLSocket:ResourceWarning")
@pytest.mark.hazard("H32")
async def test_a_broker_that_cannot_prove_itself_is_not_talked_to(authority: Authority, tmp_path: Path) -> None:
    """Signed by somebody else, or in another's name: closed, explained, and no CONNECT sent."""
    other = Authority(tmp_path, "other")
    with Mosquitto(*tls_lines(authority, "elsewhere", "DNS:elsewhere.example", is_client_asked=False)) as broker:
        for ca, words in (
            (other, "mqtt.tls.ca must hold the authority"),
            (authority, "mqtt.url must name the broker"),
        ):
            settings: dict[str, Any] = {"url": f"mqtts://127.0.0.1:{broker.port}", "tls": {"ca": str(ca.certificate)}}
            with Log() as log:
                async with running(0, **settings) as made:
                    await log.until_said(words)
                assert made.stats.connects == 0
        assert not any("New client connected" in line for line in broker.log)


@pytest.mark.filterwarnings("ignore:unclosed <ssl.SSLSocket:ResourceWarning")
@pytest.mark.hazard("H32")
async def test_tls_where_there_is_none_is_explained() -> None:
    """The usual mix-up of ports."""
    with Mosquitto() as broker, Log() as log:
        async with running(0, url=f"mqtts://127.0.0.1:{broker.port}"):
            await log.until_said("with mqtts:// where it speaks TLS and only there")


async def test_a_host_nobody_knows_is_explained() -> None:
    """A name that cannot exist."""
    with Log() as log:
        async with running(0, url="mqtt://no-such-host.invalid"):
            await log.until_said("the host name in mqtt.url")
