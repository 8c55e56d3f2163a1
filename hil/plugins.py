"""Drives and models that other packages add by entry points, each loaded at its first use."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from importlib.metadata import EntryPoint, entry_points
from typing import Any

from hil.errors import WrongUse

BACKENDS, MODELS = "hil.backends", "hil.models"
"""The names of the two groups of entry points: for servos and for models."""


@dataclass(frozen=True, slots=True)
class Plugin:
    """The entry point of a drive or model in another package, not loaded yet."""

    point: EntryPoint

    @property
    def package(self) -> str:
        """The name and the version of the package that defines this entry point."""
        return "an unnamed package" if self.point.dist is None else f"{self.point.dist.name} {self.point.dist.version}"

    def load(self, *kinds: type) -> Any:
        """Load and return the object of this entry point. Raises WrongUse if it cannot be loaded, or is of none of
        `kinds`.
        """
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


def plugins(group: str) -> dict[str, Plugin]:
    """Return the entry points of a group by name. If two have the same name, the first on the search path is
    returned.
    """
    return installed().get(group, {})


@cache
def installed() -> dict[str, dict[str, Plugin]]:
    """Return the entry points of both groups. One search reads a file of every installed package."""
    every, found = entry_points(), dict[str, dict[str, Plugin]]()
    for group in (BACKENDS, MODELS):
        for point in every.select(group=group):
            found.setdefault(group, {}).setdefault(point.name, Plugin(point))
    return found
