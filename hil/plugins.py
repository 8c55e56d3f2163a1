"""Drives and models of other packages: their entry points, each loaded at its first use."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from importlib.metadata import EntryPoint, entry_points
from typing import Any

from hil.errors import WrongUse

BACKENDS, MODELS = "hil.backends", "hil.models"
"""The groups of entry points."""


@dataclass(frozen=True, slots=True)
class Plugin:
    """One entry point, not loaded yet."""

    point: EntryPoint

    @property
    def package(self) -> str:
        """The package that it comes from, with its version."""
        return "an unnamed package" if self.point.dist is None else f"{self.point.dist.name} {self.point.dist.version}"

    def load(self, *kinds: type) -> Any:
        """Return what it names, of one of these kinds. Raises WrongUse if it cannot be loaded."""
        try:
            found = self.point.load()
        except (Exception, SystemExit) as error:
            raise self._broken(f"{type(error).__name__}: {error}") from error
        if not isinstance(found, kinds):
            raise self._broken(f"{self.point.value} is no {' or '.join(kind.__name__ for kind in kinds)}")
        return found

    def _broken(self, why: str) -> WrongUse:
        return WrongUse(
            f"{self.point.name!r} of the package {self.package} cannot be loaded ({why}): update or remove the package"
        )


@cache
def plugins(group: str) -> dict[str, Plugin]:
    """Return the entry points of a group by name; of two with one name, the first on the search path."""
    found: dict[str, Plugin] = {}
    for point in entry_points(group=group):
        found.setdefault(point.name, Plugin(point))
    return found
