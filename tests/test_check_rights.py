"""What `check` says of MODBUS-TCP: the ways in, the limits, and who may do what."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from gateway import check_rights, site

TLS = {"listen": "0.0.0.0:802", "certificate": "/etc/a.pem", "key": "/etc/a.key", "ca": "/etc/ca.pem"}
OPERATOR = {
    "role": "operator",
    "addresses": ["10.0.0.0/8"],
    "units": [1, [3, 5]],
    "functions": ["read", 6],
    "registers": [[0xFA00, 0xFA01], 0xFD00],
}


def said(section: dict[str, Any] | None, control: str = "off") -> list[str]:
    """Return what is said of a configuration."""
    table: dict[str, Any] = {
        "gateway": {"name": "t"},
        "line": [
            {
                "name": "a",
                "port": "/dev/tty1",
                "drive": [{"name": "d1", "number": 1, "model": "vf-nc3", "control": control}],
            }
        ],
    }
    if section is not None:
        table["modbus_tcp"] = section
    return list(check_rights.report(site.build(table, "test", Path())))


def test_without_modbus_tcp_nothing_is_said() -> None:
    """There is no way in."""
    assert said(None) == []


@pytest.mark.hazard("H28")
def test_without_rights_it_is_said_what_control_permits() -> None:
    """Read only as long as no drive may be commanded."""
    assert said({}) == [
        "MODBUS-TCP on 127.0.0.1:5020",
        "  connections: 32",
        "  clients without TLS: may read every register, and write nothing: no drive may be commanded by MODBUS-TCP",
    ]
    assert "write what `control`, `sources` and `right` of the drives permit" in said({}, "leased")[-1]


@pytest.mark.hazard("H28")
def test_each_kind_of_client_is_told() -> None:
    """Roles, addresses, units, functions and registers; limits and whose places are kept."""
    section = {
        "listen": "0.0.0.0:502",
        "tls": TLS,
        "rtu": {"listen": "0.0.0.0:5021"},
        "per_address": 4,
        "allow": ["10.0.0.0/8", "::1"],
        "reserved": [{"addresses": ["10.0.0.7"], "places": 2}],
        "right": [OPERATOR, {"addresses": ["10.0.0.9"], "functions": ["read", "write"]}],
    }
    assert said(section, "leased") == [
        "MODBUS-TCP on 0.0.0.0:502",
        "MODBUS/TCP Security on 0.0.0.0:802: certificate /etc/a.pem, ca /etc/ca.pem",
        "MODBUS-RTU over TCP on 0.0.0.0:5021",
        "  connections: 32, 4 of one address, 2 kept for 10.0.0.7",
        "  only from 10.0.0.0/8, ::1",
        "  clients without TLS from 10.0.0.9: read, write; every unit; every register",
        "  all others without TLS: may do nothing",
        "    WARNING: they may write without TLS: whoever can send from such an address may",
        "  clients by TLS without a role: may do nothing",
        "  role operator from 10.0.0.0/8: read, 06H; units 1, 3 to 5; registers FA00H to FA01H, FD00H",
        "  all other roles: may do nothing",
    ]


@pytest.mark.hazard("H28")
def test_beside_tls_and_by_tls_alone_all_may_read() -> None:
    """As long as no right says otherwise."""
    assert said({"tls": TLS})[-3:] == [
        "  clients without TLS: may read every register, and write nothing",
        "  clients by TLS without a role: may do nothing",
        "  clients by TLS with any role: may read every register, and write nothing",
    ]
    assert not any("without TLS" in line for line in said({"listen": "off", "tls": TLS}))
