#!/usr/bin/env python3
"""Asks a running gateway for its health; exit code 0 when all data are fresh, 1 with the reasons when not."""

from __future__ import annotations

import http.client
import json
import os
import sys

ADDRESS = os.environ.get("TOSVERT_WEB", "127.0.0.1:8080")
LIMIT = 4.0  # seconds


def ask(address: str) -> tuple[int, str]:
    """Return the exit code and what the gateway says, in one line."""
    connection = http.client.HTTPConnection(address, timeout=LIMIT)
    try:
        connection.request("GET", "/healthz")
        response = connection.getresponse()
        document = json.loads(response.read())
        return (0, "ok") if response.status == 200 else (1, "; ".join(document["reasons"]))
    except (OSError, http.client.HTTPException, ValueError, KeyError, TypeError) as error:
        return 1, f"{address}: no answer that makes sense: {error!r}"
    finally:
        connection.close()


if __name__ == "__main__":
    code, text = ask(ADDRESS)
    sys.stdout.write(f"{text}\n")
    sys.exit(code)
