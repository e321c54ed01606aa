"""How late an answer may come for the sake of what lies between gateway and line: by the kind of port. Pure."""

from __future__ import annotations

from gateway.config import server_address

BOARD_MARGIN = 0.020  # seconds; a port on the board adds the kernel's time alone
SERIAL_MARGIN = 0.050  # seconds; a USB adapter without low-latency mode holds an answer back by up to 16 ms
SOCKET_MARGIN = 0.250  # seconds; a serial server adds its packing time and the network's
BOARD_PORTS = ("ttyAMA", "ttyS", "ttyO", "ttyPS", "ttymxc", "ttySC", "serial")  # how UARTs of boards are named


def usual_margin(port: str) -> float:
    """Return what a kind of port may add to a drive's answer time, in seconds."""
    if server_address(port) is not None:
        return SOCKET_MARGIN
    folder, _, name = port.rpartition("/")
    is_on_board = folder == "/dev" and name.rstrip("0123456789") in BOARD_PORTS
    return BOARD_MARGIN if is_on_board else SERIAL_MARGIN
