"""What is installed fits what the program does: exit codes, paths, ports, and how much the service may."""

from __future__ import annotations

import re
import shutil
import subprocess
from pathlib import Path

import pytest
import yaml

from gateway import cli, site
from gateway.config import ModbusTcpSection, WebSection, address
from gateway.trace import place

ROOT = Path(__file__).parents[1]
UNIT = (ROOT / "deploy" / "tosvert-gateway.service").read_text(encoding="utf-8")
RULES = (ROOT / "deploy" / "99-tosvert.rules").read_text(encoding="utf-8")
DOCKERFILE = (ROOT / "Dockerfile").read_text(encoding="utf-8")
INSTALLATION = (ROOT / "deploy" / "README.md").read_text(encoding="utf-8")

needs_analyzer = pytest.mark.skipif(not shutil.which("systemd-analyze"), reason="systemd is not installed")


def settings(key: str) -> list[str]:
    """Return every value of a key in the unit."""
    return re.findall(rf"^{key}=(.*)$", UNIT, re.MULTILINE)


def test_only_a_wrong_configuration_keeps_the_service_from_restarting() -> None:
    """The exit codes are those of the command line."""
    assert settings("Restart") == ["always"]
    assert settings("RestartPreventExitStatus") == [str(cli.EXIT_CONFIG)]
    assert settings("StartLimitIntervalSec") == ["0"]


@pytest.mark.hazard("H33")
def test_the_service_has_its_own_user_and_one_class_of_devices() -> None:
    """No root, no other device, nothing writable but its own folder."""
    assert settings("User") == ["tosvert-gateway"]
    assert settings("DevicePolicy") == ["closed"]
    assert settings("DeviceAllow") == ["char-ttyUSB rw"]
    assert settings("CapabilityBoundingSet") == ["CAP_NET_BIND_SERVICE"]
    for key in ("NoNewPrivileges", "ProtectHome", "MemoryDenyWriteExecute", "RestrictNamespaces"):
        assert settings(key) == ["yes"], key
    assert settings("ProtectSystem") == ["strict"]
    assert settings("StateDirectory") == ["tosvert-gateway"]
    assert settings("RuntimeDirectory") == [place.SERVICE.name]
    assert settings("SystemCallFilter") == ["@system-service", "~@privileged @resources"]


@pytest.mark.hazard("H18")
def test_the_service_manager_waits_for_ready_and_watches() -> None:
    """The daemon speaks sd_notify, and is killed when its loop stands still."""
    assert settings("Type") == ["notify"]
    assert settings("WatchdogSec") == ["15"]


@pytest.mark.e2e
@needs_analyzer
def test_systemd_finds_no_mistake_in_the_unit(tmp_path: Path) -> None:
    """Every key and value is known; the program and its user stand in for those of an installation."""
    unit = re.sub(r"^ExecStart=\S+", "ExecStart=/bin/true", UNIT, flags=re.MULTILINE)
    unit = re.sub(r"^(User|Group)=.*$", r"\1=daemon", unit, flags=re.MULTILINE)
    path = tmp_path / "tosvert-gateway.service"
    path.write_text(unit)
    done = subprocess.run(
        ["systemd-analyze", "verify", "--man=no", path], capture_output=True, text=True, timeout=60, check=False
    )
    about_it = [line for line in done.stderr.splitlines() if "tosvert-gateway" in line]
    assert (done.returncode, about_it) == (0, [])


@pytest.mark.e2e
@needs_analyzer
@pytest.mark.hazard("H33")
def test_the_service_is_rated_as_well_confined() -> None:
    """2.5 or better of 10 (0 is best): what is left open is the network and one class of devices."""
    path = ROOT / "deploy" / "tosvert-gateway.service"
    done = subprocess.run(
        ["systemd-analyze", "security", "--offline=true", "--threshold=25", path],
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )
    assert done.returncode == 0, done.stdout


def test_the_udev_rule_sets_the_latency_of_ftdi_adapters() -> None:
    """One millisecond, access for the group of the service, and a name that stays."""
    assert 'DRIVER=="ftdi_sio", ATTR{latency_timer}="1"' in RULES
    assert 'GROUP="dialout"' in RULES
    assert 'SYMLINK+="tosvert/' in RULES
    assert settings("SupplementaryGroups") == ["dialout"]


def test_the_image_exposes_the_default_ports_and_does_not_run_as_root() -> None:
    """Both stages begin alike, the last one ends with an unprivileged user and a health check."""
    ports = [address(section.listen)[1] for section in (ModbusTcpSection(), WebSection())]
    assert f"EXPOSE {ports[0]} {ports[1]}\n" in DOCKERFILE
    _, first, last = DOCKERFILE.split("\nFROM ")
    assert first.splitlines()[0] == "python:3.11-slim AS build"
    assert last.splitlines()[0] == "python:3.11-slim"
    assert "\nUSER tosvert-gateway\n" in last
    assert "healthcheck.py" in last.partition("\nHEALTHCHECK")[2]
    assert "--require-hashes" in first


def test_every_file_that_is_copied_exists() -> None:
    """Into the image, and by the steps of the installation; the image's own are not shut out of its context."""
    shut_in = set(re.findall(r"^!(\S+)$", (ROOT / ".dockerignore").read_text(encoding="utf-8"), re.MULTILINE))
    copies = re.findall(r"^COPY (?!--from)(.+) \S+$", DOCKERFILE, re.MULTILINE)
    copied = [name for names in copies for name in names.split()]
    assert set(copied) == shut_in
    named = re.findall(r"^cp (\S+)", INSTALLATION, re.MULTILINE) + re.findall(r"-r (\S+)", INSTALLATION)
    assert len(named) >= 4
    for name in copied + named:
        assert (ROOT / name).exists(), name


def test_the_lines_of_the_compose_file_do_not_get_into_each_others_way() -> None:
    """Each has a right file, a name, a port on the host and a store of its own; what it mounts is where it looks."""
    folder = ROOT / "deploy"
    services = yaml.safe_load((folder / "compose.lines.yaml").read_text(encoding="utf-8"))["services"]
    lines = {name: service for name, service in services.items() if name != "broker"}
    assert len(lines) > 1
    sites, stores, ports = [], set(), []
    for name, service in lines.items():
        config, store = (volume.split(":") for volume in service["volumes"])
        assert config[0] == f"./lines/{name}.toml"
        made = site.load(folder / config[0])
        assert config[1] in DOCKERFILE
        assert made.config.store.path is not None
        assert Path(made.config.store.path).parent == Path(store[1])
        assert [broker.url for broker in made.config.brokers] == ["mqtt://broker:1883"]
        assert {port.split(":")[1] for port in service["ports"]} == {"5020", "8080"}
        sites.append(made)
        stores.add(store[0])
        ports += [port.split(":")[0] for port in service["ports"]]
    names, wires = {made.config.gateway.name for made in sites}, {made.lines[0].port for made in sites}
    assert len(names) == len(wires) == len(stores) == len(lines)
    assert len(set(ports)) == len(ports)
