"""Tells an adapter's echo of a request from the answer behind it, by its bytes; learns whether there is an echo.

MODBUS-RTU 06H and TOSHIBA writes are answered by a copy of the request (SAFETY.md H15): where an adapter echoes, the
first copy is the echo and only a second one an answer. What differs from its request tells whether there is an echo.
"""

from __future__ import annotations

from collections.abc import Callable
from enum import Enum

ABSENT_AFTER = 3  # answers in a row without the echo that was there before: the adapter does not echo any more


class Hearing(Enum):
    """What came of the echo of one request."""

    NOTHING = "no byte at all"
    ECHO = "the echo, exactly"
    ANSWER = "an answer, and no echo before it"
    UNCLEAR = "bytes that do not tell"


class LocalEcho:
    """What is known of the echo of one adapter since its port was opened.

    `mode` is "on", "off", or "auto": then it is learnt. `is_present` is None until something has told; `line` is
    the name of the line, for the log.
    """

    def __init__(self, mode: str = "auto", line: str = "") -> None:
        self.line = line
        self._is_learnt = mode == "auto"
        self.is_present: bool | None = None if self._is_learnt else mode == "on"
        self._missed = 0

    def listen(self, frame: bytes) -> Listening:
        """Begin to listen behind a request."""
        return Listening(frame, is_expected=self.is_present is True, is_demanded=not self._is_learnt)

    def learn(self, hearing: Hearing) -> bool:
        """Take what came of an echo; say whether it changes what is known."""
        before = self.is_present
        if not self._is_learnt or hearing in (Hearing.NOTHING, Hearing.UNCLEAR):
            return False
        if hearing is Hearing.ECHO:
            self.is_present, self._missed = True, 0
        elif self.is_present:
            self._missed += 1
            self.is_present = self._missed < ABSENT_AFTER
        else:
            self.is_present, self._missed = False, 0
        return self.is_present is not before


class Listening:
    """Separates what comes behind one request into its echo, which is kept back, and the rest."""

    def __init__(self, frame: bytes, *, is_expected: bool, is_demanded: bool) -> None:
        self.frame = frame
        self._is_expected = is_expected
        self._is_demanded = is_demanded
        self._first = bytearray()  # at most as many bytes as the request has
        self._count = 0
        self._junk: bytes | None = None  # what came before the answer, None where there is no answer
        self._is_passing = not is_expected
        self.is_heard = False  # the echo has come and was kept back

    def take(self, data: bytes) -> bytes:
        """Return what is no echo: nothing until the first bytes tell, then whatever comes."""
        self._count += len(data)
        lacking = len(self.frame) - len(self._first)
        self._first += data[:lacking]
        if self._is_passing:
            return data
        if not self.frame.startswith(self._first):
            self._is_passing = True
            return bytes(self._first) + data[lacking:]
        if len(self._first) < len(self.frame):
            return b""
        self._is_passing = self.is_heard = True
        return data[lacking:]

    @property
    def is_damaged(self) -> bool:
        """Say whether something else came, or a part of it, where the echo was to be."""
        return self._is_expected and not self.is_heard and bool(self._first)

    @property
    def said(self) -> str:
        """Say in words what became of an echo that did not come as expected; "" where all is well."""
        if not self._is_expected or self.is_heard:
            return ""
        if not self._first:
            return ", and not even the adapter's echo"
        came = bytes(self._first).hex(" ")
        advice = '; local_echo = "on" in the configuration, is that right?' if self._is_demanded else ""
        return f"the adapter's echo is not what was sent, the line is disturbed ({came}){advice}"

    def may_answer(self, junk: bytes) -> bool:
        """Say whether an answer may be believed; `junk` came with it and is no echo that was kept back.

        Where the echo is known it comes first. In its place there may be nothing at all, unless it is demanded by
        the configuration: an adapter may have been set otherwise. Damaged, it says that drives heard something else.
        """
        return not self._is_expected or self.is_heard or not (junk or self._is_demanded)

    def believe(self, junk: bytes) -> None:
        """Take note that an answer is believed, and of what came before it."""
        self._junk = junk

    def heard(self, is_copied: Callable[[], bool]) -> Hearing:
        """Say what came; `is_copied` says whether the answer is a copy of the request, which then tells nothing.

        An answer of TOSHIBA's binary mode may begin as its request does: only what is left beside it is an echo.
        """
        if not self._count:
            return Hearing.NOTHING
        if self.is_heard or (self._junk or b"").startswith(self.frame):
            return Hearing.ECHO
        is_same = self._first == self.frame
        if self._junk is not None:
            return Hearing.UNCLEAR if self._junk or (is_same and is_copied()) else Hearing.ANSWER
        is_alone = is_same and self._count == len(self.frame)
        return Hearing.ECHO if is_alone and not is_copied() else Hearing.UNCLEAR
