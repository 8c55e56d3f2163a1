"""The object dictionaries of the emulated CiA 402 drives. They are read from table.toml, which names its sources."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

from drivers.tables import table
from sim_backend.wire.canopen.dictionary import I8, I16, I32, STRING, U8, U16, U32, Entry

TORQUE_CONSTANT = 0.02
"""N m/A of the emulated motor."""


@dataclass(frozen=True, slots=True)
class Cia402Model:
    """One kind of drive. name, vendor, product, revision: its identity. speed: index and sub-index of its speed
    limit.
    """

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

_TABLE = table("cia402", "sim_backend.wire")
_TYPES = {"I8": I8, "I16": I16, "I32": I32, "STRING": STRING, "U8": U8, "U16": U16, "U32": U32}
_RECORDS: Mapping[int, tuple[str, int]] = {int(index, 0): row for index, row in _TABLE["records"].items()}
"""Objects with sub-indices: the name of each, and its highest sub-index."""

GROUPS: Mapping[int, str] = {
    0x1003: "Error history",
    **{index: name for index, (name, _) in _RECORDS.items()},
    **{0x1400 + n: f"Receive PDO {n + 1} parameter" for n in range(4)},
    **{0x1600 + n: f"Receive PDO {n + 1} mapping" for n in range(4)},
    **{0x1800 + n: f"Transmit PDO {n + 1} parameter" for n in range(4)},
    **{0x1A00 + n: f"Transmit PDO {n + 1} mapping" for n in range(4)},
}


def entries(model: str, ident: int) -> Iterator[Entry]:
    """Yield every entry of the object dictionary of `model`, with the values of a new drive with node id `ident`."""
    rows = [*_TABLE["objects"]["common"], *_TABLE["objects"][model]]
    for index, sub, name, kind, *more in rows:
        yield Entry(index, sub, name, _TYPES[kind], *more)
    for index in {row[0] for row in rows} & _RECORDS.keys():
        epos2 = model == "epos2" and index >= 0x2000
        name = "Internal number of entries" if epos2 else "Highest sub-index supported"
        yield Entry(index, 0, name, U8, "ro", _RECORDS[index][1])
    yield from _pdos(ident)


def _pdos(ident: int) -> Iterator[Entry]:
    """Yield the entries of four PDOs in each direction. Only the first PDO of each direction is enabled."""
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
