"""The object dictionary of an emulated CANopen device: values, access rules, and the electronic data sheet.

Source: CiA 301 (data types, access, abort codes) and CiA 306 (the EDS file).
"""

from __future__ import annotations

import io
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import Any

from canopen.objectdictionary import ObjectDictionary, ODRecord, ODVariable
from canopen.objectdictionary.eds import export_eds

BOOL, I8, I16, I32, U8, U16, U32, STRING = 0x1, 0x2, 0x3, 0x4, 0x5, 0x6, 0x7, 0x9
SIZES: Mapping[int, int] = {BOOL: 1, I8: 1, I16: 2, I32: 4, U8: 1, U16: 2, U32: 4}
_SIGNED = {I8, I16, I32}

TOGGLE = 0x05030000
COMMAND = 0x05040001
WRITE_ONLY, READ_ONLY, NOT_NOW = 0x06010001, 0x06010002, 0x06010000
NO_OBJECT, NO_SUBINDEX = 0x06020000, 0x06090011
NOT_MAPPABLE, PDO_TOO_LONG = 0x06040041, 0x06040042
LENGTH, RANGE = 0x06070010, 0x06090030
BAD_SIGNATURE, WRONG_STATE = 0x08000020, 0x08000022
"""Abort codes of SDO transfers, from CiA 301."""

Value = int | str


class Abort(Exception):
    """Error: the device refuses an SDO transfer."""

    def __init__(self, code: int) -> None:
        super().__init__(f"0x{code:08X}")
        self.code = code


@dataclass(frozen=True, slots=True)
class Entry:
    """One sub-index of an object. access: ro, rw, wo or const. mappable: whether it may be mapped into a PDO."""

    index: int
    sub: int
    name: str
    kind: int
    access: str = "rw"
    default: Value = 0
    mappable: bool = False
    low: int | None = None
    high: int | None = None


class Dictionary:
    """The objects of one device with their values.

    read_hooks: functions that compute the value of an object when it is read. write_hooks: functions that are called
    after an object was written, and that may refuse the value.
    """

    def __init__(self, entries: Iterable[Entry], groups: Mapping[int, str]) -> None:
        self.entries = {(entry.index, entry.sub): entry for entry in entries}
        self.groups = dict(groups)
        self.values: dict[tuple[int, int], Value] = {key: entry.default for key, entry in self.entries.items()}
        self.read_hooks: dict[tuple[int, int], Callable[[], int]] = {}
        self.write_hooks: dict[int, Callable[[int, int, int], None]] = {}
        self._indices = {index for index, _ in self.entries}

    def entry(self, index: int, sub: int) -> Entry:
        """Return the entry of a sub-index. Raises Abort if it does not exist."""
        if (index, sub) not in self.entries:
            raise Abort(NO_SUBINDEX if index in self._indices else NO_OBJECT)
        return self.entries[index, sub]

    def get(self, index: int, sub: int = 0) -> int:
        """Return the present value of a number."""
        hook = self.read_hooks.get((index, sub))
        value = hook() if hook is not None else self.values[index, sub]
        assert isinstance(value, int)  # noqa: S101 - strings are read through `encoded`
        return value

    def put(self, index: int, sub: int, value: Value) -> None:
        """Set a value as the device's own firmware does, without access rules."""
        self.values[index, sub] = value

    def encoded(self, index: int, sub: int) -> bytes:
        """Return a value as the bytes that are sent. Raises Abort."""
        entry = self.entry(index, sub)
        if entry.access == "wo":
            raise Abort(WRITE_ONLY)
        if entry.kind == STRING:
            return str(self.values[index, sub]).encode("ascii")
        size = SIZES[entry.kind]
        return (self.get(index, sub) & ((1 << 8 * size) - 1)).to_bytes(size, "little")

    def write(self, index: int, sub: int, data: bytes) -> None:
        """Write a value that a client sent. Raises Abort."""
        entry = self.entry(index, sub)
        if entry.access in {"ro", "const"}:
            raise Abort(READ_ONLY)
        if len(data) != SIZES[entry.kind]:
            raise Abort(LENGTH)
        value = int.from_bytes(data, "little", signed=entry.kind in _SIGNED)
        if (entry.low is not None and value < entry.low) or (entry.high is not None and value > entry.high):
            raise Abort(RANGE)
        hook = self.write_hooks.get(index)
        if hook is not None:
            hook(index, sub, value)
        self.values[index, sub] = value


def eds(dictionary: Dictionary, *, vendor: int, product: int, revision: int, name: str) -> str:
    """Return the device's electronic data sheet: the text of an .eds file."""
    od = ObjectDictionary()  # type: ignore[no-untyped-call]  # canopen is typed in parts
    records = {index: ODRecord(title, index) for index, title in dictionary.groups.items()}
    for (index, _), entry in sorted(dictionary.entries.items()):
        if index in records:
            records[index].add_member(_variable(entry))
        od.add_object(records.get(index) or _variable(entry))
    about: Any = od.device_information
    about = od.device_information
    about.vendor_name, about.vendor_number = "maxon motor ag", vendor
    about.product_name, about.product_number, about.revision_number = name, product, revision
    about.allowed_baudrates = {1000 * rate for rate in (20, 50, 125, 250, 500, 800, 1000)}
    about.simple_boot_up_slave, about.granularity, about.nr_of_RXPDO, about.nr_of_TXPDO = True, 8, 4, 4
    text = io.StringIO()
    export_eds(od, text, {"FileName": "emulated.eds", "Description": f"Emulated {name}"})  # type: ignore[no-untyped-call]  # as above
    return text.getvalue()


def _variable(entry: Entry) -> ODVariable:
    variable: Any = ODVariable(entry.name, entry.index, entry.sub)
    variable.data_type, variable.pdo_mappable = entry.kind, entry.mappable
    variable.access_type = "rww" if entry.access == "rw" and entry.mappable else entry.access
    variable.default, variable.min, variable.max = entry.default, entry.low, entry.high
    return variable  # type: ignore[no-any-return]  # as above
