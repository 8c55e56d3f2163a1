"""The plan of a campaign: joints, profiles and repeats, from plan.toml or from the file of a hand, and its runs."""

from __future__ import annotations

import hashlib
import json
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any, Literal

from annotated_types import Unit
from pydantic import BaseModel, ConfigDict, Field

from hil.acquisition.commissioning import NOTHING_TURNS
from hil.errors import WrongUse, meant
from hil.hand import file as hand_file
from hil.printable import quoted
from hil.recording.input import read_text
from hil.stand.file import LARGEST, Stand
from hil.stand.sentences import names_the_value, sentence
from hil.stand.toml_table import line_of, load_table

Positive = Annotated[float, Field(gt=0.0, allow_inf_nan=False)]
Name = Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9 ._-]*$")]


class _Table(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class CampaignTable(_Table):
    """The table [campaign] of a plan: settings of the whole campaign.

    output: folder of all results, inside the plan's folder. model: as in `hil identify --model`, but no file. trials:
    number of independent searches. repeats: number of recordings of each joint with each profile. cool_down: pause
    before each recording except the first, s; no pause is made for a simulated joint. drift_check_every: number of
    recordings after which the first recording is repeated, 0 for never.
    """

    name: str = "campaign"
    output: str = "campaign"
    model: str = "auto"
    trials: Annotated[int, Field(ge=1)] | None = None
    repeats: Annotated[int, Field(ge=1, le=1000)] = 1
    cool_down: Annotated[float, Field(ge=0.0, le=86400.0, allow_inf_nan=False), Unit("s")] = 0.0
    drift_check_every: Annotated[int, Field(ge=0)] = 0


class ProfileTable(_Table):
    """A table [[profile]] of a plan: an excitation, with the options of `hil record`. amplitude: N m or rad. band:
    Hz.
    """

    name: Name
    kind: str = "chirp"
    amplitude: Positive | None = None
    band: tuple[Annotated[Positive, Unit("Hz")], Annotated[Positive, Unit("Hz")]] | None = None
    duration: Annotated[Positive, Unit("s")] = 20.0
    rate: Annotated[Positive, Unit("Hz")] = 500.0
    mode: Literal["torque", "position"] = "torque"
    fade: Annotated[float, Field(ge=0.0, allow_inf_nan=False), Unit("s")] = 1.0


class JointTable(_Table):
    """A table [[joint]] of a plan: a joint to be measured.

    stand: path of its stand file, relative to the plan's folder, or "sim". sim: parameters of a simulated joint.
    pretensions: labels such as "2 N"; before each one the person at the stand is asked to set that pretension. before:
    what the person must do before the joint's first recording.
    """

    name: Name
    stand: str = "sim"
    pretensions: tuple[Name, ...] = ()
    before: str = ""
    sim: dict[str, dict[str, float | bool | str]] = {}


class _File(_Table):
    campaign: CampaignTable = CampaignTable()
    profile: tuple[ProfileTable, ...] = (ProfileTable(name="chirp"),)
    joint: Annotated[tuple[JointTable, ...], Field(min_length=1)]


@dataclass(frozen=True, slots=True)
class Run:
    """One recording of the plan.

    repeat: number of the repeat, from 1. is_check: whether this recording repeats the first one to detect a drift. key:
    a hash of all settings. asks: instruction to the person at the stand before the recording, "" for none.
    """

    name: str
    joint: JointTable
    profile: ProfileTable
    pretension: str
    repeat: int
    path: Path
    key: str
    asks: str = ""
    is_check: bool = False

    @property
    def seed(self) -> int:
        """The seed of all random numbers in this run; different for each run."""
        return int.from_bytes(hashlib.sha256(self.name.encode()).digest()[:4])


@dataclass(frozen=True, slots=True)
class Plan:
    """A checked plan of a campaign. path: the plan's file. folder: the folder of all results. runs: the recordings in
    order. hand: the hand from whose file the plan follows, None for a plan.toml.
    """

    path: Path
    settings: CampaignTable
    folder: Path
    runs: tuple[Run, ...] = ()
    hand: hand_file.Hand | None = None

    @property
    def kind(self) -> str:
        """The name of the plan's command, which is also the name of the table with its settings."""
        return "campaign" if self.hand is None else "hand"

    def named(self, run: Run) -> str:
        """Return the name of a run, for a hand with the id of its servo."""
        stand = self.stand_of(run.joint)
        table = stand.devices.get(str(stand.stand.backend)) if isinstance(stand, Stand) else None
        ident = getattr(table, "id", None)
        return run.name if ident is None else f"{run.name} (servo {ident})"

    def stand_of(self, joint: JointTable) -> str | Path | Stand:
        """Return a joint's stand: of a hand the stand itself, of a plan.toml the path of its file, or "sim"."""
        if self.hand is not None:
            return self.hand.joint(joint.name).stand
        return "sim" if joint.stand == "sim" else self.path.parent / joint.stand

    def is_real(self, joint: JointTable) -> bool:
        """Return whether a joint's motor is taken for a real one, which has to cool down."""
        stand = self.stand_of(joint)
        return stand.stand.backend not in NOTHING_TURNS if isinstance(stand, Stand) else stand != "sim"

    def seconds(self, runs: Sequence[Run]) -> float:
        """Return the time that recordings and the cool-downs between them take, s."""
        waits = sum(self.settings.cool_down for run in runs[1:] if self.is_real(run.joint))
        return waits + sum(run.profile.duration for run in runs)


def load(path: Path, model: str | None = None) -> Plan:
    """Return the plan in a TOML file.

    model: replaces the plan's model; unlike the plan's it may be a Python file. Raises WrongUse with all errors of the
    file, each with its line and key, or if the plan would run a Python file or write outside its folder.
    """
    if hand_file.is_hand(read_text(path, largest=LARGEST)):
        raise WrongUse(f"{path} is the file of a hand, whose plan follows from it: hil hand {quoted(path)}")
    return _planned(path, load_table(path, _File, _message), model)


def of_hand(path: Path, model: str | None = None) -> Plan:
    """Return the plan that follows from the file of a hand: its joints in order, each with the excitation of [hand].

    model: as in `load`. Raises WrongUse with all errors of the file.
    """
    hand = hand_file.load(path)
    every = hand.settings.model_dump()
    settings = CampaignTable(**{key: every[key] for key in CampaignTable.model_fields if key in every})
    shape = {key: every[key] for key in ProfileTable.model_fields if key in every}
    profile = ProfileTable(**shape | {"name": hand.settings.kind})
    asks = {one.name: f"Lock {one.name}, and keep hands off." for one in hand.joints}
    joints = tuple(JointTable(name=name, stand=path.name, before=before) for name, before in asks.items())
    return _planned(path, _File(campaign=settings, profile=(profile,), joint=joints), model, hand)


def _planned(path: Path, file: _File, model: str | None, hand: hand_file.Hand | None = None) -> Plan:
    settings = file.campaign if model is None else file.campaign.model_copy(update={"model": model})
    plan = Plan(path, settings, path.parent / settings.output, hand=hand)
    _check_reach(plan, given=model is not None)
    return replace(plan, runs=tuple(_runs(plan, file)))


def _check_reach(plan: Plan, *, given: bool) -> None:
    """Raise WrongUse if the plan, which may come from somebody else, names a Python file or an output elsewhere.

    given: whether the person at this computer named the model.
    """
    model = plan.settings.model
    if ".py:" in model and not given:
        raise WrongUse(
            f"{plan.path}: {plan.kind}.model = {model!r} is a Python file, and a plan runs none: read that file, then "
            f"name it yourself: hil {plan.kind} {quoted(plan.path)} --model {quoted(model)}"
        )
    try:
        inside = plan.folder.resolve().is_relative_to(plan.path.parent.resolve())
    except (OSError, RuntimeError, ValueError):  # links in a circle, or a null character
        inside = False
    if not inside:
        raise WrongUse(
            f"{plan.path}: {plan.kind}.output = {plan.settings.output!r} is outside the plan's folder, and a plan "
            "writes nothing there: name a folder inside it, or move the plan"
        )


def _runs(plan: Plan, file: _File) -> Iterator[Run]:
    for what, tables in (("joint", file.joint), ("profile", file.profile)):
        names = [table.name for table in tables]
        if twice := next((name for name in names if names.count(name) > 1), None):
            raise WrongUse(f"{plan.path}: two [[{what}]] have the name {twice!r}: their recordings would be one file")
    every, first = file.campaign.drift_check_every, None
    runs = list(_each_run(plan, file))
    name, count = Counter(run.name for run in runs).most_common(1)[0]
    if count > 1:
        raise WrongUse(f"{plan.path}: two recordings would have the name {name!r}: rename a joint or a profile")
    for count, run in enumerate(runs, 1):
        first = first or run
        yield run
        if every and count % every == 0 and run is not first:
            number = count // every
            settings = (first.joint, first.profile, first.pretension)
            yield _run(plan, settings, number, prefix="drift-check", is_check=True)


def _each_run(plan: Plan, file: _File) -> Iterator[Run]:
    for joint in file.joint:
        asks = joint.before
        for pretension in joint.pretensions or ("",):
            if pretension:
                asks = f"{asks} Set the pretension of {joint.name} to {pretension}.".strip()
            for profile in file.profile:
                for repeat in range(1, file.campaign.repeats + 1):
                    yield _run(plan, (joint, profile, pretension), repeat, asks=asks)
                    asks = ""


def _run(
    plan: Plan,
    of: tuple[JointTable, ProfileTable, str],
    repeat: int,
    *,
    prefix: str = "",
    asks: str = "",
    is_check: bool = False,
) -> Run:
    joint, profile, pretension = of
    words = [word.replace(" ", "-") for word in (prefix, joint.name, profile.name, pretension) if word]
    name = "_".join([*words, str(repeat)])
    stated = [joint.model_dump(exclude={"before"}), profile.model_dump(), pretension]
    stand = plan.stand_of(joint)
    if isinstance(stand, Stand):  # an edit of the hand's file is an edit of the plan; a note of a calibration is not
        alone = stand.stand.model_copy(update={"hand_ids": {}})  # another joint's corrected id is no edit of this one
        stated += [repr((alone, stand.limits, stand.devices, stand.sensor))]
    settings = json.dumps(stated, sort_keys=True)
    key = hashlib.sha256(settings.encode()).hexdigest()[:16]
    return Run(name, joint, profile, pretension, repeat, plan.folder / f"{name}.h5", key, asks, is_check)


def _message(text: str, item: Any) -> str:
    """Return line, key and a sentence for one error in a pydantic ValidationError."""
    place = list(item["loc"])
    key = ".".join(str(part) for part in place if isinstance(part, str))
    value = f" = {item['input']!r}" if names_the_value(item) else ""
    hint = ""
    if item["type"] == "extra_forbidden":
        hint = f": {meant(str(place[-1]), _keys(place)).strip() or 'there are ' + ', '.join(_keys(place))}"
    if item["type"] == "string_pattern_mismatch":
        return f"line {line_of(text, place)}: {key}{value}: must be letters, digits, spaces and . _ -"
    return f"line {line_of(text, place)}: {key}{value}: {sentence(item)}{hint}"


def _keys(place: list[Any]) -> list[str]:
    tables: dict[str, type[BaseModel]] = {"campaign": CampaignTable, "profile": ProfileTable, "joint": JointTable}
    return list((_File if len(place) == 1 else tables.get(str(place[0]), _File)).model_fields)
