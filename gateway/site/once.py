"""Finds what has to be there once only, and is there twice. Pure."""

from __future__ import annotations

from collections.abc import Iterator

Once = dict[tuple[str, object], str]  # what it is and its value: the key where it stood first


def only_once(seen: Once, what: str, value: object, key: str, hint: str = "") -> Iterator[str]:
    """Yield a line where the value is taken, with the key that has it; else note that it is taken by this one."""
    if not isinstance(value, str | int):
        return
    if (what, value) in seen:
        yield f"{key}: {what} {value!r} is taken by {seen[what, value]}{hint}"
    else:
        seen[what, value] = key
