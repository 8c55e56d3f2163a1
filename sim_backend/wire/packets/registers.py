"""The memory of an emulated servo: bytes, and a table of the items that they hold."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal


@dataclass(frozen=True, slots=True)
class Item:
    """An item of a control table.

    low, high: the range of values that may be written. sign_bit: the bit that means negative, among the bits of the
    magnitude; 0: two's complement if `low` is negative, else unsigned. writable: whether it may be written.
    """

    address: int
    size: int
    name: str
    initial: int = 0
    low: int = 0
    high: int = 0
    sign_bit: int = 0
    writable: bool = True


def items_of(*tables: Mapping[str, Sequence[Any]], initial: Mapping[str, int]) -> tuple[Item, ...]:
    """Return the items of the tables of table.toml, whose columns are: address, bytes, r or rw, initial value, low,
    high, sign bit.

    initial: initial values by name that replace those of the tables.
    """
    items = []
    for name, (address, size, access, *more) in (row for table in tables for row in table.items()):
        item = Item(address, size, name, *more)
        items.append(replace(item, initial=initial.get(name, item.initial), writable=access == "rw"))
    return tuple(items)


class Registers:
    """The memory of one servo, with the items at their initial values. big: whether words have the high byte first.

    memory: the bytes; an address without an item holds zero.
    """

    def __init__(self, items: tuple[Item, ...], *, big: bool = False) -> None:
        self.items = {item.address: item for item in items}
        self.memory = bytearray(max(item.address + item.size for item in items))
        self._named = {item.name: item for item in items}
        self._order: Literal["big", "little"] = "big" if big else "little"
        self.reset()

    def reset(self, first: int = 0) -> None:
        """Set the items at addresses from `first` on to their initial values."""
        for item in self.items.values():
            if item.address >= first:
                self.store(item, item.initial)

    def has(self, name: str) -> bool:
        """Return whether this model has the item."""
        return name in self._named

    def item(self, name: str) -> Item | None:
        """Return an item; None if the model has no item of this name."""
        return self._named.get(name)

    def get(self, name: str) -> int:
        """Return the value of an item; 0 if the model has no item of this name."""
        item = self._named.get(name)
        return 0 if item is None else self.value(item)

    def put(self, name: str, value: int) -> None:
        """Set an item as the servo's own firmware does, without access rules. Has no effect if the model has no item of
        this name.
        """
        if name in self._named:
            self.store(self._named[name], value)

    def value(self, item: Item) -> int:
        """Return the value of `item`."""
        return self.decoded(item, self.memory[item.address : item.address + item.size])

    def decoded(self, item: Item, data: bytes | bytearray) -> int:
        """Decode the bytes `data` of `item`."""
        if not item.sign_bit:
            return int.from_bytes(data, self._order, signed=item.low < 0)
        raw = int.from_bytes(data, self._order)
        low = (1 << item.sign_bit) - 1
        magnitude = raw >> 1 & ~low | raw & low
        return -magnitude if raw >> item.sign_bit & 1 else magnitude

    def store(self, item: Item, value: int) -> None:
        """Write as many low bits of `value` as `item` holds, without access rules."""
        if item.sign_bit:
            low = (1 << item.sign_bit) - 1
            value = (abs(value) & ~low) << 1 | (abs(value) & low) | (low + 1 if value < 0 else 0)
        raw = (value % (1 << 8 * item.size)).to_bytes(item.size, self._order)
        self.memory[item.address : item.address + item.size] = raw

    def covered(
        self, address: int, data: bytes, behind: Callable[[int], int] = lambda address: address
    ) -> Iterator[tuple[Item | None, bytes]]:
        """Yield each item that a write of `data` to `address` covers, with its bytes; an item that is cut off at the
        end has too few bytes.

        A byte without an item is yielded alone, with None. behind: a function that returns the address which is
        accessed through an address (indirect addressing).
        """
        at = 0
        while at < len(data):
            item = self.items.get(behind(address + at))
            size = item.size if item is not None else 1
            yield item, bytes(data[at : at + size])
            at += size
