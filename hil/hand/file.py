"""The file of a hand, hand.toml: tables that its joints share, and for each motor a [[joint]] that overrides them.

A joint expands to the text of an ordinary stand file, which the ordinary parser checks. Errors have the line of the
hand's file.
"""

from __future__ import annotations

import copy
import tomllib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from types import MappingProxyType
from typing import Annotated, Any, Literal

from annotated_types import Unit
from pydantic import BaseModel, ConfigDict, Field

from hil.errors import WrongUse, meant, unknown
from hil.hand.palm import Tendon, yields
from hil.printable import quoted
from hil.quantities import Place
from hil.recording.input import read_text
from hil.stand import file as stand_file
from hil.stand.file import LARGEST, Error, Positive, Stand, examined, implausible, joints_in, validated
from hil.stand.toml_table import LISTED, errors_in, line_of, parsed

_Name = Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9._-]*$")]

_NO_MOTOR = frozenset({"sim", "replay"})  # several joints may name the same one


class _Table(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class HandTable(_Table):
    """[hand]: what holds for all joints of a hand.

    backend: of every joint that names none. output: folder of all results, inside the hand file's folder. model: as in
    `hil identify --model`, but no file. trials: number of independent searches. repeats: number of recordings of each
    joint. cool_down: pause before each recording of a real motor except the first, s. kind, band (Hz), duration (s),
    rate (Hz), mode: the excitation, as in `hil record`; its amplitude is a fifth of each joint's own limit.
    """

    name: str = "hand"
    backend: str | None = None
    output: str = "hand"
    model: str = "auto"
    trials: Annotated[int, Field(ge=1)] | None = None
    repeats: Annotated[int, Field(ge=1, le=1000)] = 2
    cool_down: Annotated[float, Field(ge=0.0, le=86400.0, allow_inf_nan=False), Unit("s")] = 0.0
    kind: str = "chirp"
    band: tuple[Annotated[Positive, Unit("Hz")], Annotated[Positive, Unit("Hz")]] | None = None
    duration: Annotated[Positive, Unit("s")] = 20.0
    rate: Annotated[Positive, Unit("Hz")] = 500.0
    mode: Literal["torque", "position"] = "torque"


class JointTable(_Table):
    """The keys of a [[joint]] that are no keys of a stand file.

    name: of the joint, in file names and in a model of the hand. moves: the motor's own joint, if that has another
    name: two motors that pull one joint both name it. also_moves: the turns of further joints for one turn of the
    motor's own joint, with their sign. routing_uncertainty: relative standard uncertainty of these ratios.
    """

    name: _Name
    moves: _Name | None = None
    also_moves: dict[str, Annotated[float, Field(allow_inf_nan=False)]] = {}
    routing_uncertainty: Annotated[float, Field(ge=0.0, le=1.0, allow_inf_nan=False)] = 0.0

    @property
    def joint(self) -> str:
        """The joint that the motor turns."""
        return self.moves or self.name

    @property
    def row(self) -> dict[str, float]:
        """The turns of every joint that the motor turns, for one turn of its own."""
        return {self.joint: 1.0, **self.also_moves}


class _File(_Table):
    hand: HandTable = HandTable()
    joint: list[JointTable]


@dataclass(frozen=True, slots=True)
class HandJoint:
    """One motor of a hand.

    stand: an ordinary stand, whose `text` has all keys that hold for this joint. also_moves: by the name of another
    joint, its turns for one turn of this motor's own joint (signed). routing_uncertainty: relative standard uncertainty
    of each of these ratios. moves: the motor's own joint.
    """

    name: str
    stand: Stand
    also_moves: Mapping[str, float]
    routing_uncertainty: float
    moves: str


@dataclass(frozen=True, slots=True)
class Hand:
    """A checked hand file. path: None if the hand was not read from a file. text: the file as written. joints: in the
    file's order.
    """

    name: str
    path: Path | None
    text: str
    joints: tuple[HandJoint, ...]
    settings: HandTable

    def joint(self, name: str) -> HandJoint:
        """Return the joint of this name. Raises WrongUse, with all names, if there is none."""
        for joint in self.joints:
            if joint.name == name:
                return joint
        raise unknown("joint", name, [joint.name for joint in self.joints])


def is_hand(text: str) -> bool:
    """Return whether a text is the file of a hand: it has [hand], or [[joint]] tables and is no plan of a campaign."""
    try:
        return bool(joints_in(tomllib.loads(text)))
    except (ValueError, RecursionError):
        return False


def load(path: Path) -> Hand:
    """Return the hand in a TOML file. Raises WrongUse with all errors of the file, each with its line and key."""
    hand = parse(read_text(path, largest=LARGEST), str(path))
    joints = tuple(replace(one, stand=replace(one.stand, path=path)) for one in hand.joints)
    return replace(hand, path=path, joints=joints)


def load_stand(path: Path, joint: str | None = None) -> Stand:
    """Return the stand in a stand file, or that of `joint` in the file of a hand.

    Raises WrongUse if the file is a hand's and no joint is given, and for a joint in an ordinary stand file.
    """
    return stand_file.load(path) if joint is None else load(path).joint(joint).stand


def parse(text: str, name: str = "hand.toml") -> Hand:
    """Return the hand in `text`. Raises WrongUse with all errors, each with its line and key. name: of the file, for
    messages.
    """
    table = parsed(text, name)
    joints = _joint_tables(table, name)
    file, errors = validated({"hand": table.get("hand", {}), "joint": [_own_keys(one) for one in joints]}, _File)
    if not errors:
        errors = list(_misnamed(file.joint))
    if errors:
        raise _wrong(name, [(line_of(text, list(place)), said) for place, said in errors])
    expanded = _Expanded(text, name, table, file)
    stands = expanded.stands()
    expanded.check_addresses(stands)
    pairs = list(zip(file.joint, stands, strict=True))
    turns = yields([Tendon(one.name, s.stand.gear_ratio, one.joint, one.row, s.sim.fixture) for one, s in pairs])
    stands = [replace(_with_hand_ids(stand, stands), yields=turns[one.name]) for one, stand in pairs]
    made = [
        HandJoint(keys.name, stand, MappingProxyType(dict(keys.also_moves)), keys.routing_uncertainty, keys.joint)
        for keys, stand in zip(file.joint, stands, strict=True)
    ]
    return Hand(file.hand.name, None, text, tuple(made), file.hand)


def _joint_tables(table: dict[str, Any], name: str) -> list[dict[str, Any]]:
    """Return the [[joint]] tables of a hand file. Raises WrongUse if it has none, or is another kind of file."""
    if "campaign" in table or "profile" in table:
        raise WrongUse(
            f"{name} is the plan of a campaign, not the file of a hand: run it with hil campaign {quoted(name)}"
        )
    joints = table.get("joint")
    if isinstance(joints, list) and joints and all(isinstance(one, dict) for one in joints):
        return joints
    if joints is None and "hand" not in table and "stand" in table:
        raise WrongUse(
            f"{name} is the stand file of one joint, and this needs the file of a hand, with a [[joint]] for each "
            "motor: hil stand new --scan PORT -o hand.toml writes it; the one joint is recorded with "
            f"hil record --stand {quoted(name)}"
        )
    raise WrongUse(f"{name} names no joint: add a table [[joint]] with name = ... for each motor of the hand")


def _own_keys(joint: dict[str, Any]) -> dict[str, Any]:
    return {key: value for key, value in joint.items() if key in JointTable.model_fields}


def _misnamed(joints: Sequence[JointTable]) -> Iterator[Error]:
    """Yield an error for each name that two joints have, and each `also_moves` that no hand can have."""
    names, known = [joint.name for joint in joints], list(dict.fromkeys(joint.joint for joint in joints))
    moves = {name: [more for one in joints if one.joint == name for more in one.also_moves] for name in known}
    for at, joint in enumerate(joints):
        if joint.name in names[:at]:
            yield ("joint", at, "name"), f"two joints have the name {joint.name!r}: give each its own name"
            continue
        for name, ratio in joint.also_moves.items():
            place: Place = ("joint", at, "also_moves", name)
            where = f"joint {joint.name}: also_moves"
            if name not in known:
                yield place, f"{where}: {unknown('joint', name, [one for one in known if one != joint.joint])}"
            elif name == joint.joint:
                yield place, f"{where} names the joint itself, whose ratio is 1: state its gear in stand.gear_ratio"
            elif not ratio:
                yield place, f"{where}: {name} = 0 moves nothing: remove it"
            elif circle := _way(moves, name, joint.joint):
                said = ", which moves ".join([name, *circle])
                yield (
                    place,
                    f"{where} goes in a circle: {joint.joint} moves {said}. A tendon that passes a joint on its way to "
                    "its own turns that joint, not the reverse: remove one of these",
                )


def _way(moves: Mapping[str, Sequence[str]], start: str, end: str) -> list[str]:
    """Return the joints behind `start` on the shortest way to `end` along `also_moves`, with `end`; [] if there is
    none.
    """
    ways, known = [[start]], {start}
    for way in ways:
        for name in moves.get(way[-1], ()):
            if name == end:
                return [*way[1:], name]
            if name not in known:
                known.add(name)
                ways.append([*way, name])
    return []


@dataclass(frozen=True, slots=True)
class _Expanded:
    """The text and the tables of a hand file, of which ordinary stands are made. name: of the file, for messages."""

    text: str
    name: str
    table: Mapping[str, Any]
    file: _File

    def stands(self) -> list[Stand]:
        """Return the stand of each joint. Raises WrongUse with the errors of all of them.

        An error in a key that joints share is listed once.
        """
        found: list[Stand] = []
        wrong: dict[tuple[int, str], list[str]] = {}
        for at, keys in enumerate(self.file.joint):
            stand, errors = self._stand(at)
            for place, said in errors:
                wrong.setdefault((self._line(at, place), said), []).append(keys.name)
            found += [] if stand is None else [replace(stand, joint=keys.name)]
        if wrong:
            every = len(self.file.joint)
            lines = [
                (line, said if len(names) == every > 1 else f"joint {', '.join(names)}: {said}")
                for (line, said), names in wrong.items()
            ]
            raise _wrong(self.name, lines)
        return found

    def check_addresses(self, stands: Sequence[Stand]) -> None:
        """Raise WrongUse if two joints have the same motor: the same id on the same bus, or the same port."""
        wrong, first = [], dict[tuple[object, ...], int]()
        for at, stand in enumerate(stands):
            backend = str(stand.stand.backend)
            link, ident = _address(stand)
            if not any(link):
                continue
            before = first.setdefault((*link, ident), at)
            if before != at:
                key = "port" if ident is None else "id"
                names = " and ".join(self.file.joint[one].name for one in (before, at))
                said = f"joints {names} both have {backend}.{key} = {link[0] if ident is None else ident}"
                wrong.append((self._line(at, (backend, key)), f"{said}, the same motor: correct one of them"))
        if wrong:
            raise _wrong(self.name, wrong)

    def _stand(self, at: int) -> tuple[Stand | None, list[Error]]:
        """Return the stand of a joint, None if it has errors, and the errors."""
        import tomlkit

        shared = {key: value for key, value in self.table.items() if key not in {"hand", "joint"}}
        merged = _merged(shared, self._overrides(at))
        stand = merged.setdefault("stand", {})
        joint, hand = self.file.joint[at], self.file.hand
        if isinstance(stand, dict):
            stand.setdefault("name", f"{hand.name}, {joint.name}")
            if hand.backend is not None:
                stand.setdefault("backend", hand.backend)
        text = tomlkit.dumps(merged)
        made, errors = examined(merged, text)
        return made, [_with_hint(*one) for one in errors] if made is None else implausible(made)

    def _overrides(self, at: int) -> dict[str, Any]:
        joint: dict[str, Any] = self.table["joint"][at]
        return {key: value for key, value in joint.items() if key not in JointTable.model_fields}

    def _line(self, at: int, place: Place) -> int:
        """Return the line of the key `place` of a joint's stand: in its [[joint]], or in the table that joints share.

        A key that is missing has the line of the [[joint]] if another joint states it, else of the shared table.
        """
        if place == ("stand", "backend") and "backend" in self.table.get("hand", {}):
            place = ("hand", "backend")
        others = range(len(self.file.joint))
        in_joint = _has(self._overrides(at), place) or (
            not _has(self.table, place) and any(_has(self._overrides(one), place) for one in others)
        )
        return line_of(self.text, ["joint", at, *place] if in_joint else list(place))


def _address(stand: Stand) -> tuple[tuple[object, ...], int | None]:
    """Return the link of a stand's motor, which holds nothing for a motor without one, and the motor's id on it."""
    backend = str(stand.stand.backend)
    device = None if backend in _NO_MOTOR else stand.devices.get(backend)
    return tuple(getattr(device, key, None) for key in ("port", "interface", "channel")), getattr(device, "id", None)


def _with_hand_ids(stand: Stand, stands: Sequence[Stand]) -> Stand:
    """Return `stand` with the ids of all motors of the hand on its bus, whose torque is switched off with its own."""
    import tomlkit

    link, _ = _address(stand)
    alike = [one for one in stands if one.stand.backend == stand.stand.backend and _address(one)[0] == link]
    ids = {one.joint: ident for one in alike if (ident := _address(one)[1]) is not None}
    if not ids:
        return stand
    document: Any = tomlkit.parse(stand.text)
    document["stand"]["hand_ids"] = ids
    return replace(stand, stand=stand.stand.model_copy(update={"hand_ids": ids}), text=tomlkit.dumps(document))


def _merged(shared: Mapping[str, Any], overrides: Mapping[str, Any]) -> dict[str, Any]:
    """Return a copy of the shared tables in which each key of `overrides` replaces the shared one."""
    found = copy.deepcopy(dict(shared))
    for key, value in overrides.items():
        both_tables = isinstance(value, dict) and isinstance(found.get(key), dict)
        found[key] = _merged(found[key], value) if both_tables else copy.deepcopy(value)
    return found


def _with_hint(place: Place, said: str) -> Error:
    """Return an error of a stand; for an unknown key that is similar to a key of [[joint]], with that key."""
    near = meant(str(place[0]), JointTable.model_fields).strip() if said == f"{place[0]}: no such key" else ""
    return place, f"{said}; {near}" if near else said


def _has(table: Mapping[str, Any], place: Place) -> bool:
    inner: Any = table
    for key in place:
        try:
            inner = inner[key]
        except (KeyError, IndexError, TypeError):
            return False
    return True


def _wrong(name: str, lines: Sequence[tuple[int, str]]) -> WrongUse:
    """Return the error with these lines and sentences about the hand file `name`."""
    return errors_in(name, [f"line {at}: {said}" for at, said in sorted(lines)[:LISTED]], len(lines))
