from __future__ import annotations

import pytest

from gateway.drives.register import Storage
from tests.sim.rig import Rig, models

SIZES = [(model, code) for model in ("vf-nc3", "vf-mb1") for code in models()[model].capacities]
SHIPPED = {"number": 1, "protocol": 1, "acceleration_time_1": 100, "deceleration_time_1": 100}


class TestMapping:
    def test_the_block_is_as_the_selectors_were_at_the_last_reset(self) -> None:
        """A selector that is written reads back new, and acts only after a reset."""
        rig = Rig(running_at=30.0, presets={"block_read_1": 2, "block_read_2": 0})
        assert rig.write("block_read_2", 2) == "06 08 76 00 02"
        assert rig.read("block_read_2") == 2
        assert rig.ask("03 1875 0002") == "03 04 0B B8 00 00"
        rig.power_cycle()
        rig.drive.inverter.run_by_panel(30.0)
        rig.wait(10)
        assert rig.ask("03 1875 0002") == "03 04 0B B8 0B B8"

    def test_the_block_write_is_too(self) -> None:
        """F870 and F871 act after a reset: until then the block write is refused with 04."""
        rig = Rig()
        rig.write("block_write_1", 3)
        assert rig.ask("10 1870 0002 04 0BB8 0000") == "90 04"
        rig.power_cycle()
        assert rig.ask("10 1870 0002 04 0BB8 0000") == "10 18 70 00 02"
        assert rig.read("frequency_command") == 3000

    def test_a_deselected_word_of_a_block_write_writes_nothing(self) -> None:
        """F870 = 0 and F871 = 3: the first word goes nowhere."""
        rig = Rig(presets={"block_write_2": 3})
        assert rig.ask("10 1870 0002 04 C400 0BB8") == "10 18 70 00 02"
        assert rig.read("command") == 0
        assert rig.read("frequency_command") == 3000

    @pytest.mark.parametrize("model", ["vf-nc3", "vf-mb1"])
    def test_every_selector_reads_its_register(self, model: str) -> None:
        """Each selection of the catalogue gives the word that a single read gives."""
        for code, name in models()[model].read_selectors.items():
            rig = Rig(model, presets={"block_read_1": code})
            word = rig.read(name) if name else 0
            answer = rig.ask("03 1875 0002")
            assert answer is not None
            block = int(answer[6:11].replace(" ", ""), 16)
            assert block == pytest.approx(word, abs=60), name  # the DC voltage is measured twice


class TestStorage:
    @pytest.mark.hazard("H08")
    def test_every_write_to_the_eeprom_is_counted(self) -> None:
        """06H and 10H of a stored parameter wear it, each time, by number."""
        rig = Rig()
        for _ in range(3):
            rig.write("free_notes", 7)
        rig.ask("10 0880 0001 02 0008")
        assert rig.drive.inverter.memory.eeprom_writes == {0x0880: 4}

    @pytest.mark.hazard("H08")
    def test_what_is_ram_only_wears_nothing(self) -> None:
        """No register of the RAM kind counts, whatever is written; nor does a block write."""
        rig = Rig(presets={"block_write_1": 1, "block_write_2": 3})
        for register in rig.drive.model.registers.values():
            if register.storage is Storage.RAM:
                assert rig.write(register.name, 0) is not None
        rig.ask("10 1870 0002 04 8000 0BB8")
        assert rig.drive.inverter.memory.eeprom_writes == {}

    @pytest.mark.parametrize("model", ["vf-nc3", "vf-mb1"])
    def test_a_power_cycle_keeps_what_is_stored_and_only_that(self, model: str) -> None:
        """Every writable register is written a value of its own, and read after the power was off."""
        rig = Rig(model)
        kept = {}
        skipped = ("number", "protocol", "baud_rate", "parity", "command", "block_mode")
        for register in rig.drive.model.registers.values():
            if not register.is_writable or register.name in skipped:
                continue
            word = (register.minimum or 0) if register.initial else max(1, register.minimum or 0)
            answer = rig.write(register.name, word)
            assert answer is not None
            assert answer.startswith("06"), register.name
            kept[register.name] = word if register.storage is Storage.EEPROM else register.initial
        rig.power_cycle()
        assert {name: rig.read(name) for name in kept} == kept

    def test_a_write_to_the_eeprom_takes_its_time(self) -> None:
        """Up to 50 ms; a RAM write takes no longer than a read."""
        rig = Rig()
        rig.write("free_notes", 1)
        assert rig.delay == 0.050
        rig.write("frequency_command", 1)
        assert rig.delay == 0.005

    def test_the_wait_time_is_a_least_time(self) -> None:
        """F805 = 0.02 s stretches a quick answer and not a slow one."""
        rig = Rig()
        rig.write("communication_wait_time", 2)
        rig.read("status")
        assert rig.delay == 0.02
        rig.write("free_notes", 1)
        assert rig.delay == 0.050


class TestLineParameters:
    def test_the_number_acts_at_once(self) -> None:
        """The answer still comes from the old number, the next one from the new."""
        rig = Rig()
        assert rig.ask("06 0802 0005") == "06 08 02 00 05"
        assert rig.ask("03 0802 0001") is None
        assert rig.ask("03 0802 0001", number=5) == "03 02 00 05"

    def test_the_protocol_acts_after_a_reset(self) -> None:
        """F829 = 0 is answered, and after the next reset MODBUS-RTU is not."""
        rig = Rig()
        assert rig.write("protocol", 0) == "06 08 29 00 00"
        assert rig.read("protocol") == 0
        rig.power_cycle()
        assert rig.ask("03 0829 0001") is None

    def test_the_baud_rate_acts_after_a_reset(self) -> None:
        """Until then the drive hears the line as before."""
        rig = Rig()
        rig.write("baud_rate", 5)
        assert rig.drive.hears(19200, "even")
        rig.power_cycle()
        assert not rig.drive.hears(19200, "even")
        assert rig.drive.hears(38400, "even")

    def test_a_drive_with_another_parity_does_not_hear(self) -> None:
        """F801 = 1 is even parity."""
        assert not Rig().drive.hears(19200, "odd")


class TestWhoItIs:
    @pytest.mark.parametrize(("model", "code"), SIZES)
    def test_the_capacity_shows_in_code_and_reference(self, model: str, code: int) -> None:
        """FB05 and 2BH say the same size, for each size of the catalogue."""
        rig = Rig(model, capacity=code)
        form = models()[model].capacities[code]
        answer = rig.ask("2B 0E 01 00")
        assert answer is not None
        assert rig.read("capacity_code") == code
        assert form.encode() in bytes.fromhex(answer)
        assert rig.read("rated_current") > 0
        assert rig.read("rated_voltage") == (4000 if "-4" in form else 2000)

    def test_vf_nc3_names_its_series(self) -> None:
        """FB07 is 208, FE08 the version that 2BH says too."""
        rig = Rig(version=108)
        assert rig.read("series_code") == 208
        assert rig.read("cpu_version") == 108
        answer = rig.ask("2B 0E 01 00")
        assert answer is not None
        assert bytes.fromhex(answer).endswith(b"0108")

    def test_the_shipped_parameters_are_the_catalogue_s(self) -> None:
        """Everything that nobody set reads its initial value; ACC and DEC are 10.0 s."""
        rig = Rig()
        for register in rig.drive.model.registers.values():
            if register.storage is Storage.EEPROM:
                assert rig.read(register.name) == SHIPPED.get(register.name, register.initial), register.name

    def test_vf_as3_answers_with_the_little_that_is_known_of_it(self) -> None:
        """Its one monitor is served, and what is not in the catalogue does not exist."""
        rig = Rig("vf-as3", running_at=25.0)
        assert rig.read("output_frequency") == 2500
        assert rig.ask("03 FD01 0001") == "83 02"
        assert rig.ask("03 1875 0005") == "83 02"
