"""Finds the stop in a payload that is otherwise not exact: whatever is wrong with it, somebody wants a motor to stop.

Pure. Only a stop is ever found here: nothing else is carried out by a payload that is not exact.
"""

from __future__ import annotations

import json
import re
from decimal import Decimal
from typing import Any

from gateway.control.command import Verb

LOOKED_AT = 4096  # bytes from the beginning of a payload
ODD = "\0\ufeff\ufffd \t\r\n"  # NUL, byte order mark, what is no UTF-8, space
AROUND = ODD + "\"'`[]{}().,;:!"  # characters around a word that say nothing
KEY = "command"
IN_PIECES = re.compile(r"""\bcommand["']?\s{0,9}[:=]\s{0,9}["']?([A-Za-z][A-Za-z _-]{0,40})""", re.IGNORECASE)


def verb_of(word: object) -> Verb | None:
    """Return the command of that name, whatever its case: "Emergency-Stop" is one."""
    known = word.strip().lower().replace("-", "_").replace(" ", "_") if isinstance(word, str) else None
    return Verb(known) if known in set(Verb) else None


def stop_in(payload: bytes) -> dict[str, Any] | None:
    """Return the stop that a payload asks for, with its other keys as far as they can be told; None where it is none.

    A byte order mark, another encoding, NUL and stray characters around a word, a list around it, a key that stands
    there twice, JSON that breaks off: none of them hides a stop. Where something else is asked for too, it is none.
    """
    text = payload[:LOOKED_AT].decode(errors="replace").replace("\0", "").strip(ODD)
    if _is_stop(_word(text)):
        return {KEY: _word(text)}
    try:
        found = json.loads(text, parse_float=Decimal, parse_int=Decimal, object_pairs_hook=_table)
    except (ArithmeticError, ValueError, RecursionError):
        found = _table([(KEY, piece) for piece in IN_PIECES.findall(text)])
    table = _only(found)
    if not isinstance(table, dict):
        table = {KEY: _word(table)}
    return table if _is_stop(table.get(KEY)) else None


def _only(value: Any) -> Any:
    """Return what a list of one holds."""
    return value[0] if isinstance(value, list) and len(value) == 1 else value


def _word(value: Any) -> Any:
    """Return a text without what says nothing around it."""
    only = _only(value)
    return only.strip(AROUND) if isinstance(only, str) else only


def _is_stop(word: object) -> bool:
    verb = verb_of(word)
    return verb is not None and verb.is_stopping


def _table(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    """Return an object, whatever the case of its keys; of those that stand there twice the first one.

    Commands that contradict each other are none: a stop beside a run cannot be told.
    """
    table = {key.lower(): value for key, value in reversed(pairs)}
    commands = [_word(value) for key, value in pairs if key.lower() == KEY]
    table[KEY] = commands[0] if commands and all(map(_is_stop, commands)) else None
    return table
