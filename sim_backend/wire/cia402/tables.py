"""The object dictionaries of the emulated drives.

Source: the electronic data sheets of the EPOS4 Module 24/1.5 (software 0x0170) and the EPOS 70/10 (0x2033), and the
maxon firmware specifications, for indices, types, access, defaults and ranges. The EPOS has no 0x6071 and no 0x6077;
the EPOS4 has no 0x6072. 0x6007 of the EPOS2 is not in the older data sheet. The third, `generic`, is CiA 402-2 itself.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

from sim_backend.wire.canopen.dictionary import I8, I16, I32, STRING, U8, U16, U32, Entry

NOMINAL_CURRENT, PEAK_CURRENT = 1500, 4500
"""mA."""
TORQUE_CONSTANT = 0.02
"""N m/A of the motor behind it."""
PULSES = 1024
"""Encoder pulses a turn; four counts each."""
SCALE = 2.0
"""The paper's joint with torques as large as suit that motor."""


@dataclass(frozen=True, slots=True)
class Cia402Model:
    """One drive. name, vendor, product, revision: its identity. speed: of its speed limit's object."""

    name: str
    vendor: int
    product: int
    revision: int
    mode: int
    target: tuple[int, int]
    current_limit: tuple[int, int] | None
    speed: tuple[int, int]
    quick_stop_holds: bool = True


MODELS: Mapping[str, Cia402Model] = {
    "epos4": Cia402Model(
        "EPOS4 Module 24/1.5", 0xFB, 0x60500000, 0x01700000, 10, (0x6071, 0), (0x3001, 2), (0x6080, 0)
    ),
    "epos2": Cia402Model("EPOS2", 0xFB, 0x62200000, 0x21260000, -3, (0x2030, 0), (0x6410, 2), (0x6410, 4)),
    "generic": Cia402Model("CiA 402 drive", 0x2E3, 0x00000402, 0x00010000, 10, (0x6071, 0), None, (0x6080, 0)),
}

_COMMON: list[tuple[int, int, str, int, str, int | str, bool]] = [
    (0x1000, 0, "Device type", U32, "ro", 0x00020192, False),
    (0x1001, 0, "Error register", U8, "ro", 0, False),
    (0x1003, 0, "Number of errors", U8, "rw", 0, False),
    *((0x1003, n, f"Error history {n}", U32, "ro", 0, False) for n in range(1, 6)),
    (0x1005, 0, "COB-ID SYNC", U32, "rw", 0x80, False),
    (0x1008, 0, "Manufacturer device name", STRING, "const", "", False),
    (0x1010, 1, "Save all parameters", U32, "rw", 1, False),
    (0x1011, 1, "Restore all default parameters", U32, "rw", 1, False),
    (0x1016, 1, "Consumer 1 heartbeat time", U32, "rw", 0, False),
    (0x1016, 2, "Consumer 2 heartbeat time", U32, "rw", 0, False),
    (0x1017, 0, "Producer heartbeat time", U16, "rw", 0, False),
    (0x1018, 1, "Vendor ID", U32, "ro", 0, False),
    (0x1018, 2, "Product code", U32, "ro", 0, False),
    (0x1018, 3, "Revision number", U32, "ro", 0, False),
    (0x1018, 4, "Serial number", U32, "ro", 0, False),
    (0x6007, 0, "Abort connection option code", I16, "rw", 3, False),
    (0x6040, 0, "Controlword", U16, "rw", 0, True),
    (0x6041, 0, "Statusword", U16, "ro", 0, True),
    (0x6060, 0, "Modes of operation", I8, "rw", 1, True),
    (0x6061, 0, "Modes of operation display", I8, "ro", 1, True),
    (0x6064, 0, "Position actual value", I32, "ro", 0, True),
    (0x606C, 0, "Velocity actual value", I32, "ro", 0, True),
    (0x6502, 0, "Supported drive modes", U32, "ro", 0, False),
]

_EPOS4: list[tuple[int, int, str, int, str, int | str, bool]] = [
    (0x2200, 1, "Power supply voltage", U16, "ro", 240, False),
    (0x3000, 5, "Main sensor resolution", U32, "ro", 4 * PULSES, False),
    (0x3000, 6, "Max system speed", U32, "ro", 50000, False),
    (0x3001, 1, "Nominal current", U32, "rw", NOMINAL_CURRENT, True),
    (0x3001, 2, "Output current limit", U32, "rw", PEAK_CURRENT, True),
    (0x3001, 3, "Number of pole pairs", U8, "rw", 1, False),
    (0x3001, 4, "Thermal time constant winding", U16, "rw", 40, False),
    (0x3001, 5, "Torque constant", U32, "rw", round(TORQUE_CONSTANT * 1e6), False),
    (0x3010, 1, "Digital incremental encoder 1 number of pulses", U32, "rw", PULSES, False),
    (0x30D0, 0, "Current demand value", I32, "ro", 0, True),
    (0x30D1, 1, "Current actual value averaged", I32, "ro", 0, True),
    (0x30D1, 2, "Current actual value", I32, "ro", 0, True),
    (0x3201, 1, "Temperature power stage", I16, "ro", 0, False),
    (0x3201, 4, "Maximal temperature power stage", U16, "rw", 1000, False),
    (0x603F, 0, "Error code", U16, "ro", 0, True),
    (0x605A, 0, "Quick stop option code", I16, "rw", 6, False),
    (0x6065, 0, "Following error window", U32, "rw", 2000, True),
    (0x6071, 0, "Target torque", I16, "rw", 0, True),
    (0x6076, 0, "Motor rated torque", U32, "ro", 0, False),
    (0x6077, 0, "Torque actual value", I16, "ro", 0, True),
    (0x6080, 0, "Max motor speed", U32, "rw", 50000, True),
    (0x60A9, 0, "SI unit velocity", U32, "rw", 0x00B44700, False),
    (0x60B2, 0, "Torque offset", I16, "rw", 0, True),
]

_EPOS2: list[tuple[int, int, str, int, str, int | str, bool]] = [
    (0x2003, 1, "Software version", U16, "ro", 0x2126, False),
    (0x2003, 2, "Hardware version", U16, "ro", 0x6220, False),
    (0x2027, 0, "Current actual value averaged", I16, "ro", 0, True),
    (0x2028, 0, "Velocity actual value averaged", I32, "ro", 0, True),
    (0x2030, 0, "Current mode setting value", I16, "rw", 0, True),
    (0x2210, 1, "Encoder pulse number", U16, "rw", PULSES, False),
    (0x2210, 2, "Position sensor type", U16, "rw", 1, False),
    (0x6065, 0, "Max following error", U32, "rw", 2000, True),
    (0x6078, 0, "Current actual value", I16, "ro", 0, True),
    (0x6410, 1, "Continuous current limit", U16, "rw", NOMINAL_CURRENT, True),
    (0x6410, 2, "Output current limit", U16, "rw", PEAK_CURRENT, True),
    (0x6410, 3, "Pole pair number", U8, "rw", 1, False),
    (0x6410, 4, "Maximal speed in current mode", U16, "rw", 30000, True),
    (0x6410, 5, "Thermal time constant winding", U16, "rw", 40, False),
]

_GENERIC: list[tuple[int, int, str, int, str, int | str, bool]] = [
    (0x603F, 0, "Error code", U16, "ro", 0, True),
    (0x605A, 0, "Quick stop option code", I16, "rw", 2, False),
    (0x6071, 0, "Target torque", I16, "rw", 0, True),
    (0x6072, 0, "Max torque", U16, "rw", 3000, True),
    (0x6075, 0, "Motor rated current", U32, "ro", NOMINAL_CURRENT, False),
    (0x6076, 0, "Motor rated torque", U32, "ro", round(NOMINAL_CURRENT * TORQUE_CONSTANT), False),
    (0x6077, 0, "Torque actual value", I16, "ro", 0, True),
    (0x6079, 0, "DC link circuit voltage", U32, "ro", 24000, True),
    (0x6080, 0, "Max motor speed", U32, "rw", 30000, True),
    (0x608F, 1, "Encoder increments", U32, "rw", 4 * PULSES, False),
    (0x608F, 2, "Motor revolutions", U32, "rw", 1, False),
    (0x60A9, 0, "SI unit velocity", U32, "rw", 0xFDB44700, False),
]

_RANGES: Mapping[tuple[int, int], tuple[int, int]] = {
    (0x3001, 1): (0, NOMINAL_CURRENT),
    (0x3001, 2): (0, PEAK_CURRENT),
    (0x3001, 5): (0, 10_000_000),
    (0x3201, 4): (0, 1000),
    (0x6007, 0): (0, 3),
    (0x6410, 2): (0, 2 * PEAK_CURRENT),
}

_RECORDS: Mapping[int, tuple[str, int]] = {
    0x1010: ("Store parameters", 1),
    0x1011: ("Restore default parameters", 1),
    0x1016: ("Consumer heartbeat time", 2),
    0x1018: ("Identity object", 4),
    0x2003: ("Version numbers", 2),
    0x2200: ("Power supply", 2),
    0x2210: ("Sensor configuration", 2),
    0x3000: ("Axis configuration", 6),
    0x3001: ("Motor data", 5),
    0x3010: ("Digital incremental encoder 1", 4),
    0x30D1: ("Current actual values", 2),
    0x3201: ("Thermal overload protection", 4),
    0x608F: ("Position encoder resolution", 2),
    0x6410: ("Motor data", 5),
}
"""Objects with sub-indices: the name, and the highest sub-index."""

GROUPS: Mapping[int, str] = {
    0x1003: "Error history",
    **{index: name for index, (name, _) in _RECORDS.items()},
    **{0x1400 + n: f"Receive PDO {n + 1} parameter" for n in range(4)},
    **{0x1600 + n: f"Receive PDO {n + 1} mapping" for n in range(4)},
    **{0x1800 + n: f"Transmit PDO {n + 1} parameter" for n in range(4)},
    **{0x1A00 + n: f"Transmit PDO {n + 1} mapping" for n in range(4)},
}


def entries(model: str, ident: int) -> Iterator[Entry]:
    """Every entry of `model`'s dictionary, as node `ident` is delivered."""
    own = {"epos4": _EPOS4, "epos2": _EPOS2, "generic": _GENERIC}[model]
    for index, sub, name, kind, access, default, mappable in (*_COMMON, *own):
        low, high = _RANGES.get((index, sub), (None, None))
        yield Entry(index, sub, name, kind, access, default, mappable, low, high)
    for index in {row[0] for row in (*_COMMON, *own)} & _RECORDS.keys():
        epos2 = model == "epos2" and index >= 0x2000
        name = "Internal number of entries" if epos2 else "Highest sub-index supported"
        yield Entry(index, 0, name, U8, "ro", _RECORDS[index][1])
    yield from _pdos(ident)


def _pdos(ident: int) -> Iterator[Entry]:
    """Four PDOs each way; the first of each is on, the others are not."""
    received = [[0x60400010], [0x60400010, 0x60600008], [0x60400010], [0x60400010]]
    sent = [[0x60410010], [0x60410010, 0x60610008], [0x60410010, 0x60640020], [0x60410010, 0x606C0020]]
    for first, mapping, cob, mapped in ((0x1400, 0x1600, 0x200, received), (0x1800, 0x1A00, 0x180, sent)):
        for number in range(4):
            off = 1 << 31 if number else 0
            places = mapped[number]
            yield Entry(first + number, 0, "Highest sub-index supported", U8, "ro", 2)
            yield Entry(first + number, 1, "COB-ID", U32, "rw", off | cob + 0x100 * number + ident)
            yield Entry(first + number, 2, "Transmission type", U8, "rw", 255)
            yield Entry(mapping + number, 0, "Number of mapped objects", U8, "rw", len(places), low=0, high=8)
            for place in range(1, 9):
                value = places[place - 1] if place <= len(places) else 0
                yield Entry(mapping + number, place, f"Mapped object {place}", U32, "rw", value)
