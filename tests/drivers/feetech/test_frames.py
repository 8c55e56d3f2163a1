"""Feetech's protocol and memory tables: the vendor's own examples, and the figures that other libraries have."""

from __future__ import annotations

import math
from typing import Any, get_args

import pytest

from drivers.feetech.block import Block
from drivers.feetech.config import Baudrate
from drivers.feetech.faults import ALERTS, reported
from drivers.feetech.models import CURRENT_LSB, SPEED_UNIT, models, registers, signed
from drivers.packets.wire import BROADCAST, PING, READ, WRITE, Wire1
from sim_backend.wire.feetech import tables
from sim_backend.wire.feetech.device import FeetechDevice
from sim_backend.wire.packets.bus import PacketBus, PacketTiming

WIRE = Wire1(ALERTS)
# the vendor's sheet "STS3215 V3.6", page of instructions
UNLOCK = "ff ff fe 04 03 37 00 c3"
READ_POSITION = "ff ff 01 04 02 38 02 be"
SPEED_AND_POSITION = "ff ff 01 0a 03 29 32 e8 03 00 00 e8 03 c0"
POSITION_OF_2 = "ff ff 02 09 03 2a e8 03 00 00 00 00 dc"


@pytest.mark.parametrize(
    ("ident", "instruction", "parameters", "printed"),
    [
        (BROADCAST, WRITE, "37 00", UNLOCK),
        (1, READ, "38 02", READ_POSITION),
        (1, WRITE, "29 32 e8 03 00 00 e8 03", SPEED_AND_POSITION),
        (2, WRITE, "2a e8 03 00 00 00 00", POSITION_OF_2),
        (1, PING, "", "ff ff 01 02 01 fb"),
    ],
)
def test_requests_are_the_vendors_examples(ident: int, instruction: int, parameters: str, printed: str) -> None:
    assert WIRE.frame(ident, instruction, bytes.fromhex(parameters)) == bytes.fromhex(printed)


def test_the_emulator_obeys_the_vendors_examples() -> None:
    first, second = FeetechDevice("sts3215", 1), FeetechDevice("sts3215", 2)
    bus = PacketBus([first, second], protocol=1)
    assert b"".join(data for _, data in bus.receive(bytes.fromhex(UNLOCK), 0.1)) == b""
    first.put("present_position", 0)
    replies = bus.receive(bytes.fromhex(SPEED_AND_POSITION + POSITION_OF_2 + READ_POSITION), 0.1)
    assert [data for _, data in replies] == [
        bytes.fromhex("ff ff 01 02 00 fc"),
        bytes.fromhex("ff ff 02 02 00 fb"),
        bytes.fromhex("ff ff 01 04 00 00 00 fa"),
    ]
    assert [first.get(name) for name in ("lock", "acceleration", "goal_position", "goal_velocity")] == [
        0,
        50,
        1000,
        1000,
    ]
    assert second.get("goal_position") == 1000


def test_a_request_with_a_wrong_checksum_is_not_answered() -> None:
    assert PacketBus([FeetechDevice("sts3215")], protocol=1).receive(bytes.fromhex("ff ff 01 02 01 fa"), 0.1) == []


def test_words_have_the_low_byte_first_on_an_sts_and_the_high_byte_first_on_an_scs() -> None:
    sts, scs = registers("sts")["goal_position"], registers("scs")["goal_position"]
    assert (sts.encoded(1023), scs.encoded(1023)) == (b"\xff\x03", b"\x03\xff")
    assert sts.decoded(scs.encoded(1023)) != 1023
    assert scs.decoded(b"\x03\xff") == 1023


@pytest.mark.parametrize(
    ("raw", "sign_bit", "value"),
    [(0x8064, 15, -100), (100, 15, 100), (0x7FFF, 15, 32767), (0x464, 10, -100), (0x3E8, 10, 1000), (0x864, 11, -100)],
)
def test_a_negative_number_is_a_magnitude_with_a_sign(raw: int, sign_bit: int, value: int) -> None:
    assert signed(raw, sign_bit) == value


def test_a_number_that_does_not_fit_is_not_encoded() -> None:
    goal = registers("sts")["goal_position"]
    assert goal.encoded(-1) == b"\x01\x80"
    for value in (-32768, 32768):
        with pytest.raises(OverflowError):
            goal.encoded(value)
    with pytest.raises(OverflowError):
        registers("scs")["goal_position"].encoded(-1)


def test_the_units_are_those_of_the_memory_tables() -> None:
    assert math.degrees(models()["sts3215"].position_lsb) == pytest.approx(0.087890625)
    assert math.degrees(models()["scs0009"].position_lsb) == pytest.approx(0.293, abs=1e-3)
    # "50 steps / second = 0.732 RPM"
    assert SPEED_UNIT * models()["sts3215"].position_lsb * 60.0 / math.tau == pytest.approx(0.732, abs=1e-3)
    # "the maximum measurable current is 500 * 6.5mA = 3250mA"
    assert pytest.approx(3.25) == 500 * CURRENT_LSB


def test_a_block_is_decoded_as_the_memory_table_says() -> None:
    data = bytes.fromhex("00 88 64 80 64 04 78 1e 00 00 01 00 00 0a 80")
    block = Block(models()["sts3215"])
    block.speed_unit = 1
    address, size = block.request(0.0)
    state = block.state(bytes(size - 15) + data)
    assert address + size == 71
    assert state.raw == -2048
    assert math.degrees(state.velocity) == pytest.approx(-100 * 0.087890625)
    assert state.current == pytest.approx(-0.065)
    assert state.voltage == pytest.approx(12.0)
    assert state.temperature == 30.0


def test_no_length_is_read_again_while_a_lost_reply_of_that_length_may_still_arrive() -> None:
    block = Block(models()["sts3215"])
    lost = {block.request(0.0)}
    block.lost(0.0)
    lost.add(block.request(0.1))
    block.lost(0.1)
    assert len(lost) == 2
    assert not lost & {block.request(0.2) for _ in range(20)}
    assert lost < {block.request(2.0) for _ in range(20)}


@pytest.mark.parametrize(
    ("bit", "words"), [(1, "voltage"), (2, "encoder"), (4, "too hot"), (8, "current"), (16, "angle"), (32, "load")]
)
def test_each_bit_of_the_status_has_its_meaning_and_a_remedy(bit: int, words: str) -> None:
    fault = reported(bit)
    assert fault.code == bit
    assert words in str(fault)
    assert ":" in str(fault).partition(words)[2]


def test_the_return_delay_is_in_counts_of_2_us() -> None:
    device = FeetechDevice("sts3215")
    bus = PacketBus([device], timing=PacketTiming(usb_latency=0.0), protocol=1)
    prompt, _ = bus.receive(bytes.fromhex(READ_POSITION), 1.0)[0]
    device.put("return_delay", 250)
    delayed, _ = bus.receive(bytes.fromhex(READ_POSITION), 2.0)[0]
    assert delayed - 2.0 - (prompt - 1.0) == pytest.approx(500e-6)


def test_the_baud_rates_stand_in_the_order_of_their_codes() -> None:
    assert get_args(Baudrate) == tables.BAUD
    assert FeetechDevice("sts3215", baudrate=115_200).get("baud_rate") == 4


def test_the_lock_decides_whether_the_eeprom_outlives_the_power() -> None:
    for locked, kept in ((1, 70), (0, 55)):
        device = FeetechDevice("sts3215")
        device.write(55, bytes([locked]))
        device.write(13, b"\x37")
        assert device.get("temperature_limit") == 55
        device.reboot(1.0)
        assert device.get("temperature_limit") == kept


LEROBOT = {
    "sts": {"return_delay": 7, "response_level": 8, "min_position_limit": 9, "max_position_limit": 11}
    | {"temperature_limit": 13, "phase": 18, "angular_resolution": 30, "operating_mode": 33, "torque_enable": 40}
    | {"acceleration": 41, "goal_position": 42, "goal_velocity": 46, "torque_limit": 48, "lock": 55}
    | {"protective_torque": 34, "protection_time": 35, "overload_torque": 36},
    "scs": {"return_delay": 7, "response_level": 8, "min_position_limit": 9, "max_position_limit": 11}
    | {"temperature_limit": 13, "torque_limit": 16, "torque_enable": 40, "goal_position": 42, "goal_time": 44}
    | {"goal_velocity": 46, "lock": 48, "protective_torque": 37, "protection_time": 38},
}


@pytest.mark.parametrize("family", ["sts", "scs"])
def test_the_addresses_are_those_of_lerobot(family: Any) -> None:
    addresses = {name: item.address for name, item in registers(family).items()}
    if family == "scs":
        assert addresses.pop("overload_torque") == 39  # LeRobot does not name it
    assert addresses == LEROBOT[family]


@pytest.mark.parametrize(("model", "number", "order"), [
    ("sts3215", 777, "little"), ("sts3250", 2825, "little"), ("scs0009", 1284, "big"),
    ("hls3930m", 4106, "little"), ("hls2915m", 6922, "little"),
])  # fmt: skip
def test_the_model_numbers_are_those_that_others_read(model: str, number: int, order: Any) -> None:
    assert int.from_bytes(bytes(models()[model].number), order) == number


@pytest.mark.parametrize("name", sorted(models()))
def test_the_emulators_tables_and_the_adapters_agree(name: str) -> None:
    ours, theirs = models()[name], tables.MODELS[name]
    assert (ours.number, ours.position_lsb, ours.family == "scs") == (theirs.number, theirs.count, theirs.big)
    assert ours.firmware <= theirs.firmware
    assert ours.stall == theirs.stall[2]
    items = {item.name: (item.address, item.size) for item in theirs.items}
    renamed = {"torque_limit": "max_torque"} if theirs.big else {}
    for key, register in registers(ours.family).items():
        assert (register.address, register.size) == items[renamed.get(key, key)]
