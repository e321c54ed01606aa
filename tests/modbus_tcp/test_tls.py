"""MODBUS/TCP Security over loopback: who is let in, as whom, and what becomes of all others."""

from __future__ import annotations

import asyncio
import contextlib
import logging
import socket
import ssl
import subprocess
from collections.abc import Callable, Coroutine
from pathlib import Path
from typing import Any

import pytest
import uvloop
from pymodbus.client import ModbusTcpClient

from gateway.errors import GatewayError
from gateway.modbus_tcp.role_certificate import LONGEST_ROLE
from tests.modbus_tcp.certificates import (
    BMP,
    CLIENT_AUTH,
    IA5,
    PRINTABLE,
    ROLE,
    SERVER_AUTH,
    UTF8,
    Authority,
    extension,
    openssl,
    role,
    signed,
    tlv,
    usage,
    write_pem,
)
from tests.modbus_tcp.plant import Listening, exchange, several
from tests.modbus_tcp.rig import read, request, until
from tests.modbus_tcp.secured import Pki, Secured, by_hand, client, raw, refused, serving
from tests.modbus_tcp.test_rtu_framing import frame

pytestmark = pytest.mark.e2e

LIMIT = 20.0  # seconds for anything to happen
LOOPS = {"asyncio": asyncio.new_event_loop, "uvloop": uvloop.new_event_loop}
FREQUENCY = bytes.fromhex("03fd000001")
ANSWERED = bytes.fromhex("03021770")
DENIED = b"\x83\x01"
Scenario = Callable[[], Coroutine[None, None, None]]


@pytest.fixture(scope="module")
def pki(tmp_path_factory: pytest.TempPathFactory) -> Pki:
    """Make an authority and the server's certificate."""
    return Pki(tmp_path_factory.mktemp("pki"))


@pytest.fixture(params=LOOPS)
def run(request: pytest.FixtureRequest) -> Callable[[Scenario], None]:
    """Run a scenario on one loop and the other."""

    def in_time(scenario: Scenario) -> None:
        async def main() -> None:
            async with asyncio.timeout(LIMIT):
                await scenario()

        with asyncio.Runner(loop_factory=LOOPS[request.param]) as runner:
            runner.run(main())

    return in_time


@pytest.mark.hazard("H28")
def test_a_client_with_a_role_is_answered(pki: Pki, run: Callable[[Scenario], None]) -> None:
    """By TLS 1.3 and 1.2, one request after another, many in one piece, and with a goodbye at the end."""

    async def scenario() -> None:
        async with serving(pki) as server:
            for version in (ssl.TLSVersion.TLSv1_3, ssl.TLSVersion.TLSv1_2):
                context = pki.holder_of("viewer")
                context.maximum_version = version
                async with client(server.tls_port, context) as made:
                    assert await made.ask(1, FREQUENCY) == ANSWERED
                    assert await made.ask(1, FREQUENCY) == ANSWERED
                    assert (await made.ask(255, bytes.fromhex("03000000fa")))[:2] == b"\x83\x03"
                    made.writer.write(b"".join(read(i, 255, 0, 64) for i in range(200)))
                    await made.reader.readexactly(200 * (9 + 128))
                    made.writer.close()
                    await made.writer.wait_closed()
            await until(lambda: server.stats.tcp.connections == 0)
            assert server.ends == {"done": 2}

    run(scenario)


RIGHT = {
    "whole": (role("viewer"),),
    "critical": (extension(ROLE, tlv(UTF8, b"viewer"), is_critical=True),),
    "no usage at all": (role("viewer"),),
    "longest role": (role("x" * LONGEST_ROLE),),
    "server and client": (role("viewer"), usage(CLIENT_AUTH, SERVER_AUTH)),
}
NO_ROLE = {
    "no role": (),
    "two roles": (role("viewer"), role("operator")),
    "the same role twice": (role("viewer"), role("viewer")),
    "empty role": (role(""),),
    "printable string": (role("viewer", PRINTABLE),),
    "IA5 string": (role("viewer", IA5),),
    "BMP string": (role("viewer", BMP),),
    "no string": (extension(ROLE, b"viewer"),),
    "not UTF-8": (extension(ROLE, tlv(UTF8, b"\xff")),),
    "more behind it": (extension(ROLE, tlv(UTF8, b"viewer") + b"\0"),),
    "too long role": (role("x" * (LONGEST_ROLE + 1)),),
    "control character": (role("viewer\n"),),
}


@pytest.mark.hazard("H28")
@pytest.mark.parametrize("name", [*NO_ROLE, "critical"])
async def test_a_certificate_without_exactly_one_role_opens_no_right(
    pki: Pki, name: str, caplog: pytest.LogCaptureFixture
) -> None:
    """It is let in, as the specification says, and whatever it asks is 01."""
    extensions = NO_ROLE.get(name, RIGHT["critical"])
    context = pki.context(pki.client(f"holder of {name}", *extensions))
    async with asyncio.timeout(LIMIT), serving(pki) as server:
        if name == "critical":  # OpenSSL knows no such extension, and it may not be passed over
            await refused(server.tls_port, context)
            assert server.ends == {"untrusted": 1}
            return
        async with client(server.tls_port, context) as made:
            for pdu in (FREQUENCY, b"\x2b\x0e\x01\x00", several(0xFA00, 0), b"\x05\0\0\0\0", b"\x03"):
                assert await made.ask(1, pdu) == bytes((pdu[0] | 0x80, 1))
            assert await made.ask(99, FREQUENCY) == DENIED
            assert (server.ends, server.stats.tcp.denied) == ({"no_role": 1}, 6)
            assert "without any right" in caplog.text


@pytest.mark.parametrize("name", [name for name in RIGHT if name != "critical"])
async def test_right_certificates_come_in_many_forms(pki: Pki, name: str) -> None:
    """With a usage and without, with a role of 64 characters."""
    made = pki.authority.issue(f"right-{name}", pki.key, *RIGHT[name])
    async with asyncio.timeout(LIMIT), serving(pki) as server, client(server.tls_port, pki.context(made)) as one:
        assert await one.ask(1, FREQUENCY) == ANSWERED


def _wrong(pki: Pki, name: str) -> Path | None:
    """Make a certificate that is wrong in one way."""
    viewer = role("viewer")
    if name == "expired":
        return pki.client(name, viewer, begins=-3.0, ends=-0.01)
    if name == "not yet valid":
        return pki.client(name, viewer, begins=0.5)
    if name == "another authority":
        return pki.client(name, viewer, by=Authority(pki.folder, "other"))
    if name == "another authority of the same name":
        (pki.folder / "twin").mkdir()
        return pki.client(name, viewer, by=Authority(pki.folder / "twin"))
    if name == "signed by itself":
        return write_pem(pki.folder / "own.pem", signed("own", pki.key, "own", pki.key, viewer))
    if name == "for servers only":
        return pki.authority.issue(name, pki.key, viewer, usage(SERVER_AUTH))
    if name == "changed behind the signature":
        der = bytearray(signed("changed", pki.key, "ca", pki.authority.key, viewer))
        at = der.index(b"viewer")
        der[at : at + 6] = b"master"
        return write_pem(pki.folder / "changed.pem", bytes(der))
    if name == "intermediate that is not sent":
        return pki.client(name, viewer, by=Authority(pki.folder, "below", pki.authority))
    if name == "signed by another client":
        no_authority = Authority(pki.folder, "client-as-ca", pki.authority)
        no_authority.der = signed("client-as-ca", no_authority.key, "ca", pki.authority.key, viewer)
        return pki.client(name, viewer, by=no_authority, above=(no_authority.der,))
    return None


@pytest.mark.hazard("H32")
@pytest.mark.parametrize(
    ("name", "kind", "said"),
    [
        ("no certificate", "no_certificate", "it shows no certificate"),
        ("expired", "expired", "its certificate has expired"),
        ("not yet valid", "not_yet_valid", "are the clocks right?"),
        ("another authority", "untrusted", "modbus_tcp.tls.ca does not hold the authority"),
        ("another authority of the same name", "untrusted", "modbus_tcp.tls.ca"),
        ("signed by itself", "untrusted", "modbus_tcp.tls.ca"),
        ("for servers only", "unsuitable", "not for clients"),
        ("changed behind the signature", "untrusted", "modbus_tcp.tls.ca"),
        ("intermediate that is not sent", "untrusted", "modbus_tcp.tls.ca"),
        ("signed by another client", "untrusted", "modbus_tcp.tls.ca"),
    ],
)
async def test_a_wrong_certificate_is_not_let_in(
    pki: Pki, name: str, kind: str, said: str, caplog: pytest.LogCaptureFixture
) -> None:
    """It is counted and said why, it had no place, and the client is told by an alert."""
    async with asyncio.timeout(LIMIT), serving(pki) as server:
        told = await refused(server.tls_port, pki.context(_wrong(pki, name)))
        assert "alert" in told.lower()
        assert server.ends == {kind: 1}
        assert said in caplog.text
        assert (server.stats.tcp.accepted, server.stats.tcp.connections) == (0, 0)
        async with client(server.tls_port, pki.holder_of("viewer")) as made:
            assert await made.ask(1, FREQUENCY) == ANSWERED


async def test_an_intermediate_authority_is_followed(pki: Pki) -> None:
    """A client that shows the chain needs nothing but the root here."""
    below = Authority(pki.folder, "intermediate", pki.authority)
    chain = pki.client("below", role("viewer"), by=below, above=(below.der,))
    async with asyncio.timeout(LIMIT), serving(pki) as server, client(server.tls_port, pki.context(chain)) as made:
        assert await made.ask(1, FREQUENCY) == ANSWERED


@pytest.mark.hazard("H32")
@pytest.mark.parametrize("ends", [1.0, -0.5])
async def test_a_revoked_certificate_is_not_let_in_nor_anyone_by_an_old_list(pki: Pki, ends: float) -> None:
    """A list that is not valid any more is not believed for anybody."""
    first, second = pki.client("revoked", role("viewer")), pki.client("kept", role("viewer"))
    crl = _revoke(pki, first, ends)
    async with asyncio.timeout(LIMIT), serving(pki, tls={"crl": str(crl)}) as server:
        await refused(server.tls_port, pki.context(first))
        if ends > 0:
            assert server.ends == {"revoked": 1}
            async with client(server.tls_port, pki.context(second)) as made:
                assert await made.ask(1, FREQUENCY) == ANSWERED
        else:
            await refused(server.tls_port, pki.context(second))
            assert server.ends == {"no_crl": 2}


def _revoke(pki: Pki, certificate: Path, ends: float) -> Path:
    """Have openssl make a list of one revoked certificate; it holds for so many days."""
    folder = pki.folder / f"crl-{ends}"
    folder.mkdir()
    (folder / "index.txt").touch()
    (folder / "ca.cnf").write_text(
        f"[ca]\ndefault_ca=it\n[it]\ndatabase={folder}/index.txt\ndefault_md=sha256\n", encoding="ascii"
    )
    own = ("-config", folder / "ca.cnf", "-cert", pki.authority.path, "-keyfile", pki.authority.key.path)
    openssl("ca", *own, "-revoke", certificate)
    past = ("-crl_lastupdate", "200101000000Z", "-crl_nextupdate", "200102000000Z")
    times = ("-crlsec", "86400") if ends > 0 else past
    openssl("ca", *own, "-gencrl", *times, "-out", folder / "list.pem")
    return folder / "list.pem"


@pytest.mark.hazard("H32")
async def test_older_versions_of_tls_are_refused(pki: Pki) -> None:
    """1.1 and 1.0: the client would speak nothing newer."""
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    context.load_verify_locations(pki.authority.path)
    context.set_ciphers("ALL:@SECLEVEL=0")
    with pytest.warns(DeprecationWarning, match="TLSv1 is deprecated"):
        context.minimum_version = ssl.TLSVersion.TLSv1
    with pytest.warns(DeprecationWarning, match="TLSv1_1 is deprecated"):
        context.maximum_version = ssl.TLSVersion.TLSv1_1
    async with asyncio.timeout(LIMIT), serving(pki) as server:
        await refused(server.tls_port, context)
        assert server.ends == {"version": 1}


async def test_a_client_without_a_safe_cipher_is_refused(pki: Pki) -> None:
    """Ciphers without encryption are none, though the specification has them."""
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    context.load_verify_locations(pki.authority.path)
    context.maximum_version = ssl.TLSVersion.TLSv1_2
    context.set_ciphers("NULL:@SECLEVEL=0")
    async with asyncio.timeout(LIMIT), serving(pki) as server:
        await refused(server.tls_port, context)
        assert server.ends == {"no_cipher": 1}


@pytest.mark.hazard("H26")
@pytest.mark.parametrize("data", [read(1, 1, 0xFD00, 1), b"GET / HTTP/1.1\r\n\r\n", bytes(300), b"\xff" * 300])
async def test_what_is_no_tls_is_closed_at_once(pki: Pki, data: bytes) -> None:
    """A plain request on the port for TLS is not answered."""
    async with asyncio.timeout(LIMIT), serving(pki) as server:
        told = await raw(server.tls_port, data)
        assert ANSWERED not in told
        assert server.ends == {"not_tls": 1}


@pytest.mark.hazard("H26")
async def test_tls_on_the_port_without_it_is_closed_at_once(pki: Pki) -> None:
    """A hello is no MODBUS-TCP header."""
    async with asyncio.timeout(LIMIT), serving(pki) as server:
        await refused(server.plain_port, pki.holder_of("viewer"))
        await until(lambda: server.stats.tcp.connections == 0)
        assert server.ends == {}


@pytest.mark.hazard("H32")
async def test_a_client_that_does_not_trust_the_gateway_is_told_in_the_log(
    pki: Pki, caplog: pytest.LogCaptureFixture
) -> None:
    """It has another authority than the one that signed the gateway's certificate."""
    async with asyncio.timeout(LIMIT), serving(pki) as server:
        with pytest.raises(ssl.SSLCertVerificationError):
            await asyncio.to_thread(_ask_by_socket, server.tls_port, ssl.create_default_context(), None)
        await until(lambda: server.ends == {"refused_by_client": 1})
        assert "it may not trust the gateway's certificate" in caplog.text


@pytest.mark.hazard("H25")
async def test_half_open_handshakes_take_no_place_and_are_given_up(pki: Pki) -> None:
    """Twice as many as places: the oldest give way, who has a certificate comes in, the rest is swept away."""
    async with asyncio.timeout(LIMIT), serving(pki, connections=4, tls={"handshake_timeout": "5s"}) as server:
        stalled = [await asyncio.open_connection("127.0.0.1", server.tls_port) for _ in range(8)]
        stalled[-1][1].write(b"\x16\x03\x01\x02\0\x01\0\x01\xfc")  # as a hello begins
        await until(lambda: server.ends == {"pushed_out": 4})
        for reader, _ in stalled[:4]:
            assert await _end(reader) == b""
        async with client(server.tls_port, pki.holder_of("viewer")) as made:
            assert await made.ask(1, FREQUENCY) == ANSWERED
            assert server.stats.tcp.connections == 1
            server.clock.moment += 5.1
            server.sweep()
            for reader, _ in stalled[4:]:
                assert await _end(reader) == b""
            assert server.ends == {"pushed_out": 5, "stalled": 3, "done": 1}
            server.clock.moment += 1.0
            assert await made.ask(1, FREQUENCY)
        for _, writer in stalled:
            writer.transport.abort()


async def _end(reader: asyncio.StreamReader) -> bytes:
    try:
        return await reader.read()
    except ConnectionError:
        return b""


async def test_a_client_that_leaves_in_the_middle_is_forgotten(pki: Pki) -> None:
    """And counted."""
    async with asyncio.timeout(LIMIT), serving(pki) as server:
        _, writer = await asyncio.open_connection("127.0.0.1", server.tls_port)
        writer.write(b"\x16\x03\x01")
        writer.close()
        await until(lambda: server.ends == {"left": 1})


@pytest.mark.hazard("H25")
async def test_the_limits_of_connections_hold_before_a_handshake_is_begun(pki: Pki) -> None:
    """No processor time for whom there is no place, or who may not come."""
    async with asyncio.timeout(LIMIT), serving(pki, connections=1) as server:
        context = pki.holder_of("viewer")
        async with client(server.tls_port, context) as made:
            assert await made.ask(1, FREQUENCY) == ANSWERED
            await refused(server.tls_port, context)
            assert (server.stats.tcp.turned_away, server.ends) == (1, {"done": 1})
    async with asyncio.timeout(LIMIT), serving(pki, allow=["10.0.0.0/8"]) as server:
        await refused(server.tls_port, context)
        assert await raw(server.plain_port, read(1, 1, 0xFD00, 1)) == b""
        assert (server.stats.tcp.not_allowed, server.ends) == (2, {})


async def test_a_session_is_resumed_with_its_role(pki: Pki) -> None:
    """The certificate comes out of the session; by TLS 1.2, whose client can ask for it here."""
    context = pki.holder_of("viewer")
    context.maximum_version = ssl.TLSVersion.TLSv1_2
    async with asyncio.timeout(LIMIT), serving(pki) as server:
        session = await asyncio.to_thread(_ask_by_socket, server.tls_port, context, None)
        again = await asyncio.to_thread(_ask_by_socket, server.tls_port, context, session[1])
        assert (session[0], again[0]) == (False, True)
        assert session[2] == again[2] == ANSWERED
        server.clock.shift = 3 * 86_400.0  # the certificate has ended, and a resumed session is not verified again
        late = await asyncio.to_thread(_ask_by_socket, server.tls_port, context, session[1])
        assert late[2] == DENIED
        assert server.ends == {"done": 2, "no_role": 1}


def _ask_by_socket(port: int, context: ssl.SSLContext, session: ssl.SSLSession | None) -> tuple[bool, Any, bytes]:
    """Ask once; return whether the session was resumed, the session, and the PDU of the answer."""
    with (
        socket.create_connection(("127.0.0.1", port), timeout=LIMIT) as plain,
        context.wrap_socket(plain, server_hostname="127.0.0.1", session=session) as sock,
    ):
        sock.sendall(read(1, 1, 0xFD00, 1))
        told = sock.recv(300)
        return bool(sock.session_reused), sock.session, told[7:]


async def test_a_renegotiation_is_refused(pki: Pki) -> None:
    """OpenSSL's own client asks for one by R; nothing is served beyond it."""
    certificate = pki.client("renegotiator", role("viewer"))
    async with asyncio.timeout(LIMIT), serving(pki) as server:
        process = await asyncio.create_subprocess_exec(
            *("openssl", "s_client", "-connect", f"127.0.0.1:{server.tls_port}", "-tls1_2"),
            *("-cert", str(certificate), "-key", str(pki.key.path), "-CAfile", str(pki.authority.path)),
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
        )
        assert process.stdin is not None
        process.stdin.write(b"R\n")
        told, _ = await process.communicate()
        assert b"Verify return code: 0 (ok)" in told
        assert b"no renegotiation" in told
        assert server.ends == {"done": 1}
        await until(lambda: server.stats.tcp.connections == 0)


async def test_garbage_behind_the_handshake_cuts_the_connection(pki: Pki) -> None:
    """A record that was changed on the way."""
    async with (
        asyncio.timeout(LIMIT),
        serving(pki) as server,
        by_hand(server.tls_port, pki.holder_of("viewer")) as made,
    ):
        made.tls.write(read(1, 1, 0xFD00, 1))
        record = bytearray(made.outgoing.read())
        record[-1] ^= 1
        made.writer.write(bytes(record))
        await made.take_the_rest()
        with pytest.raises(ssl.SSLError):
            made.tls.read(100)
        assert server.stats.tcp.requests == {}
        await until(lambda: server.stats.tcp.connections == 0)


class SecuredClient(ModbusTcpClient):
    """Pymodbus by TLS, as docs/modbus-tcp.md shows it: its own client for TLS leaves the header out."""

    def __init__(self, context: ssl.SSLContext, port: int) -> None:
        super().__init__("127.0.0.1", port=port)
        self._tls = context

    def connect(self) -> bool:
        """Connect, and do the handshake."""
        if self.socket is None and super().connect():  # type: ignore[no-untyped-call]
            assert self.socket is not None
            self.socket = self._tls.wrap_socket(self.socket, server_hostname="127.0.0.1")
        return self.socket is not None


def test_pymodbus_by_tls(pki: Pki, run: Callable[[Scenario], None]) -> None:
    """A foreign client reads, is refused, and identifies the gateway."""
    certificate = pki.client("pymodbus", role("viewer"))

    def ask(port: int) -> tuple[list[int], int, bytes]:
        with SecuredClient(pki.context(certificate), port) as made:
            words = made.read_holding_registers(0xFD00, count=4, device_id=1).registers
            code = made.write_register(0xFA00, 0, device_id=1).exception_code
            return words, code, made.read_device_information(device_id=255).information[0]

    async def scenario() -> None:
        async with serving(pki) as server:
            told = await asyncio.to_thread(ask, server.tls_port)
            assert told == ([6000, 3, 5000, 0x1234], 1, b"tosvert-gateway")

    run(scenario)


RIGHTS = [
    {"role": "viewer", "units": [1], "functions": ["read"]},
    {"role": "part", "units": [1], "registers": [[0xFD00, 0xFD01]]},
    {"role": "operator", "functions": ["read", "write"], "units": [1], "registers": [0xFA00, 0xFA01, 0xFD00]},
    {"role": "fitter", "functions": ["read", "write"], "units": [1], "registers": [0xFA01]},
    {"role": "line-*", "functions": ["read", "write"], "units": [255], "registers": [[0x8000, 0x800F]]},
]
STOP, RUN = 0x8000, 0xC400


@pytest.mark.hazard("H28")
@pytest.mark.parametrize(
    ("who", "unit", "pdu", "told"),
    [
        ("viewer", 1, FREQUENCY, b"\x83\x0b"),  # permitted: nothing was read in this image
        ("viewer", 2, FREQUENCY, DENIED),
        ("viewer", 255, bytes.fromhex("0300000001"), DENIED),
        ("viewer", 1, several(0xFA01, 3000), b"\x90\x01"),
        ("viewer", 1, several(0xFA00, STOP), b"\x90\x01"),
        ("viewer", 1, exchange(0xFD00, 1, 0xFA01, 3000), b"\x97\x01"),
        ("part", 1, bytes.fromhex("03fd000002"), b"\x83\x0b"),
        ("part", 1, bytes.fromhex("03fd000003"), DENIED),
        ("part", 1, bytes.fromhex("03fcff0002"), DENIED),
        ("operator", 1, several(0xFA00, RUN, 3000), None),
        ("operator", 1, several(0xFA00, RUN, 3000, 0), b"\x90\x01"),
        ("operator", 2, several(0xFA00, STOP), b"\x90\x01"),
        ("operator", 1, exchange(0xFD00, 1, 0xFA01, 3000), None),
        ("operator", 1, exchange(0xFD01, 1, 0xFA01, 3000), b"\x97\x01"),
        ("fitter", 1, several(0xFA01, 3000), None),
        ("fitter", 1, several(0xFA00, RUN), b"\x90\x01"),
        ("fitter", 1, several(0xFA00, STOP), None),
        ("fitter", 1, several(0xFA00, STOP, 3000), None),
        ("line-3", 255, several(0x8000, 4), None),
        ("line-3", 255, several(0x8010, 4), b"\x90\x01"),
        ("line-3", 255, several(0xE000, 4), b"\x90\x01"),
        ("line-3", 1, several(0xFA00, STOP), b"\x90\x01"),
        ("stranger", 1, FREQUENCY, DENIED),
    ],
)
async def test_a_role_may_what_its_rights_say(pki: Pki, who: str, unit: int, pdu: bytes, told: bytes | None) -> None:
    """None is for what reaches the door."""
    made = Listening({}, {})
    async with (
        asyncio.timeout(LIMIT),
        serving(pki, image=made.image, door=made.door, right=RIGHTS) as server,
        client(server.tls_port, pki.holder_of(who)) as one,
    ):
        if told is not None:
            assert await one.ask(unit, pdu) == told
            assert made.door.asked == []
        else:
            asking = asyncio.create_task(one.ask(unit, pdu))
            await until(lambda: bool(made.door.asked))
            command = await made.end()
            assert str(command.source) == f"modbus-tcp {who}@127.0.0.1"
            assert (await asking)[:2] in (pdu[:2], bytes((pdu[0] | 0x80, 0x0B)))  # the latter: done, and not read


@pytest.mark.hazard("H32")
async def test_beside_tls_a_client_without_it_may_read_only(pki: Pki) -> None:
    """As long as no right says otherwise; a stop is a write too."""
    made = Listening()
    async with (
        asyncio.timeout(LIMIT),
        serving(pki, image=made.image, door=made.door) as server,
        client(server.plain_port) as one,
    ):
        assert await one.ask(1, FREQUENCY) == b"\x83\x0b"
        assert await one.ask(1, several(0xFA00, STOP)) == b"\x90\x01"
        assert await one.ask(255, several(0x8000, 4)) == b"\x90\x01"
        assert made.door.asked == []


@pytest.mark.hazard("H32")
async def test_nobody_writes_by_tls_when_the_gateways_certificate_has_expired(pki: Pki) -> None:
    """Who is connected then is cut, and may only read when it comes again."""
    made = Listening()
    context = pki.context(pki.client("long", role("operator"), ends=1000.0))
    async with asyncio.timeout(LIMIT), serving(pki, image=made.image, door=made.door, right=RIGHTS) as server:
        async with client(server.tls_port, context) as one:
            asking = asyncio.create_task(one.ask(1, several(0xFA00, RUN)))
            await until(lambda: bool(made.door.asked))
            await made.end()
            await asking
            server.clock.shift = 91 * 86_400.0
            server.sweep()
            assert await one.is_closed()
        async with client(server.tls_port, context) as one:
            assert await one.ask(1, FREQUENCY) == b"\x83\x0b"
            assert await one.ask(1, several(0xFA00, STOP)) == b"\x90\x01"


@pytest.mark.hazard("H32")
async def test_a_connection_ends_with_the_certificate_of_its_client(
    pki: Pki, caplog: pytest.LogCaptureFixture
) -> None:
    """However long it has stood, and whatever is asked by it."""
    caplog.set_level(logging.INFO)
    async with asyncio.timeout(LIMIT), serving(pki) as server, client(server.tls_port, pki.holder_of("a")) as one:
        server.clock.shift = 1.9 * 86_400.0
        server.sweep()
        assert await one.ask(1, FREQUENCY) == ANSWERED
        server.clock.shift = 2.1 * 86_400.0
        server.sweep()
        assert await one.is_closed()
        assert "its certificate has expired" in caplog.text


async def test_listen_off_leaves_tls_alone(pki: Pki) -> None:
    """One port is open."""
    async with asyncio.timeout(LIMIT), serving(pki, listen="off") as server:
        assert server.port == server.tls_port
        async with client(server.tls_port, pki.holder_of("viewer")) as made:
            assert await made.ask(1, FREQUENCY) == ANSWERED


async def test_a_port_that_is_taken_is_named_by_its_key_and_nothing_stays_open(pki: Pki) -> None:
    """The plain port was open already."""
    with socket.create_server(("127.0.0.1", 0)) as taken:
        server = Secured(pki, tls={"listen": f"127.0.0.1:{taken.getsockname()[1]}"})
        with pytest.raises(GatewayError, match=r"modbus_tcp\.tls\.listen: cannot listen"):
            await server.start()
    with pytest.raises(RuntimeError):
        _ = server.plain_port


async def test_answers_that_are_owed_are_sent_to_a_client_that_has_said_goodbye(pki: Pki) -> None:
    """The write is under way when it ends its half of the stream."""
    door = Listening()
    async with (
        asyncio.timeout(LIMIT),
        serving(pki, image=door.image, door=door.door, right=RIGHTS) as server,
        by_hand(server.tls_port, pki.holder_of("operator")) as made,
    ):
        made.tls.write(request(9, 1, several(0xFA01, 3000)))
        with pytest.raises(ssl.SSLWantReadError):
            made.tls.unwrap()
        made.flush()
        await until(lambda: bool(door.door.asked))
        await door.end()
        await made.take_the_rest()
        assert made.tls.read(100)[:8] == bytes.fromhex("0009000000060110")
        await until(lambda: server.stats.tcp.connections == 0)


@pytest.mark.hazard("H26")
@pytest.mark.parametrize("size", [1, 7, 700])
async def test_records_in_pieces(pki: Pki, size: int) -> None:
    """However the stream is cut; a request in two records, and two in one."""
    async with (
        asyncio.timeout(LIMIT),
        serving(pki) as server,
        by_hand(server.tls_port, pki.holder_of("viewer")) as made,
    ):
        for part in (read(1, 1, 0xFD00, 1)[:5], read(1, 1, 0xFD00, 1)[5:] + read(2, 1, 0xFD00, 1)):
            made.tls.write(part)
            stream = made.outgoing.read()
            for at in range(0, len(stream), size):
                made.writer.write(stream[at : at + size])
                await made.writer.drain()
                await asyncio.sleep(0)
        told = await made.read(2 * 11)
        assert [told[:2], told[7:11], told[11:13], told[18:]] == [b"\0\1", ANSWERED, b"\0\2", ANSWERED]


@pytest.mark.hazard("H25")
async def test_what_waits_for_a_slow_client_is_bounded_and_comes_in_order(pki: Pki) -> None:
    """As without TLS: served on as it reads."""
    count = 3000
    async with asyncio.timeout(LIMIT), serving(pki) as server, client(server.tls_port, pki.holder_of("a")) as one:
        one.writer.write(b"".join(read(i, 255, 0, 64) for i in range(count)))
        told = await one.reader.readexactly(count * (9 + 128))
        numbers = [int.from_bytes(told[at : at + 2], "big") for at in range(0, len(told), 9 + 128)]
        assert numbers == list(range(count))


@pytest.mark.hazard("H25")
def test_every_way_in_on_both_loops(pki: Pki, run: Callable[[Scenario], None]) -> None:
    """By TLS more clients at once than are let on at once; without it and by RTU frames with rights by address."""
    context = pki.holder_of("viewer")
    rights = [{"addresses": ["127.0.0.0/8"], "units": [255]}, {"role": "viewer", "units": [1]}]
    count = 6

    async def one(port: int) -> bytes:
        async with client(port, context) as made:
            return await made.ask(1, FREQUENCY)

    async def scenario() -> None:
        async with serving(pki, right=rights, rtu={"listen": "127.0.0.1:0"}, connections=count) as server:
            server._listeners[1]._handshakes._left = 2.0  # type: ignore[attr-defined]
            server._listeners[1]._handshakes._left_at = server.clock.now()  # type: ignore[attr-defined]
            told = await asyncio.gather(*(one(server.tls_port) for _ in range(count)))
            assert told == [ANSWERED] * count
            assert server.ends == {"done": count}
            await until(lambda: server.stats.tcp.connections == 0)
            async with client(server.plain_port) as made:
                assert await made.ask(1, FREQUENCY) == DENIED
                assert (await made.ask(255, bytes.fromhex("0300000001")))[0] == 3
            async with client(server.rtu_port) as made:
                for unit, pdu in ((1, FREQUENCY), (255, FREQUENCY)):
                    made.writer.write(frame(unit, pdu))
                told = [await made.reader.readexactly(5) for _ in range(2)]
                assert told == [frame(1, DENIED), frame(255, b"\x83\x02")]

    run(scenario)


@pytest.mark.hazard("H25")
async def test_a_client_by_tls_that_never_reads_is_cut(pki: Pki) -> None:
    """What waits for it is bounded, as without TLS."""
    context = pki.holder_of("viewer")
    async with (
        asyncio.timeout(LIMIT),
        serving(pki) as server,
        by_hand(server.tls_port, context, is_small=True) as made,
        asyncio.TaskGroup() as group,
    ):
        made.writer.transport.pause_reading()  # type: ignore[attr-defined]
        burst = b"".join(read(i, 255, 0, 64) for i in range(1000))

        async def ask_for_ever() -> None:
            with contextlib.suppress(ConnectionError):
                while True:
                    made.tls.write(burst)
                    made.flush()
                    await made.writer.drain()

        asking = group.create_task(ask_for_ever())
        later = server.clock.now() + 5.0
        await until(lambda: any("not read" in (one.overdue(later, 60.0) or "") for one in server._places.taken))
        server.clock.moment += 5.0
        server.sweep()
        await until(lambda: server.stats.tcp.connections == 0)
        asking.cancel()
