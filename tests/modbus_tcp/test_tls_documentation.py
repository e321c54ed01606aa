"""docs/modbus-tcp.md: its certificates are made as it says, its examples are right, its client is answered."""

from __future__ import annotations

import asyncio
import os
import re
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

from gateway import site
from gateway.config import ModbusTcpSection
from gateway.metrics import LineStats, Stats
from gateway.modbus_tcp import handshakes
from gateway.modbus_tcp.listeners import TlsListener
from gateway.modbus_tcp.server import ModbusTcpServer
from tests.modbus_tcp.rig import fresh_image
from tests.modbus_tcp.secured import MovableClock

MANUAL = (Path(__file__).parents[2] / "docs" / "modbus-tcp.md").read_text(encoding="utf-8")
LIMIT = 30.0  # seconds for anything to happen
LINES = """
[gateway]
name = "g"
[[line]]
name = "a"
port = "/dev/ttyS1"
[[line.drive]]
name = "d1"
number = 1
model = "vf-nc3"
"""


def part(title: str) -> str:
    """Return one part of the page, by its heading."""
    found = re.search(rf"^(#+) {re.escape(title)}$(.*?)(?=^## )", MANUAL, re.DOTALL | re.MULTILINE)
    assert found is not None
    return found[2]


def blocks(title: str, language: str) -> list[str]:
    """Return what stands in code blocks of a part."""
    return re.findall(rf"^```{language}$(.*?)^```$", part(title), re.DOTALL | re.MULTILINE)


@pytest.mark.parametrize("title", ["Limits", "Rights", "TLS and roles", "MODBUS-RTU over TCP"])
def test_the_examples_are_right(title: str) -> None:
    """Each may be put into a configuration as it stands."""
    (example,) = blocks(title, "toml")
    assert site.build(tomllib.loads(LINES + example), "test", Path()).config.modbus_tcp is not None


def test_every_end_of_a_handshake_is_explained() -> None:
    """As `/metrics` counts them."""
    own = {handshakes.DONE, handshakes.NO_ROLE, handshakes.STALLED, handshakes.LEFT, handshakes.PUSHED_OUT}
    kinds = {kind for _, kind, _ in handshakes.KINDS}
    listed = re.findall(r"^\| (`[a-z_`, ]+) \|", part("What goes wrong"), re.MULTILINE)
    named = {name for cell in listed for name in re.findall(r"`([a-z_]+)`", cell)} - {"end"}
    assert named == kinds | own | {handshakes.OTHER}


@pytest.mark.e2e
async def test_certificates_made_as_it_says_are_let_in(tmp_path: Path) -> None:
    """By openssl's own client, and by the one of the page; the role is `operator`."""
    (recipe,) = (block for block in blocks("TLS and roles", "sh") if "openssl req" in block)
    await _run(f"set -e\n{recipe}", tmp_path)
    files = {"certificate": "gateway.pem", "key": "gateway.key", "ca": "ca.pem"}
    tls = {"listen": "127.0.0.1:0", **{key: str(tmp_path / name) for key, name in files.items()}}
    right = {"role": "operator", "units": [1], "registers": [0xFD00]}
    section = ModbusTcpSection.model_validate({"listen": "off", "tls": tls, "right": [right]})
    stats = Stats(0.0, {"a": LineStats()})
    server = ModbusTcpServer(section, fresh_image(), stats, MovableClock())
    async with asyncio.timeout(LIMIT):
        await server.start()
        try:
            port = f"{server.port_of(TlsListener)}"
            (by_openssl,) = (block for block in blocks("TLS and roles", "") if "s_client" in block)
            told = await _run(f"{by_openssl.strip()} -x509_strict".replace(":802", f":{port}"), tmp_path)
            assert "Verify return code: 0 (ok)" in told
            (program,) = (block for block in blocks("TLS and roles", "python") if "SecuredClient" in block)
            (tmp_path / "client.py").write_text(program.replace("port=802", f"port={port}"), encoding="utf-8")
            told = await _run("python client.py", tmp_path)
            assert "registers=[6000]" in told
        finally:
            await server.stop()
    assert stats.tcp.handshakes == {handshakes.DONE: 2}


async def _run(command: str, folder: Path) -> str:
    """Run a command of the page and return what it prints."""
    own = f"{Path(sys.executable).parent}:{os.environ['PATH']}"
    process = await asyncio.create_subprocess_exec(
        *("sh", "-c", command.strip()),
        cwd=folder,
        env={**os.environ, "PATH": own},
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
    )
    told, _ = await process.communicate()
    return told.decode()
