"""MODBUS-TCP clients of other hands than pymodbus' and libmodbus': pyModbusTCP and uModbus, reading and writing."""

from __future__ import annotations

import asyncio
import socket
from collections.abc import Callable

import pytest
import uvloop
from pyModbusTCP.client import ModbusClient
from pyModbusTCP.constants import EXP_GATEWAY_PATH_UNAVAILABLE, EXP_GATEWAY_TARGET_DEVICE_FAILED_TO_RESPOND
from umodbus.client import tcp
from umodbus.exceptions import IllegalDataAddressError, IllegalFunctionError, ModbusError

from tests.modbus_tcp.rig import TOLD
from tests.modbus_tcp.served import serving

pytestmark = pytest.mark.e2e

LIMIT = 20.0  # seconds for anything to happen
FREQUENCY, OUTPUT = 0xFA01, 0xFD00


def ask(client: Callable[[int], None], *commanded: int) -> None:
    """Run a client in a thread against a server whose units `commanded` take every write."""

    async def main() -> None:
        async with asyncio.timeout(LIMIT), serving() as server:
            server.obey(*commanded)
            await asyncio.to_thread(client, server.port)

    with asyncio.Runner(loop_factory=uvloop.new_event_loop) as runner:
        runner.run(main())


def test_pymodbustcp_reads() -> None:
    """Values of a drive, the compact map, exceptions, and who the drive is."""

    def client(port: int) -> None:
        modbus = ModbusClient(host="127.0.0.1", port=port, unit_id=1, timeout=LIMIT)
        assert modbus.read_holding_registers(OUTPUT, 4) == [6000, 3, 5000, 0x1234]
        assert modbus.read_input_registers(0xFD18, 1) == [0xFFFF]
        assert modbus.read_holding_registers(0xFD30, 1) is None
        assert modbus.last_except == 2
        told = modbus.read_device_identification()
        assert told is not None
        assert told.objects_by_id == {i: text.encode() for i, text in enumerate(TOLD.values())}
        for unit, code in ((2, EXP_GATEWAY_TARGET_DEVICE_FAILED_TO_RESPOND), (77, EXP_GATEWAY_PATH_UNAVAILABLE)):
            modbus.unit_id = unit
            assert modbus.read_holding_registers(OUTPUT, 1) is None
            assert modbus.last_except == code
        modbus.unit_id = 255
        drives = modbus.read_holding_registers(0, 64)
        assert [drives[16 * place] for place in range(4)] == [0, 2, 5, 0]
        modbus.close()

    ask(client)


def test_pymodbustcp_writes() -> None:
    """06H, 10H, and 17H, whose answer is what it reads; a drive that takes no writes says 01."""

    def client(port: int) -> None:
        modbus = ModbusClient(host="127.0.0.1", port=port, unit_id=1, timeout=LIMIT)
        assert modbus.write_single_register(FREQUENCY, 3000)
        assert modbus.write_multiple_registers(0xFA00, [0xC400, 3000])
        assert modbus.write_read_multiple_registers(0xFA00, [0xC400, 3000], OUTPUT, 3) == [1, 2, 3]
        modbus.unit_id = 2
        assert not modbus.write_single_register(FREQUENCY, 3000)
        assert modbus.last_except == 1
        modbus.close()

    ask(client, 1)


def test_umodbus_reads() -> None:
    """By requests that it makes and sends over a socket of one's own; it raises what it is told."""

    def client(port: int) -> None:
        with socket.create_connection(("127.0.0.1", port), LIMIT) as connection:
            read = tcp.read_holding_registers(1, OUTPUT, 4)
            assert tcp.send_message(read, connection) == [6000, 3, 5000, 0x1234]
            assert tcp.send_message(tcp.read_input_registers(1, 0xFFFF, 1), connection) == [0xBEEF]
            assert tcp.send_message(tcp.read_holding_registers(255, 4, 1), connection) == [6000]
            with pytest.raises(IllegalDataAddressError):
                tcp.send_message(tcp.read_holding_registers(1, 0xFD30, 1), connection)
            with pytest.raises(IllegalFunctionError):
                tcp.send_message(tcp.read_coils(1, 0, 1), connection)
            for unit, code in ((2, 0x0B), (3, 0x0A)):
                with pytest.raises(ModbusError) as told:
                    tcp.send_message(tcp.read_holding_registers(unit, OUTPUT, 1), connection)
                assert told.value.error_code == code

    ask(client)


def test_umodbus_writes() -> None:
    """06H and 10H are answered with what was written, and where."""

    def client(port: int) -> None:
        with socket.create_connection(("127.0.0.1", port), LIMIT) as connection:
            assert tcp.send_message(tcp.write_single_register(1, FREQUENCY, 3000), connection) == 3000
            assert tcp.send_message(tcp.write_multiple_registers(1, 0xFA00, [0x4400, 3000]), connection) == 2

    ask(client, 1)
