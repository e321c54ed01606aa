"""A transport in front of another one, for connections whose bytes are changed on their way to the socket."""

from __future__ import annotations

import asyncio
from typing import Any


class WrappedTransport(asyncio.Transport):
    """Passes everything on as it is; what changes bytes overrides `write`."""

    def __init__(self, inner: asyncio.Transport) -> None:
        super().__init__()
        self._inner = inner

    def get_extra_info(self, name: str, default: Any = None) -> Any:
        """Return what is known of the socket."""
        return self._inner.get_extra_info(name, default)

    def set_write_buffer_limits(self, high: int | None = None, low: int | None = None) -> None:
        """Limit what may wait to be sent."""
        self._inner.set_write_buffer_limits(high=high, low=low)

    def pause_reading(self) -> None:
        """Read no more."""
        self._inner.pause_reading()

    def resume_reading(self) -> None:
        """Read again."""
        self._inner.resume_reading()

    def is_closing(self) -> bool:
        """Say whether it is closed."""
        return self._inner.is_closing()

    def close(self) -> None:
        """Close behind what is sent."""
        self._inner.close()

    def abort(self) -> None:
        """Close at once."""
        self._inner.abort()
