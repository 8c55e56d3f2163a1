"""Change settings of a device for a run: write a setting, read it back, and restore its earlier value at the end."""

from __future__ import annotations

import operator
from collections.abc import Callable
from typing import Generic, TypeVar

from drivers.servo import DriverError

Key = TypeVar("Key")
Value = TypeVar("Value")


class Settings(Generic[Key, Value]):
    """The settings of one device, which the functions `read` and `write` access.

    same: a function that returns whether the value in the device equals the written value. kept: a function that
    returns whether a setting must be restored at the end, because the device stores it without power or a later program
    relies on it. journal: a function that is called before each write of a setting that will be restored; `changed`
    already holds the setting's old value then. Every method raises what `read` and `write` raise.
    """

    def __init__(
        self,
        read: Callable[[Key], Value],
        write: Callable[[Key, Value], None],
        *,
        same: Callable[[Value, Value], bool] = operator.eq,
        kept: Callable[[Key], bool] = lambda _key: True,
    ) -> None:
        self._read = read
        self._write = write
        self._same = same
        self._kept = kept
        self._before: dict[Key, Value] = {}
        self.journal: Callable[[], None] = lambda: None

    def require(self, key: Key, value: Value, name: str = "", before: Value | None = None) -> None:
        """Write `value` to the setting `key` and read it back. A setting that already has this value is not written.

        name: name of the setting in messages; "" for `key` itself. before: the present value, for a setting that cannot
        be read yet. Raises DriverError if the device then holds another value.
        """
        before = self._read(key) if before is None else before
        if self._same(before, value):
            return
        if self._kept(key):
            self._before.setdefault(key, before)
            self.journal()
        self._write(key, value)
        now = self._read(key)
        if not self._same(now, value):
            raise DriverError(
                f"the device keeps {_shown(now)} in {name or key} where {_shown(value)} was written: "
                "it is not safe to go on, nothing was armed"
            )

    def changed(self) -> list[tuple[Key, Value]]:
        """Return the settings that `restore` will write, with their earlier values, in the order of writing."""
        return list(reversed(self._before.items()))

    def restore(self) -> None:
        """Restore the settings that `require` changed, the newest first. A setting that the device refuses to restore
        is skipped.
        """
        while self._before:
            key, value = self._before.popitem()
            try:
                self._write(key, value)
            except DriverError:
                continue  # one setting that cannot be restored must not keep the others from it


def _shown(value: object) -> str:
    if isinstance(value, bytes):
        return str(int.from_bytes(value, "little", signed=True))
    return f"{value:g}" if isinstance(value, float) else str(value)
