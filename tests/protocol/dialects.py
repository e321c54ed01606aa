"""Every codec in every form, with what the manuals say about its answers."""

from __future__ import annotations

from tests.protocol.drive_side import Dialect
from tests.protocol.modbus_dialect import Rtu
from tests.protocol.toshiba_dialects import Ascii, Binary

DIALECTS: tuple[Dialect, ...] = (
    Rtu(),
    Rtu(writes_by_10h=True),
    Ascii(),
    Ascii(has_stop=False),
    Ascii(has_checksum=False),
    Ascii(has_checksum=False, has_stop=False),
    Binary(),
    Binary(reads_by_g=True),
)
