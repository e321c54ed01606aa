"""The protocols of the drives by the names that a configuration has for them."""

from __future__ import annotations

from collections.abc import Mapping

from gateway.protocol.codec import Codec
from gateway.protocol.modbus_rtu import ModbusRtu
from gateway.protocol.toshiba_ascii import ToshibaAscii
from gateway.protocol.toshiba_binary import ToshibaBinary

_CODECS: tuple[Codec, ...] = (ModbusRtu(), ToshibaAscii(), ToshibaBinary())

PROTOCOLS: Mapping[str, Codec] = {codec.name: codec for codec in _CODECS}
