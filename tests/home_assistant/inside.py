"""Home Assistant's own core and MQTT integration, without its frontend: run by the Python of its environment.

usage: inside.py CONFIG_FOLDER BROKER_PORT

Each line on standard input is a JSON request, each line on standard output its answer:

    {"do": "look"}                     devices, entities with their states, and what Home Assistant complained of
    {"do": "judge", "component": {...}}  what its schema says of a component when no unknown key is passed over
    {"do": "call", "domain": "button", "service": "press", "with": {"entity_id": "button.x"}}
    {"do": "end"}                      write the registries, and end
"""

from __future__ import annotations

import asyncio
import importlib
import json
import logging
import socket
import sys
from pathlib import Path
from types import MappingProxyType
from typing import Any

from homeassistant import auth, bootstrap, config_entries, const, core, loader
from homeassistant.helpers import device_registry, entity_registry
from homeassistant.setup import async_setup_component
from homeassistant.util.yaml import load_yaml

ENTRY = "mqtt_entry_of_the_test"
NEWER = ("default_entity_id",)  # keys that versions after this one know; it passes over them


class Complaints(logging.Handler):
    """Keeps every warning and error, except what the environment and not the gateway is the reason of."""

    def __init__(self) -> None:
        super().__init__(logging.WARNING)
        self.texts: list[str] = []

    def emit(self, record: logging.LogRecord) -> None:
        """Keep one."""
        self.texts.append(f"{record.name}: {record.getMessage()}")


def free_port() -> int:
    """Return a loopback port for its web server, which nobody uses."""
    with socket.socket() as sock:
        sock.bind(("127.0.0.1", 0))
        return int(sock.getsockname()[1])


async def start(folder: Path, port: int) -> core.HomeAssistant:
    """Start the core, its registries as they are on disk, and the MQTT integration towards a broker."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / const.__dict__.get("CONFIG_FILE", "configuration.yaml")).touch()
    hass = core.HomeAssistant(str(folder))
    hass.config.skip_pip = True
    loader.async_setup(hass)
    hass.config_entries = config_entries.ConfigEntries(hass, {})
    await bootstrap.async_load_base_functionality(hass)
    hass.auth = await auth.auth_manager_from_config(hass, [], [])
    for name, config in (
        ("homeassistant", {}),
        ("http", {"http": {"server_host": ["127.0.0.1"], "server_port": free_port()}}),
    ):
        if not await async_setup_component(hass, name, config):
            raise SystemExit(f"{name} was not set up")
    automations = folder / "automations.yaml"
    if automations.exists():
        found = await asyncio.to_thread(load_yaml, str(automations))
        if not await async_setup_component(hass, "automation", {"automation": [found]}):
            raise SystemExit("automation was not set up")
    if hass.config_entries.async_get_entry(ENTRY) is None:
        await hass.config_entries.async_add(entry(port))
    elif not await async_setup_component(hass, "mqtt", {}):
        raise SystemExit("mqtt was not set up")
    await hass.async_start()
    return hass


def entry(port: int) -> config_entries.ConfigEntry:
    """Make what Home Assistant keeps when somebody has added the MQTT integration."""
    return config_entries.ConfigEntry(
        domain="mqtt",
        entry_id=ENTRY,
        version=1,
        minor_version=2,
        title="broker",
        source=config_entries.SOURCE_USER,
        unique_id=None,
        data={"broker": "127.0.0.1", "port": port, "protocol": "5"},
        options={"discovery": True},
        discovery_keys=MappingProxyType({}),
        subentries_data=None,
    )


def look(hass: core.HomeAssistant, complaints: Complaints) -> dict[str, Any]:
    """Say what there is."""
    devices = device_registry.async_get(hass)
    entities = entity_registry.async_get(hass)
    found = {}
    for each in entities.entities.values():
        state = hass.states.get(each.entity_id)
        found[each.entity_id] = {
            "unique_id": each.unique_id,
            "device": device.name if (device := devices.async_get(each.device_id or "")) else None,
            "category": each.entity_category,
            "disabled": each.disabled_by,
            "state": None if state is None else state.state,
            "attributes": {} if state is None else dict(state.attributes),
        }
    known = [
        {key: getattr(device, key) for key in ("name", "model", "manufacturer", "serial_number", "sw_version")}
        for device in devices.devices.values()
    ]
    texts, complaints.texts = complaints.texts, []
    for each in hass.config_entries.async_entries():
        if each.state is not config_entries.ConfigEntryState.LOADED:
            texts.append(f"{each.domain}: {each.state} {each.reason}")
    return {"version": const.__version__, "devices": known, "entities": found, "complaints": texts}


def judge(component: dict[str, Any]) -> dict[str, Any]:
    """Say what is wrong with a component, by the schema of its platform that refuses what it does not know."""
    options = {key: value for key, value in component.items() if key not in ("platform", *NEWER)}
    platform = importlib.import_module(f"homeassistant.components.mqtt.{component['platform']}")
    try:
        platform.PLATFORM_SCHEMA_MODERN(options)
    except Exception as error:
        return {"error": f"{type(error).__name__}: {error}"}
    return {}


async def answer(hass: core.HomeAssistant, request: dict[str, Any], complaints: Complaints) -> dict[str, Any]:
    """Do what is asked."""
    await hass.async_block_till_done()
    if request["do"] == "look":
        return look(hass, complaints)
    if request["do"] == "judge":
        return judge(request["component"])
    try:
        await hass.services.async_call(request["domain"], request["service"], request["with"], blocking=True)
    except Exception as error:
        return {"error": f"{type(error).__name__}: {error}"}
    return {}


async def main(folder: Path, port: int) -> None:
    """Run until told to end, or nobody asks any longer."""
    complaints = Complaints()
    logging.basicConfig(level=logging.WARNING, handlers=[complaints])
    hass = await start(folder, port)
    while line := await asyncio.to_thread(sys.stdin.readline):
        request = json.loads(line)
        if request["do"] == "end":
            break
        sys.stdout.write(json.dumps(await answer(hass, request, complaints), default=str) + "\n")
        sys.stdout.flush()
    await hass.async_stop(force=True)


if __name__ == "__main__":
    asyncio.run(main(Path(sys.argv[1]), int(sys.argv[2])))
