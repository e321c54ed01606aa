"""Writes docs/licences.md: what the project is built of, under which licences, and what for."""

from __future__ import annotations

import sys
import tomllib
from collections.abc import Iterable, Iterator
from importlib import metadata

from packaging.markers import Marker
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

from tools.locks import DEVELOPMENT, ROOT, RUNTIME, Pin, read

PAGE = ROOT / "docs" / "licences.md"

PURPOSES = {
    "aiohttp": "web server: /healthz, /metrics",
    "paho-mqtt": "MQTT client",
    "prometheus-client": "metrics in Prometheus' format",
    "pydantic": "configuration: validation and JSON Schema",
    "pymodbus": "MODBUS/TCP: messages and framing",
    "pyserial": "opening and setting up serial ports",
    "rich": "live view of the demonstration, tables",
    "typer": "command line",
    "uvloop": "event loop",
    "amqtt": "embedded broker of the demonstration",
    "hypothesis": "property tests",
    "import-linter": "import contract",
    "mypy": "type checks",
    "packaging": "checks of the lock files",
    "pytest": "tests",
    "pytest-asyncio": "tests of asynchronous code",
    "pytest-cov": "branch coverage",
    "pytest-xdist": "tests on all cores",
    "ruff": "lint",
    "minimalmodbus": "a peer in the benchmarks",
    "pymodbustcp": "a foreign MODBUS-TCP client in the tests, a peer in the benchmarks",
    "umodbus": "another foreign MODBUS-TCP client",
    "setuptools": "building the package",
}

# Where the metadata of a package names no SPDX expression, or a vague one: what its licence file says.
SPELLED = {
    "aiosignal": "Apache-2.0",
    "grimp": "BSD-2-Clause",
    "import-linter": "BSD-2-Clause",
    "pyserial": "BSD-3-Clause",
    "shellingham": "ISC",
    "sortedcontainers": "Apache-2.0",
    "umodbus": "MPL-2.0",
    "uvloop": "MIT OR Apache-2.0",
}
CLASSIFIERS = {
    "License :: OSI Approved :: Apache Software License": "Apache-2.0",
    "License :: OSI Approved :: MIT License": "MIT",
    "License :: OSI Approved :: Mozilla Public License 2.0 (MPL 2.0)": "MPL-2.0",
}

OPENING = """\
# Licences

tosvert-gateway is under the Apache License 2.0 (`LICENSE`). It uses the packages below, unmodified, as they are
installed from the package index; nothing of them is copied into this project. Versions are those of the lock files.
`make generate` writes this page.
"""

PROGRAMS = """
## Programs that the tests start

Installed by `make test` or `make bench`, from Debian but for those of `tools/foreign`; never distributed with the
project.

| program | licence | for |
|---|---|---|
| mosquitto, mosquitto-clients | EPL-2.0 OR BSD-3-Clause | a real broker and real clients |
| mbpoll | GPL-3.0-or-later | a real MODBUS master |
| gcc, libc6-dev | GPL-3.0-or-later WITH GCC-exception-3.1, LGPL-2.1-or-later | compiling what `make bench` runs |
| libmodbus | LGPL-2.1-or-later | a peer in `make bench` |
| tshark | GPL-2.0-or-later | a foreign dissector of MODBUS-RTU |
| nodejs, npm | MIT, Artistic-2.0 | running a foreign decoder |
| pysparkplug | Apache-2.0 | a foreign decoder of Sparkplug, apart (`tools/foreign`) |
| protobuf, paho-mqtt 1.6 | BSD-3-Clause, EPL-2.0 OR BSD-3-Clause | needed by pysparkplug |
| sparkplug-payload | EPL-2.0 | another one (`tools/foreign`) |
| protobufjs, long | BSD-3-Clause, Apache-2.0 | needed by sparkplug-payload |
"""

HEAD = """
## {title}

| package | version | licence | for |
|---|---|---|---|
"""


def licence(name: str) -> str:
    """Return the licence of an installed package as an SPDX expression."""
    if name in SPELLED:
        return SPELLED[name]
    about = metadata.metadata(name)

    def first(field: str) -> str:
        return next(iter(about.get_all(field) or []), "")

    classifiers = [CLASSIFIERS[text] for text in about.get_all("Classifier") or [] if text in CLASSIFIERS]
    text = first("License-Expression") or first("License") or " OR ".join(classifiers)
    if not text or " " in text.replace(" OR ", "").replace(" AND ", ""):
        raise SystemExit(f"tools.licences: what is the licence of {name}? ({text!r:.80}): add it to SPELLED")
    return text


def row(pin: Pin) -> str:
    """Return the line of one package."""
    installed = metadata.version(pin.name)
    if installed != pin.version:
        raise SystemExit(f"tools.licences: {pin.name} {installed} is installed, {pin.version} is locked")
    purpose = PURPOSES.get(pin.name) or "needed by " + ", ".join(via for via in pin.via if not via.startswith("-c"))
    return f"| {pin.name} | {pin.version} | {licence(pin.name)} | {purpose} |"


def reached(pins: Iterable[Pin], roots: Iterable[str]) -> set[str]:
    """Return the names of the roots and of all that they need, from what each pin says it is there for."""
    names: set[str] = {canonicalize_name(root) for root in roots}
    while more := {pin.name for pin in pins if names & set(pin.via)} - names:
        names |= more
    return names


def sections() -> Iterator[tuple[str, list[Pin]]]:
    """Yield each section of the page with its packages."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    locks = {lock: _here(lock) for lock in (RUNTIME, DEVELOPMENT)}
    roots = [Requirement(text).name for text in project["dependencies"]]
    runtime = reached(locks[RUNTIME], roots)
    yield "Of the gateway", [pin for pin in locks[RUNTIME] if pin.name in runtime]
    yield "Of the demonstration alone", [pin for pin in locks[RUNTIME] if pin.name not in runtime]
    known = {pin.name for pin in locks[RUNTIME]}
    yield "Of building, checking and measuring alone", [pin for pin in locks[DEVELOPMENT] if pin.name not in known]


def _here(lock: str) -> list[Pin]:
    """Return the pins that this platform installs."""
    pins, _ = read((ROOT / lock).read_text(encoding="utf-8"))
    return [pin for pin in pins if not pin.marker or Marker(pin.marker).evaluate()]


def page() -> str:
    """Return the whole page."""
    tables = (HEAD.format(title=title) + "".join(f"{row(pin)}\n" for pin in pins) for title, pins in sections())
    return OPENING + "".join(tables) + PROGRAMS


def main() -> int:
    """Write the page; with --check, only say whether it is current."""
    if "--check" not in sys.argv[1:]:
        PAGE.write_text(page(), encoding="utf-8")
        return 0
    if PAGE.read_text(encoding="utf-8") == page():
        return 0
    print("docs/licences.md is not current: run `make generate`", file=sys.stderr)
    return 1


if __name__ == "__main__":
    sys.exit(main())
