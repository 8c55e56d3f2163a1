"""Find further joints in an imported table, and how far their motion repeats that of the joint."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hil.errors import WrongUse
from hil.exchange.columns import Table
from hil.exchange.headings import listed, unit_of
from hil.exchange.row_filter import RowFilter
from hil.signals.constants import UNCERTAIN

Words = list[str]

_WORDS = re.compile(r"[A-Z]?[a-z]+|[A-Z]+|\d+|[^A-Za-z\d]+")
# such columns are of the same joint: set-points, filters, both sides of a transmission, derivatives, components
_SAME_JOINT = re.compile(
    r"cmd|command(ed)?|des(ired)?|d|ref(erence)?|set|setpoint|sp|target|goal|raw|filt(ered)?|lp|meas(ured)?|act(ual)?|"
    r"est(imated)?|fb|feedback|sim|model|motor|m|joint|j|link|l|load|in(put)?|out(put)?|cell|sensor|drive|err(or)?|diff|"
    r"vel(ocity)?|speed|rate|acc(eleration)?|dot|[xyz]|time",
    re.IGNORECASE,
)
_REPEATS = 0.5  # squared multiple correlation, from which columns that may be of another joint are named
_COPY = 1e-6  # one less that, below which a column is a copy of the deflection


@dataclass(frozen=True, slots=True)
class OtherJoints:
    """Columns that are of other joints. names: their headings. certain: whether they surely are. repeats: squared
    multiple correlation of the deflection with these columns and their rates. follow: the sum of their mean changes
    over that of the deflection. A coupling to them that is as stiff as Kc would change Kc by this factor.
    """

    names: str
    certain: bool
    repeats: float
    follow: float

    @property
    def attributes(self) -> dict[str, str | float]:
        """Return the attributes of a recording's profile from which identification knows these joints."""
        if not self.certain:
            return {}
        return {"other_joints": self.names, "other_joints_repeat": self.repeats, "other_joints_follow": self.follow}

    @property
    def message(self) -> str:
        """Return the warning of an import."""
        said = f"the motion of {self.names} explains {self.repeats:.1%} of that of the deflection"
        if self.certain:
            return f"{said}, so that Kc contains the coupling to them. Record with the other joints at rest"
        return (
            f"{said}. If these are other joints, Kc contains the coupling to them: record with the other joints at "
            "rest. If they are of this joint, Kc is not affected; name a set-point with --command"
        )


def other_joints(
    table: Table,
    used: Sequence[str],
    titles: Sequence[str],
    rows: NDArray[np.int64] | None,
    where: Sequence[RowFilter],
) -> OtherJoints | None:
    """Return the columns of other joints whose motion repeats that of this joint; None if there are none.

    table: that of the deflection. used: headings of deflection, torque and the other imported columns. titles: all
    headings, of two joined files those of both. rows: numbers of the imported rows, None for all.
    Columns are surely of another joint if the same change of the deflection's and of the torque's heading gives two
    headings of the table, such as "q2" and "tau2" for "q1" and "tau1". They may be of another joint if only another
    number makes them differ from the deflection's heading, or if they have the unit of an angle.
    """
    groups: dict[bool, list[str]] = {True: [], False: []}
    for title in table.titles:
        if title not in used and (is_certain := _is_other_joint(title, used, titles)) is not None:
            groups[is_certain].append(title)
    for is_certain, names in groups.items():
        if not names:
            continue
        with suppress(WrongUse):  # a column that holds no numbers
            read, places = table.read([used[0], *names], where)
            read = read if rows is None else read[:, np.isin(places, rows)]
            found = _compared(names, read, is_certain=is_certain)
            if found is not None:
                return found
    return None


def _is_other_joint(title: str, used: Sequence[str], titles: Sequence[str]) -> bool | None:
    """Return whether a column is surely of another joint; None if it is of this joint, or no angle."""
    own, other, torque = (_WORDS.findall(one) for one in (used[0], title, used[1]))
    if any(_SAME_JOINT.fullmatch(word) for word in other if word not in own):
        return None
    while own and other and own[0] == other[0]:
        own, other = own[1:], other[1:]
    while own and other and own[-1] == other[-1]:
        own, other = own[:-1], other[:-1]
    if any(one in titles and one not in used for one in _replaced(torque, own, other)):
        return None if any(map(_SAME_JOINT.fullmatch, own)) else True
    if "".join(own + other).isdigit():
        return False
    with suppress(WrongUse):
        return False if unit_of(title, "angle") else None
    return None


def _replaced(words: Words, before: Words, after: Words) -> Iterator[str]:
    """Yield the heading of these words with the words `before` replaced by `after`, at each place where they stand."""
    for at in range(len(words) - len(before) + 1):
        if words[at : at + len(before)] == before:
            yield "".join([*words[:at], *after, *words[at + len(before) :]])


def _compared(names: list[str], read: NDArray[np.float64], *, is_certain: bool) -> OtherJoints | None:
    """Return the comparison of columns (k, n) with the deflection, which is the first of them; None if they hardly
    follow it, or repeat it exactly.
    """
    read = read[:, np.isfinite(read).all(axis=0)]
    angle, *others = read - read.mean(axis=1, keepdims=True)
    power = float(angle @ angle)
    if not power or len(angle) <= 2 * len(names):
        return None
    columns = np.stack([*others, *np.gradient(np.array(others), axis=1)], axis=1)
    columns = columns / np.maximum(np.linalg.norm(columns, axis=0), 1e-300)
    left = angle - columns @ np.linalg.lstsq(columns, angle, rcond=None)[0]
    repeats, follow = 1.0 - float(left @ left) / power, float(np.abs(np.array(others) @ angle).sum()) / power
    matters = follow > UNCERTAIN if is_certain else _REPEATS < repeats < 1.0 - _COPY
    return OtherJoints(listed(names), is_certain, repeats, follow) if matters else None
