"""What a driver is told, against drivers that take it, refuse it, or say that they took it."""

from __future__ import annotations

import errno
import os
import pty
import termios
from array import array
from pathlib import Path

import pytest

from gateway.bus import adapter
from gateway.bus.adapter import NotSwitched, Rts, RtsSwitch

PORT = "/dev/ttyUSB7"


class Driver:
    """A kernel driver behind ioctl: what it has, and what it does not take."""

    def __init__(self, *, has_latency: bool = True, has_rs485: bool = True, has_rts: bool = True) -> None:
        self.has_latency, self.has_rs485, self.has_rts = has_latency, has_rs485, has_rts
        self.flags = 0
        self.forgets_latency = False
        self.rs485 = [0] * adapter.SERIAL_RS485
        self.longest_delay = 100
        self.levels = termios.TIOCM_DTR
        self.rts_is_fixed = False
        self.is_empty = True
        self.asked: list[int] = []

    def ioctl(self, fd: int, operation: int, buffer: array[int], mutate: bool) -> None:
        """Answer as the kernel does."""
        self.asked.append(operation)
        is_known = {
            termios.TIOCGSERIAL: self.has_latency,
            termios.TIOCSSERIAL: self.has_latency,
            adapter.TIOCGRS485: self.has_rs485,
            adapter.TIOCSRS485: self.has_rs485,
            adapter.TIOCSERGETLSR: self.has_rts,
            termios.TIOCOUTQ: True,
        }.get(operation, self.has_rts)
        if not is_known:
            raise OSError(errno.ENOTTY, os.strerror(errno.ENOTTY))
        if operation == termios.TIOCGSERIAL:
            buffer[adapter.FLAGS] = self.flags
        elif operation == termios.TIOCSSERIAL:
            self.flags = 0 if self.forgets_latency else buffer[adapter.FLAGS]
        elif operation == adapter.TIOCGRS485:
            buffer[:] = array("I", self.rs485)
        elif operation == adapter.TIOCSRS485:
            self.rs485 = list(buffer)
            self.rs485[1:3] = [min(delay, self.longest_delay) for delay in self.rs485[1:3]]
        elif operation == termios.TIOCMBIS and not self.rts_is_fixed:
            self.levels |= buffer[0]
        elif operation == termios.TIOCMBIC and not self.rts_is_fixed:
            self.levels &= ~buffer[0]
        elif operation == termios.TIOCMGET:
            buffer[0] = self.levels
        elif operation == adapter.TIOCSERGETLSR:
            buffer[0] = adapter.TRANSMITTER_EMPTY if self.is_empty else 0
        elif operation == termios.TIOCOUTQ:
            buffer[0] = 0 if self.is_empty else 8


def system(folder: Path, driver: str, timer: str | None = None) -> Path:
    """Lay out what /sys has of one adapter."""
    tty = folder / "class" / "tty" / "ttyUSB7" / "device"
    tty.mkdir(parents=True)
    (folder / "drivers" / driver).mkdir(parents=True)
    (tty / "driver").symlink_to(folder / "drivers" / driver)
    if timer is not None:
        place = folder / "bus" / "usb-serial" / "devices" / "ttyUSB7"
        place.mkdir(parents=True)
        (place / "latency_timer").write_text(timer)
    return folder


# ---- low latency


def test_low_latency_is_set_and_read_back(tmp_path: Path) -> None:
    """Other flags stay as they were."""
    driver = Driver()
    driver.flags = 1
    latency = adapter.set_low_latency(0, PORT, driver.ioctl, system(tmp_path, "pl011"))
    assert latency == adapter.Latency(True, "driver pl011 is in low-latency mode")
    assert driver.flags == 1 | adapter.ASYNC_LOW_LATENCY


def test_an_ftdi_chip_is_believed_by_its_timer_alone(tmp_path: Path) -> None:
    """The flag may be taken and the timer be as it was: then the remedy is told exactly."""
    driver = Driver()
    latency = adapter.set_low_latency(0, PORT, driver.ioctl, system(tmp_path, "ftdi_sio", "16\n"))
    assert latency.is_low is False
    assert latency.said == "driver ftdi_sio hands answers on within 16 ms (latency_timer)"
    timer = tmp_path / "bus/usb-serial/devices/ttyUSB7/latency_timer"
    assert "deploy/99-tosvert.rules" in latency.remedy
    assert latency.remedy.endswith(f"echo 1 | sudo tee {timer}")
    timer.write_text("1\n")
    assert adapter.set_low_latency(0, PORT, driver.ioctl, tmp_path).is_low is True


@pytest.mark.parametrize("name", adapter.UNBUFFERED)
def test_a_driver_that_holds_nothing_back_needs_no_mode(tmp_path: Path, name: str) -> None:
    """Nothing to warn of."""
    latency = adapter.set_low_latency(0, PORT, Driver(has_latency=False).ioctl, system(tmp_path, name))
    assert latency.is_low is None
    assert not latency.remedy


@pytest.mark.parametrize("forgets", [True, False])
def test_a_driver_that_does_not_take_it_is_named(tmp_path: Path, forgets: bool) -> None:
    """Refused, or said to be taken and not there: with the driver's name, and what to do."""
    driver = Driver(has_latency=forgets)
    driver.forgets_latency = forgets
    latency = adapter.set_low_latency(0, PORT, driver.ioctl, system(tmp_path, "strange"))
    assert latency.is_low is False
    assert "driver strange has no low-latency mode" in latency.said
    assert ("read back" if forgets else "Inappropriate ioctl") in latency.said
    assert "answer_margin" in latency.remedy


# ---- RS485 by the kernel


def test_the_kernels_mode_is_set_as_configured_and_read_back() -> None:
    """Flags and delays of linux/serial.h, in whole milliseconds."""
    driver = Driver()
    adapter.set_kernel_mode(0, PORT, Rts(True, 0.002, 0.001), hears_itself=False, ioctl=driver.ioctl)
    assert driver.rs485[:3] == [adapter.RS485_ENABLED | adapter.RS485_ON_SEND, 2, 1]
    adapter.set_kernel_mode(0, PORT, Rts(on_send=False), hears_itself=True, ioctl=driver.ioctl)
    assert driver.rs485[0] == adapter.RS485_ENABLED | adapter.RS485_AFTER_SEND | adapter.RS485_RECEIVES_OWN


def test_a_driver_without_the_mode_is_named_with_what_to_do() -> None:
    """The driver, the kernel's reason, and the other settings."""
    with pytest.raises(NotSwitched, match=r'driver unknown has no RS485 mode .*rs485 = "auto".*"rts"'):
        adapter.set_kernel_mode(0, "/dev/none", Rts(), hears_itself=False, ioctl=Driver(has_rs485=False).ioctl)


def test_a_driver_that_takes_the_mode_otherwise_is_not_believed() -> None:
    """A delay that is cut short would cut off the frame."""
    driver = Driver()
    driver.longest_delay = 1
    with pytest.raises(NotSwitched, match="rts_delay_before is 1 ms and not 5 ms: set what the driver can do"):
        adapter.set_kernel_mode(0, PORT, Rts(True, 0.005), hears_itself=False, ioctl=driver.ioctl)


def test_the_kernels_mode_is_ended_only_where_it_is_on() -> None:
    """A driver that never had it is not touched."""
    driver = Driver()
    adapter.end_kernel_mode(0, PORT, driver.ioctl)
    assert adapter.TIOCSRS485 not in driver.asked
    driver.rs485[0] = adapter.RS485_ENABLED
    assert adapter.is_kernel_mode(0, driver.ioctl)
    adapter.end_kernel_mode(0, PORT, driver.ioctl)
    assert not adapter.is_kernel_mode(0, driver.ioctl)
    adapter.end_kernel_mode(0, PORT, Driver(has_rs485=False).ioctl)


# ---- RTS by the gateway


@pytest.mark.parametrize("on_send", [True, False])
def test_rts_is_asserted_while_sending_or_the_other_way_round(on_send: bool) -> None:
    """DTR stays as it is."""
    driver = Driver()
    switch = RtsSwitch(0, Rts(on_send), driver.ioctl)
    switch.check(PORT)
    assert bool(driver.levels & termios.TIOCM_RTS) is not on_send
    switch.send()
    assert bool(driver.levels & termios.TIOCM_RTS) is on_send
    switch.receive()
    assert bool(driver.levels & termios.TIOCM_RTS) is not on_send
    assert driver.levels & termios.TIOCM_DTR


def test_an_adapter_without_rts_is_found_when_the_port_is_opened() -> None:
    """By the driver's refusal, or by reading back."""
    with pytest.raises(NotSwitched, match="does not set RTS"):
        RtsSwitch(0, Rts(), Driver(has_rts=False).ioctl).check(PORT)
    driver = Driver()
    driver.rts_is_fixed, driver.levels = True, termios.TIOCM_RTS
    with pytest.raises(NotSwitched, match="reads back otherwise"):
        RtsSwitch(0, Rts(), driver.ioctl).check(PORT)


def test_a_frame_has_left_when_the_shift_register_is_empty() -> None:
    """Where the driver does not tell that, when its buffer is."""
    for has_register in (True, False):
        driver = Driver(has_rts=has_register)
        switch = RtsSwitch(0, Rts(), driver.ioctl)
        assert switch.has_sent()
        driver.is_empty = False
        assert not switch.has_sent()


def test_real_drivers_are_asked_in_their_own_layout() -> None:
    """A pseudo-terminal has none of it, and says so through the same calls."""
    ours, theirs = pty.openpty()
    try:
        name = os.ttyname(theirs)
        assert adapter.set_low_latency(theirs, name).is_low is False
        assert not adapter.is_kernel_mode(theirs)
        with pytest.raises(NotSwitched):
            adapter.set_kernel_mode(theirs, name, Rts(), hears_itself=False)
        with pytest.raises(NotSwitched):
            RtsSwitch(theirs, Rts()).check(name)
        assert RtsSwitch(theirs, Rts()).has_sent()
        adapter.keep_levels_after_close(theirs)
        assert not termios.tcgetattr(theirs)[2] & termios.HUPCL
    finally:
        os.close(ours)
        os.close(theirs)
