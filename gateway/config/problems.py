"""Says all that is wrong with the form of a configuration at once: key, name, and what would be right. Pure."""

from __future__ import annotations

import difflib
from collections.abc import Iterator, Mapping
from typing import Any

from pydantic import ValidationError

from gateway.config.file import ONE, SEVERAL, Config


def problems(table: Mapping[str, Any]) -> list[str]:
    """List all that is wrong with the form of a configuration, a line each: key and what would be right."""
    try:
        Config.model_validate(table)
    except ValidationError as error:
        return [_explain(item, table) for item in error.errors(include_url=False)]
    return []


def _explain(item: Mapping[str, Any], table: Mapping[str, Any]) -> str:
    keys = list(item["loc"])
    if keys[:1] == ["mqtt"] and keys[1:2] in ([ONE], [SEVERAL]):
        del keys[1]
    key = "".join(f"[{part}]" if isinstance(part, int) else f".{part}" for part in keys).lstrip(".")
    names = "".join(f" ({name})" for name in _names_on_the_way(keys, table))
    if item["type"] == "extra_forbidden":
        return f"{key}{names}: unknown key{_nearest(keys)}"
    if item["type"] == "missing":
        return f"{key}{names}: is missing"
    reason = item["msg"].removeprefix("Value error, ")
    return f"{key}{names}: {reason}{_given(keys, item['input'])}"


def _given(keys: list[Any], value: object) -> str:
    """Repeat a short value, but none that may hold a secret."""
    is_secret = "password" in keys or "user" in keys or "@" in str(value)
    return "" if is_secret or isinstance(value, dict | list) else f" (given: {value!r:.60})"


def _names_on_the_way(keys: list[Any], table: Any) -> Iterator[str]:
    """Yield the `name` of every list entry on the way to the key, so that [[line.drive]] 7 is found."""
    for key in keys:
        try:
            table = table[key]
        except (KeyError, IndexError, TypeError):
            return
        if isinstance(key, int) and isinstance(table, dict) and isinstance(table.get("name"), str):
            yield table["name"]


def _nearest(keys: list[Any]) -> str:
    known = _known_keys(keys[:-1])
    near = difflib.get_close_matches(str(keys[-1]), known, 1)
    return f"; did you mean {near[0]!r}?" if near else f"; known: {', '.join(known)}"


def _known_keys(keys: list[Any]) -> list[str]:
    schema: Any = Config.model_json_schema()
    definitions, node = schema["$defs"], schema

    def having(node: Any, part: str) -> Any:
        """Return what a node has as a part, it or what it stands for: one of several forms, or a definition."""
        if "$ref" in node:
            node = definitions[node["$ref"].rpartition("/")[2]]
        if part in node:
            return node[part]
        return next(filter(None, (having(form, part) for form in node.get("anyOf", node.get("oneOf", [])))), {})

    for key in keys:
        node = having(node, "items") if isinstance(key, int) else having(node, "properties").get(key, {})
    return sorted(having(node, "properties"))
