"""What the driver of a serial device is told beside baud rate and parity: low latency, RS485 mode, RTS; and verified.

Linux: serial_struct and serial_rs485 of linux/serial.h, tty_ioctl(4); drivers under /sys.
"""

from __future__ import annotations

import errno
import fcntl
import termios
from array import array
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

SYS = Path("/sys")

FLAGS = 4  # place of `flags` in serial_struct
SERIAL_STRUCT = 32  # ints, more than it has
ASYNC_LOW_LATENCY = 1 << 13

TIOCGRS485 = 0x542E
TIOCSRS485 = 0x542F
SERIAL_RS485 = 8  # ints: flags, delay before and after in ms, padding
RS485_ENABLED, RS485_ON_SEND, RS485_AFTER_SEND, RS485_RECEIVES_OWN = 1, 2, 4, 16
RS485_CHECKED = RS485_ENABLED | RS485_ON_SEND | RS485_AFTER_SEND

TIOCSERGETLSR = 0x5459
TRANSMITTER_EMPTY = 1  # TIOCSER_TEMT

LEAST_TIMER = 1  # ms; an FTDI chip hands received bytes on at the latest then
UNBUFFERED = ("ch341-uart", "cp210x", "pl2303", "cdc_acm")  # drivers without the mode, whose chips hold nothing back

Ioctl = Callable[[int, int, "array[int]", bool], object]


@dataclass(frozen=True, slots=True)
class Latency:
    """Whether bytes are handed on at once, None where nothing could hold them back; `remedy` says what to do."""

    is_low: bool | None
    said: str
    remedy: str = ""


def set_low_latency(fd: int, port: str, ioctl: Ioctl = fcntl.ioctl, sys: Path = SYS) -> Latency:
    """Set the driver's low-latency mode and read it back; say what came of it."""
    tty = Path(port).resolve().name
    driver = driver_of(port, sys)
    refusal = _set_flag(fd, ioctl)
    timer = sys / "bus" / "usb-serial" / "devices" / tty / "latency_timer"
    if (waits := _milliseconds(timer)) is not None:
        said = f"driver {driver} hands answers on within {waits} ms (latency_timer)"
        return Latency(waits <= LEAST_TIMER, said, "" if waits <= LEAST_TIMER else _timer_remedy(timer))
    if not refusal:
        return Latency(True, f"driver {driver} is in low-latency mode")
    if driver in UNBUFFERED:
        return Latency(None, f"driver {driver} has no low-latency mode and needs none")
    said = f"driver {driver} has no low-latency mode ({refusal}), it may hold answers back"
    return Latency(False, said, "see tosvert_drive_answer_quantile_seconds; raise answer_margin where it is large")


def _timer_remedy(timer: Path) -> str:
    return (
        "install deploy/99-tosvert.rules into /etc/udev/rules.d, then `udevadm control --reload` and plug the adapter"
        f" in anew; for now: echo {LEAST_TIMER} | sudo tee {timer}"
    )


def _set_flag(fd: int, ioctl: Ioctl) -> str:
    """Set ASYNC_LOW_LATENCY; return why it is not set, "" where it reads back."""
    settings = array("i", [0] * SERIAL_STRUCT)
    try:
        ioctl(fd, termios.TIOCGSERIAL, settings, True)
        settings[FLAGS] |= ASYNC_LOW_LATENCY
        ioctl(fd, termios.TIOCSSERIAL, settings, True)
        ioctl(fd, termios.TIOCGSERIAL, settings, True)
    except OSError as error:
        return error.strerror or str(error)
    return "" if settings[FLAGS] & ASYNC_LOW_LATENCY else "it is not set when read back"


def _milliseconds(timer: Path) -> int | None:
    try:
        return int(timer.read_text())
    except (OSError, ValueError):
        return None  # no FTDI adapter


def driver_of(port: str, sys: Path = SYS) -> str:
    """Return the name of a device's kernel driver, "unknown" where the system does not tell."""
    link = sys / "class" / "tty" / Path(port).resolve().name / "device" / "driver"
    try:
        return link.resolve(strict=True).name
    except OSError:
        return "unknown"


# ---- RS485


@dataclass(frozen=True, slots=True)
class Rts:
    """How RTS switches between sending and receiving; delays in seconds."""

    on_send: bool = True
    delay_before: float = 0.0
    delay_after: float = 0.0


class NotSwitched(Exception):
    """The driver did not take a setting: the message says which, and what to do."""


def set_kernel_mode(fd: int, port: str, rts: Rts, *, hears_itself: bool, ioctl: Ioctl = fcntl.ioctl) -> None:
    """Let the kernel's driver switch the line, and read it back; NotSwitched where it does not."""
    wanted = array("I", [0] * SERIAL_RS485)
    wanted[0] = RS485_ENABLED | (RS485_ON_SEND if rts.on_send else RS485_AFTER_SEND)
    wanted[0] |= RS485_RECEIVES_OWN if hears_itself else 0
    wanted[1:3] = array("I", [round(rts.delay_before * 1000), round(rts.delay_after * 1000)])
    has = array("I", wanted)
    try:
        ioctl(fd, TIOCSRS485, has, True)
        ioctl(fd, TIOCGRS485, has, True)
    except OSError as error:
        raise NotSwitched(
            f"driver {driver_of(port)} has no RS485 mode ({error.strerror}):"
            ' rs485 = "auto" where the adapter switches by itself, "rts" where RTS does'
        ) from error
    if (has[0] & RS485_CHECKED, *has[1:3]) != (wanted[0] & RS485_CHECKED, *wanted[1:3]):
        raise NotSwitched(f"driver {driver_of(port)} did not take rs485: {_differences(wanted, has)}")


def _differences(wanted: array[int], has: array[int]) -> str:
    if not has[0] & RS485_ENABLED:
        return "the mode is still off"
    names = ("rts_on_send", "rts_delay_before", "rts_delay_after")
    asked = (wanted[0] & RS485_ON_SEND == RS485_ON_SEND, f"{wanted[1]} ms", f"{wanted[2]} ms")
    given = (has[0] & RS485_ON_SEND == RS485_ON_SEND, f"{has[1]} ms", f"{has[2]} ms")
    each = zip(names, asked, given, strict=True)
    said = [f"{name} is {got} and not {wish}" for name, wish, got in each if wish != got]
    return f"{'; '.join(said) or 'RTS does not change'}: set what the driver can do"


def is_kernel_mode(fd: int, ioctl: Ioctl = fcntl.ioctl) -> bool:
    """Say whether the kernel's driver switches the line; a device tree may have said so."""
    has = array("I", [0] * SERIAL_RS485)
    try:
        ioctl(fd, TIOCGRS485, has, True)
    except OSError:
        return False
    return bool(has[0] & RS485_ENABLED)


def end_kernel_mode(fd: int, port: str, ioctl: Ioctl = fcntl.ioctl) -> None:
    """Let the kernel's driver leave the line alone; NotSwitched where it does not."""
    if not is_kernel_mode(fd, ioctl):
        return
    try:
        ioctl(fd, TIOCSRS485, array("I", [0] * SERIAL_RS485), True)
    except OSError as error:
        raise NotSwitched(f"driver {driver_of(port)} does not end its RS485 mode: {error.strerror}") from error
    if is_kernel_mode(fd, ioctl):
        raise NotSwitched(f'driver {driver_of(port)} does not end its RS485 mode: rs485 = "kernel" is what it can do')


class RtsSwitch:
    """Switches a transceiver by RTS, from the gateway: to send before a frame, to receive when it has left."""

    def __init__(self, fd: int, rts: Rts, ioctl: Ioctl = fcntl.ioctl) -> None:
        self.rts = rts
        self._fd = fd
        self._ioctl = ioctl

    def send(self) -> None:
        """Switch to sending; OSError where the device is gone or has no RTS."""
        self._set(is_asserted=self.rts.on_send)

    def receive(self) -> None:
        """Switch to receiving; OSError as above."""
        self._set(is_asserted=not self.rts.on_send)

    def _set(self, *, is_asserted: bool) -> None:
        operation = termios.TIOCMBIS if is_asserted else termios.TIOCMBIC
        self._ioctl(self._fd, operation, array("i", [termios.TIOCM_RTS]), True)

    def check(self, port: str) -> None:
        """Switch to receiving and read RTS back; NotSwitched where it is not there."""
        state = array("i", [0])
        try:
            self.receive()
            self._ioctl(self._fd, termios.TIOCMGET, state, True)
        except OSError as error:
            raise NotSwitched(
                f"driver {driver_of(port)} does not set RTS ({error.strerror}):"
                ' rs485 = "auto" where the adapter switches by itself, "kernel" where the driver does'
            ) from error
        if bool(state[0] & termios.TIOCM_RTS) is self.rts.on_send:
            raise NotSwitched(f"driver {driver_of(port)} did not take the level of RTS: it reads back otherwise")

    def has_sent(self) -> bool:
        """Say whether the last bit has left; True where the driver does not tell."""
        for operation in (TIOCSERGETLSR, termios.TIOCOUTQ):
            state = array("i", [0])
            try:
                self._ioctl(self._fd, operation, state, True)
            except OSError as error:
                if error.errno in (errno.ENOTTY, errno.EINVAL):
                    continue
                raise
            return bool(state[0] & TRANSMITTER_EMPTY) if operation == TIOCSERGETLSR else not state[0]
        return True


def keep_levels_after_close(fd: int) -> None:
    """Leave RTS and DTR as they are when the port is closed: without RTS an inverted line would be sending."""
    settings = termios.tcgetattr(fd)
    settings[2] &= ~termios.HUPCL
    termios.tcsetattr(fd, termios.TCSANOW, settings)

