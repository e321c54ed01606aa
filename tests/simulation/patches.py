"""What of the gateway and its libraries goes by the machine, not by what it is given: time, network, threads."""

from __future__ import annotations

import contextlib
import logging
import os
import socket
import threading
from collections.abc import Iterator
from types import SimpleNamespace
from unittest import mock

import paho.mqtt.client

import gateway.app
from gateway.modbus_tcp import sockets
from tests.simulation.links import Network
from tests.simulation.world import World


class AtOnce(threading.Thread):
    """A thread that has done its work when it was started: nothing runs beside the loop."""

    def start(self) -> None:
        """Do the work."""
        self.run()


@contextlib.contextmanager
def applied(world: World, network: Network) -> Iterator[None]:
    """Let the gateway live in a world, in this thread; its log is not kept."""
    collector = SimpleNamespace(collect=lambda: 0, freeze=lambda: None)  # the process is not the gateway's alone
    write = os.write

    def noting(descriptor: int, data: bytes) -> int:
        world.looks_at_write = world.looks
        return write(descriptor, data)

    with (
        mock.patch.object(paho.mqtt.client, "time_func", lambda: world.now),  # noqa: PT008 - the time goes on
        mock.patch.object(socket, "create_connection", network.create_connection),
        mock.patch.object(threading, "Thread", AtOnce),
        mock.patch.object(gateway.app, "gc", collector),
        mock.patch.object(os, "write", noting),
        mock.patch.object(sockets, "HAS_EPOLL", False),  # clients come by the loop of the world
    ):
        before = logging.root.manager.disable
        logging.disable(logging.CRITICAL)
        try:
            yield
        finally:
            logging.disable(before)
