"""Certificates of the server: read, refused, renewed without a restart, and watched as they expire."""

from __future__ import annotations

import asyncio
import logging
import re
import shutil
import ssl
from pathlib import Path
from typing import Any

import pytest

from gateway import site
from gateway.app import App
from gateway.bus.line import Line
from gateway.clock import Clock
from gateway.config import ModbusTlsSection
from gateway.errors import BadConfig, LineDown
from gateway.metrics import TcpStats
from gateway.modbus_tcp.certificate_files import LOOK_EVERY
from gateway.modbus_tcp.credentials import Keyring, load, report
from tests.modbus_tcp.certificates import SERVER_AUTH, Authority, Key, address, openssl, role, usage
from tests.modbus_tcp.rig import until
from tests.modbus_tcp.secured import MovableClock, Pki, client, refused, serving

pytestmark = pytest.mark.e2e

LIMIT = 20.0  # seconds for anything to happen
DAY = 86_400.0  # seconds


@pytest.fixture(scope="module")
def pki(tmp_path_factory: pytest.TempPathFactory) -> Pki:
    """Make an authority and the server's certificate."""
    return Pki(tmp_path_factory.mktemp("pki"))


def section(pki: Pki, **more: Any) -> ModbusTlsSection:
    """Return the configuration of TLS."""
    return ModbusTlsSection.model_validate(pki.section(**more))


@pytest.mark.hazard("H32")
def test_a_client_has_to_show_a_certificate_and_tls_is_1_2_at_least(pki: Pki) -> None:
    """Whatever the library has by default."""
    context = load(section(pki)).context
    assert context.verify_mode is ssl.CERT_REQUIRED
    assert context.minimum_version is ssl.TLSVersion.TLSv1_2
    assert context.options & ssl.OP_NO_RENEGOTIATION


@pytest.mark.hazard("H32")
@pytest.mark.parametrize(
    ("key", "content", "said"),
    [
        ("certificate", None, "certificate .*nowhere"),
        ("key", None, "with key .*nowhere"),
        ("ca", None, r"modbus_tcp\.tls\.ca: .*nowhere"),
        ("crl", None, r"modbus_tcp\.tls\.crl: .*nowhere"),
        ("certificate", "nothing", "a PEM certificate and its key"),
        ("ca", "nothing", r"modbus_tcp\.tls\.ca: "),
        ("key", "other", "a PEM certificate and its key"),
        ("key", "locked", "without a passphrase"),
        ("crl", "ca", "no revocation list"),
    ],
)
def test_what_cannot_be_read_keeps_the_gateway_from_starting(
    pki: Pki, tmp_path: Path, key: str, content: str | None, said: str
) -> None:
    """The file and the key of the configuration are named."""
    path = tmp_path / "nowhere.pem"
    if content == "other":
        Key.make(path)
    elif content == "locked":
        openssl("pkey", "-in", pki.key.path, "-aes128", "-passout", "pass:x", "-out", path)
    elif content == "ca":
        shutil.copy(pki.authority.path, path)
    elif content is not None:
        path.write_text(content, encoding="ascii")
    with pytest.raises(BadConfig, match=said):
        load(section(pki, **{key: str(path)}))


@pytest.mark.hazard("H32")
def test_it_is_warned_days_before_a_certificate_expires_and_once_a_day(
    pki: Pki, caplog: pytest.LogCaptureFixture
) -> None:
    """And said in other words when it has; /metrics has the time."""
    clock, stats = MovableClock(), TcpStats()
    ring = Keyring(section(pki, ca=str(_long(pki).path), warn_days=30), clock, stats)
    assert caplog.messages == []
    assert stats.certificates["certificate"] == pytest.approx(clock.wall() + 90 * DAY, abs=60)
    assert stats.certificates["ca"] > stats.certificates["certificate"]
    for day in range(91):
        clock.shift = day * DAY
        for _ in range(3):
            clock.moment += DAY / 3
            ring.pulse()
    warnings = [record for record in caplog.records if record.levelno == logging.WARNING]
    assert 29 <= len(warnings) <= 31
    assert "expires in 30.0 days: then clients may only read" in warnings[0].getMessage()
    assert ring.is_own_valid is False
    assert caplog.records[-1].levelno == logging.ERROR
    assert "has expired: clients may only read by TLS until it is renewed" in caplog.messages[-1]
    clock.shift = -2 * DAY
    clock.moment += 2 * DAY
    ring.pulse()
    assert ring.is_own_valid is False
    assert "is not valid yet" in caplog.messages[-1]


def _long(pki: Pki) -> Authority:
    """Make an authority that holds for years."""
    folder = pki.folder / "long"
    folder.mkdir(exist_ok=True)
    return Authority(folder, "long", ends=4000.0)


@pytest.mark.hazard("H32")
async def test_renewed_certificates_are_taken_without_a_restart(tmp_path: Path) -> None:
    """Who is connected stays; wrong files change nothing; an authority that is gone is trusted no more."""
    pki = Pki(tmp_path)
    old = pki.holder_of("viewer")
    (tmp_path / "other").mkdir()
    other = Authority(tmp_path / "other", "other")
    new = pki.context(pki.client("new", role("viewer"), by=other))
    old_server = pki.server.read_bytes()
    async with asyncio.timeout(LIMIT), serving(pki) as server, client(server.tls_port, old) as stays:
        trusted = pki.authority.path.read_bytes()
        pki.authority.path.write_text("nothing", encoding="ascii")
        server.renew()
        async with client(server.tls_port, old) as one:
            assert (await one.ask(255, bytes.fromhex("0300000001")))[0] == 3
        pki.server.write_bytes(old_server)
        pki.authority.path.write_bytes(other.path.read_bytes())
        server.clock.moment += LOOK_EVERY
        server.sweep()
        async with client(server.tls_port, new) as one:
            assert (await one.ask(255, bytes.fromhex("0300000001")))[0] == 3
        await refused(server.tls_port, old)
        assert (await stays.ask(255, bytes.fromhex("0300000001")))[0] == 3
        pki.authority.path.write_bytes(trusted)


def test_an_expired_certificate_of_the_gateway_is_loaded_and_said_to_be(
    pki: Pki, caplog: pytest.LogCaptureFixture
) -> None:
    """The gateway starts: values can still be read by clients that bear with it."""
    expired = pki.authority.issue("was", pki.key, address(), usage(SERVER_AUTH), begins=-9.0, ends=-1.0)
    ring = Keyring(section(pki, certificate=str(expired)), MovableClock(), TcpStats())
    assert ring.is_own_valid is False
    assert any("has expired" in message for message in caplog.messages)


@pytest.mark.hazard("H32")
def test_check_says_how_long_certificates_hold_and_what_is_wrong_with_them(pki: Pki) -> None:
    """Before anything runs; a file that is not there may be on another machine, and is no error here."""
    now = MovableClock().wall()
    long = section(pki, ca=str(_long(pki).path))
    assert re.fullmatch(r"certificate holds until 20\d\d-\d\d-\d\d; ca holds until 20\d\d-.*", report(long, now))
    assert report(long, now + 91 * DAY).startswith("WARNING: certificate has expired on 20")
    early = report(long, now - 9 * DAY)
    assert early == "WARNING: certificate is not valid yet; WARNING: ca is not valid yet"
    assert report(section(pki, ca="/nowhere.pem"), now).startswith("WARNING: modbus_tcp.tls.ca: /nowhere.pem: ")


@pytest.mark.hazard("H32")
async def test_sighup_reads_certificates_anew_though_the_configuration_is_the_same(
    pki: Pki, caplog: pytest.LogCaptureFixture
) -> None:
    """Nothing else is begun anew: no drive is disarmed for it."""
    caplog.set_level(logging.INFO)
    ca = pki.folder / "reloaded.pem"
    shutil.copy(pki.authority.path, ca)
    line = {"name": "a", "port": "/dev/null", "drive": [{"name": "d1", "number": 1, "model": "vf-nc3"}]}
    tcp = {"listen": "off", "tls": pki.section(ca=str(ca))}
    configured = site.build({"gateway": {"name": "g"}, "modbus_tcp": tcp, "line": [line]}, "test", pki.folder)
    app = App(configured, opener=_nothing, load=lambda: configured)
    async with asyncio.timeout(LIMIT):
        running = asyncio.create_task(app.run())
        await until(lambda: app.has_started)
        ca.write_bytes(_long(pki).path.read_bytes())
        app.reload()
        await until(lambda: "not reloaded: nothing has changed" in caplog.text)
        assert "the certificates of modbus_tcp.tls were read anew" in caplog.text
        assert app.successor is None
        app.stop()
        await running


async def _nothing(_line: site.Line, _clock: Clock) -> Line:
    """Open nothing."""
    raise LineDown("no such device")
