"""Finds what is wrong in fact with the lines: names and ports that are taken, groups of drives of elsewhere. Pure."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Mapping
from typing import Any

from gateway.config import server_address
from gateway.site.once import Once, only_once


def contradictions(table: Mapping[str, Any], once: Once) -> Iterator[str]:
    """Yield what is wrong, a line each."""
    lines = table.get("line")
    for i, line in enumerate(lines if isinstance(lines, list) else []):
        if isinstance(line, dict):
            yield from only_once(once, "line name", line.get("name"), f"line[{i}].name")
            yield from only_once(once, "line port", _one_port(line.get("port")), f"line[{i}].port")
            yield from _wrong_groups(line, f"line[{i}]", once)


def _one_port(port: object) -> object:
    """Return of a serial server its address, whatever is spoken there, and any other port as it is."""
    with contextlib.suppress(ValueError):
        if isinstance(port, str) and (server := server_address(port)) is not None:
            return f"{server[0].lower()}:{server[1]}"
    return port


def _wrong_groups(line: Mapping[str, Any], label: str, once: Once) -> Iterator[str]:
    """Find groups with one name, and members that are not on the line or named twice."""
    drives = line.get("drive")
    names = [drive.get("name") for drive in drives if isinstance(drive, dict)] if isinstance(drives, list) else []
    groups = line.get("group", [])
    for i, group in enumerate(groups if isinstance(groups, list) else []):
        if not isinstance(group, dict):
            continue
        key = f"{label}.group[{i}]"
        yield from only_once(once, "group name", group.get("name"), f"{key}.name")
        given = group.get("drives")
        members = [member for member in given if isinstance(member, str)] if isinstance(given, list) else []
        for member in dict.fromkeys(members):
            if member not in names:
                known = ", ".join(map(str, names))
                yield f"{key}.drives: no drive {member!r} on this line; known: {known}"
            if members.count(member) > 1:
                yield f"{key}.drives: {member!r} is named more than once"
