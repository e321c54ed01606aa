"""The client's side of RFC 2217: a serial server is told baud rate and parity, and bytes go by telnet's rules.

Bytes in, bytes out: whoever has the connection sends what `outgoing` returns. RFC 854, 855, 856, 2217.
"""

from __future__ import annotations

from dataclasses import dataclass, field

SE, SB, WILL, WONT, DO, DONT, IAC = 240, 250, 251, 252, 253, 254, 255

BINARY, SUPPRESS_GO_AHEAD, COM_PORT = 0, 3, 44
WANTED = (BINARY, SUPPRESS_GO_AHEAD)  # on both sides; COM_PORT is asked for by the client

SET_BAUDRATE, SET_DATASIZE, SET_PARITY, SET_STOPSIZE, SET_CONTROL = 1, 2, 3, 4, 5
SET_LINESTATE_MASK, SET_MODEMSTATE_MASK, PURGE_DATA = 10, 11, 12
SERVER = 100  # is added to a command in what the server says
NO_FLOW_CONTROL = 1
PURGE_BOTH = 3
PARITIES = {"none": 1, "odd": 2, "even": 3}
NAMES = {SET_BAUDRATE: "baud rate", SET_DATASIZE: "data bits", SET_PARITY: "parity", SET_STOPSIZE: "stop bits"}

SIGNATURE = 0  # a server may send it unasked
LONGEST_SUBNEGOTIATION = 64  # bytes of one; RFC 2217's own have up to 6
SIGNATURES = (bytes([COM_PORT, SIGNATURE]), bytes([COM_PORT, SIGNATURE + SERVER]))
LONGEST_SIGNATURE = 1024  # bytes; the RFC names no limit


@dataclass(frozen=True, slots=True)
class Settings:
    """How the port of the server is to be set; 8 data bits."""

    baud: int
    parity: str
    stop_bits: int

    @property
    def values(self) -> dict[int, bytes]:
        """Return what each command carries."""
        return {
            SET_BAUDRATE: self.baud.to_bytes(4, "big"),
            SET_DATASIZE: bytes([8]),
            SET_PARITY: bytes([PARITIES[self.parity]]),
            SET_STOPSIZE: bytes([self.stop_bits]),
        }


@dataclass
class ComPort:
    """One connection to a serial server. `problem` says why it cannot be used, "" while nothing speaks against it."""

    settings: Settings
    problem: str = ""
    _out: bytearray = field(default_factory=bytearray)
    _acknowledged: set[int] = field(default_factory=set)
    _agreed: set[tuple[int, int]] = field(default_factory=set)  # what was said of options, by either side
    _is_com_port: bool = False
    _command: int | None = None  # of telnet, whose option is to come
    _is_escaped: bool = False
    _subnegotiation: bytearray | None = None

    def __post_init__(self) -> None:
        """Ask for the option, and for eight bits both ways."""
        for option in (COM_PORT, *WANTED):
            self._say(WILL, option)
        for option in WANTED:
            self._say(DO, option)

    @property
    def is_ready(self) -> bool:
        """Say whether the server has taken every setting."""
        return not self.problem and self._acknowledged >= set(NAMES)

    @property
    def lacking(self) -> str:
        """Say what the server has not answered yet."""
        if not self._is_com_port:
            return 'it does not speak RFC 2217; for a raw TCP port write "socket://"'
        missing = (name for command, name in NAMES.items() if command not in self._acknowledged)
        return f"it does not acknowledge {', '.join(missing)}"

    def outgoing(self) -> bytes:
        """Return what is to be sent to the server now."""
        out = bytes(self._out)
        self._out.clear()
        return out

    def escaped(self, data: bytes) -> bytes:
        """Return how bytes for the line are sent: FFH twice."""
        return data.replace(b"\xff", b"\xff\xff")

    def feed(self, data: bytes) -> bytes:
        """Take what the server sent; return the bytes of the line in it."""
        return bytes(byte for byte in data if self._is_of_line(byte))

    def _is_of_line(self, byte: int) -> bool:
        """Take one byte; say whether it came from the line."""
        if self._command is not None:
            command, self._command = self._command, None
            self._negotiate(command, byte)
        elif self._is_escaped:
            self._is_escaped = False
            if byte == IAC:
                return self._is_data(byte)
            self._obey(byte)
        elif byte == IAC:
            self._is_escaped = True
        else:
            return self._is_data(byte)
        return False

    def _is_data(self, byte: int) -> bool:
        if self._subnegotiation is None:
            return True
        is_signature = self._subnegotiation[:2] in SIGNATURES
        if len(self._subnegotiation) < (LONGEST_SIGNATURE if is_signature else LONGEST_SUBNEGOTIATION):
            self._subnegotiation.append(byte)
        else:
            self._lose_end()
        return False

    def _lose_end(self) -> None:
        """Give up: which bytes are the line's can no longer be told."""
        self.problem = self.problem or "its subnegotiation does not end (no IAC SE): is it a server by RFC 2217?"

    def _obey(self, command: int) -> None:
        if command in (WILL, WONT, DO, DONT):
            self._command = command
        elif command == SB:
            if self._subnegotiation is not None:
                self._lose_end()
            self._subnegotiation = bytearray()
        elif command == SE and self._subnegotiation is not None:
            said, self._subnegotiation = bytes(self._subnegotiation), None
            self._hear(said)

    def _negotiate(self, command: int, option: int) -> None:
        """Take what the server says of an option; each thing is answered once, so that nobody goes on for ever."""
        if option == COM_PORT and command in (DO, WILL):
            self._begin()
        elif option == COM_PORT and command == DONT:
            self.problem = 'it refuses RFC 2217 (DONT COM-PORT-OPTION); for a raw TCP port write "socket://"'
        if command in (DO, WILL):
            is_wanted = option in WANTED or option == COM_PORT
            agreeing, refusing = (WILL, WONT) if command == DO else (DO, DONT)
            self._say(agreeing if is_wanted else refusing, option)

    def _begin(self) -> None:
        """Set the port, once, and have what is left in it thrown away."""
        if self._is_com_port:
            return
        self._is_com_port = True
        for command, value in self.settings.values.items():
            self._set(command, value)
        self._set(SET_CONTROL, bytes([NO_FLOW_CONTROL]))
        self._set(SET_LINESTATE_MASK, bytes(1))  # tell nothing that was not asked
        self._set(SET_MODEMSTATE_MASK, bytes(1))
        self._set(PURGE_DATA, bytes([PURGE_BOTH]))

    def _hear(self, said: bytes) -> None:
        """Take a subnegotiation; the server answers a setting with what is in force."""
        if len(said) < 2 or said[0] != COM_PORT or (command := said[1] - SERVER) not in NAMES:
            return
        wanted, value = self.settings.values[command], said[2:]
        if value == wanted:
            self._acknowledged.add(command)
            return
        self.problem = (
            f"its {NAMES[command]} is {_number(command, value)} and not {_number(command, wanted)}:"
            " set it there, or allow it to be set"
        )

    def _say(self, command: int, option: int) -> None:
        if (command, option) not in self._agreed:
            self._agreed.add((command, option))
            self._out += bytes([IAC, command, option])

    def _set(self, command: int, value: bytes) -> None:
        self._out += bytes([IAC, SB, COM_PORT, command]) + self.escaped(value) + bytes([IAC, SE])


def _number(command: int, value: bytes) -> str:
    """Say in words what a setting is."""
    number = int.from_bytes(value, "big")
    names = {code: name for name, code in PARITIES.items()} if command == SET_PARITY else {}
    return names.get(number, str(number))
