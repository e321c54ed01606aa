"""Connects without holding up the event loop, and lets go of a connection that nobody waits for any longer."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Callable

from gateway.mqtt.made import Made, close


async def in_thread(connect: Callable[[], Made]) -> Made:
    """Connect in a thread of its own: the end of the daemon need not wait for it, as it would for an executor's."""
    loop = asyncio.get_running_loop()
    made: asyncio.Future[Made] = loop.create_future()

    def deliver(result: Made | None, error: BaseException | None) -> None:
        if made.cancelled():
            if result is not None:
                close(result.client)
        elif result is not None:
            made.set_result(result)
        elif error is not None:
            made.set_exception(error)

    def work() -> None:
        result, error = None, None
        try:
            result = connect()
        except BaseException as raised:  # whatever it is, it belongs to the one who waits
            error = raised
        try:
            loop.call_soon_threadsafe(deliver, result, error)
        except RuntimeError:  # the loop is closed: nobody waits any longer
            if result is not None:
                close(result.client)

    threading.Thread(target=work, name="mqtt-connect", daemon=True).start()
    try:
        return await made
    except asyncio.CancelledError:
        if made.done() and not made.cancelled() and made.exception() is None:
            close(made.result().client)  # it was there already when the bridge was told to end
        raise
