"""A new stand.toml: the questions to the user, and the commented file that is made from the answers."""

from __future__ import annotations

import dataclasses
import json
import re
import textwrap
import tomllib
from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from pydantic import TypeAdapter, ValidationError

from hil.quantities import choices, in_si
from hil.stand.devices import BACKENDS, SENSORS
from hil.stand.file import LimitsTable, StandTable
from hil.stand.sentences import sentence

_UNKNOWN = object()


@dataclass(frozen=True, slots=True)
class Question:
    """A question for one key of the stand file.

    table, name: of the key. meaning: explanation for the user. default: None if the user must answer.
    """

    table: str
    name: str
    meaning: str
    default: Any

    @property
    def key(self) -> str:
        """The key as messages state it: table.name."""
        return f"{self.table}.{self.name}"


_STAND = (
    Question("stand", "name", "what you call it", "my stand"),
    Question("stand", "gear_ratio", "motor turns (or turns of the servo's horn) for one of the joint", 1.0),
    Question("stand", "motor_inertia", "kg m^2, at the motor shaft; 0 where not known", 0.0),
    Question("stand", "motor_damping", "N m s/rad, at the motor shaft; 0 where not known", 0.0),
    Question(
        "stand",
        "torque_source",
        '"joint": a torque cell at the locked joint; "motor": inferred from its own',
        "motor",
    ),
)
_LIMITS = (
    Question("limits", "torque", "N m", 0.02),
    Question("limits", "deflection", "rad", 0.5),
    Question("limits", "velocity", "rad/s", 20.0),
    Question("limits", "temperature", "degC, of the winding", 60.0),
)
_ACCEPTED = Question(
    "stand",
    "torque_stays_on_if_host_dies",
    "true: drive a motor without a watchdog, which keeps its torque when this computer stops",
    (False,),
)
_TABLES: Mapping[str, Any] = {"stand": StandTable, "limits": LimitsTable}


@dataclass(frozen=True, slots=True)
class Draft:
    """A new stand file for the servo `backend` and the joint sensor `sensor` (None: without a joint sensor)."""

    backend: str
    sensor: str | None

    def questions(self) -> list[Question]:
        """Return the questions to ask: those about the stand and the limits, and those about the device that have no
        default.
        """
        return [*_STAND, *(q for q in self._device_questions() if q.default is None), *_LIMITS]

    def answers(self, question: Question) -> list[str]:
        """Return the known answers to a question: the values that its key can have, or the ports and interfaces of this
        computer, each with the connected device in brackets.
        """
        from drivers.ports import can_interfaces, serial_ports

        if question.name == "interface":
            from drivers.canbus.link import interfaces

            return interfaces()
        ports = serial_ports() if question.name in {"port", "channel"} else []
        ports += can_interfaces() if question.name == "channel" else []
        named = [f"{one.name} ({one.described})" if one.described else one.name for one in ports]
        return [*choices(self._class_of(question.table), question.name), *named]

    def error(self, question: Question, value: Any) -> str:
        """Return why `value` is not valid as the answer to a question, "" if it is valid."""
        table, wrong = in_si({question.name: value}, self._class_of(question.table))
        if wrong:
            return next(iter(wrong.values()))
        try:
            TypeAdapter(self._class_of(question.table)).validate_python(table)
        except ValidationError as error:
            for item in error.errors():
                if item["loc"][:1] == (question.name,):
                    return sentence(item)
        return ""

    def value(self, question: Question, text: str) -> Any:
        """Return the text of an answer as a number if the key takes a number, otherwise as text."""
        try:
            value = tomllib.loads(f"x = {text}")["x"]
        except tomllib.TOMLDecodeError:
            return text
        return text if self.error(question, value) and not self.error(question, text) else value

    def question(self, key: str) -> Question | None:
        """Return the question for a key, `table.name`; None if there is no such key."""
        return self._by_key().get(key)

    def keys(self) -> list[str]:
        """Return the keys of all questions."""
        return list(self._by_key())

    def text(self, answers: Mapping[str, Any]) -> str:
        """Return the text of the stand file.

        answers: values by key. A key without an answer gets its default; a default of the device is written as a
        comment.
        """
        head = [
            "# hil doctor checks it. For completion in an editor: hil stand schema > stand.schema.json",
            "#:schema ./stand.schema.json",
        ]
        return "\n".join([*head, *self.tables(answers)]) + "\n"

    def tables(self, answers: Mapping[str, Any], without: Collection[str] = ()) -> list[str]:
        """Return the lines of all tables, as `text` has them. without: keys that are left out."""
        lines = ["", "[stand]"]
        if "stand.backend" not in without:
            lines.append(f"backend = {toml(self.backend)}")
        lines += _lines([one for one in _STAND if one.key not in without], answers)
        lines += _lines([_ACCEPTED], answers, optional=True)
        mine = [one for one in self._device_questions() if one.key not in without]
        for table in dict.fromkeys(question.table for question in mine):
            lines += ["", f"[{table}]"]
            if table == "joint_sensor":
                lines.append(f"kind = {toml(self.sensor)}")
            lines += _lines([q for q in mine if q.table == table], answers, optional=True)
        return [
            *lines,
            "",
            "[limits]" + " " * 22 + "# at the joint; no option can raise them",
            *_lines(_LIMITS, answers),
        ]

    def _by_key(self) -> dict[str, Question]:
        return {question.key: question for question in (*_STAND, _ACCEPTED, *_LIMITS, *self._device_questions())}

    def _class_of(self, table: str) -> Any:
        if table == "joint_sensor":
            return SENSORS[str(self.sensor)].table_class()
        return _TABLES[table] if table in _TABLES else BACKENDS[table].table_class()

    def _device_questions(self) -> Iterator[Question]:
        tables = [self.backend] if self.backend != "sim" else []
        for table in [*tables, *(["joint_sensor"] if self.sensor else [])]:
            cls = self._class_of(table)
            meanings = _meanings(cls)
            for name, default in _fields(cls):
                yield Question(table, name, meanings.get(name, ""), None if default is _UNKNOWN else (default,))


def _fields(cls: Any) -> Iterator[tuple[str, Any]]:
    """Yield the keys of a table with their defaults; the default is `_UNKNOWN` for a key that the user must give."""
    if dataclasses.is_dataclass(cls):
        for field in dataclasses.fields(cls):
            if field.default_factory is not dataclasses.MISSING:
                yield field.name, field.default_factory()
            else:
                yield field.name, _UNKNOWN if field.default is dataclasses.MISSING else field.default
        return
    for name, info in cls.model_fields.items():
        yield name, _UNKNOWN if info.is_required() else info.get_default(call_default_factory=True)


def _meanings(cls: Any) -> dict[str, str]:
    """Return the meaning of each key, read from the docstring of its table. There it is written as `key: meaning.`"""
    names = [name for name, _ in _fields(cls)]
    alternatives = "|".join(names)
    text = re.sub(r"\s+", " ", cls.__doc__ or "")
    entries = re.findall(rf"\b({alternatives}): (.*?)(?= (?:\w+, )*(?:{alternatives}): |$)", text)
    return {name: meaning.strip().rstrip(".") for name, meaning in entries}


def _lines(
    questions: list[Question] | tuple[Question, ...], answers: Mapping[str, Any], *, optional: bool = False
) -> Iterator[str]:
    """Yield a line with key and value, followed by the meaning, for each question. An optional key without an answer is
    written as a comment.
    """
    for question in questions:
        if question.key in answers:
            yield from commented(f"{question.name} = {toml(answers[question.key])}", question.meaning)
        elif not optional:
            yield from commented(f"{question.name} = {toml(question.default)}", question.meaning)
        elif question.default is not None:
            (default,) = question.default
            shown = "..." if default is None else toml(default)
            yield from commented(f"# {question.name} = {shown}", question.meaning)


def commented(line: str, meaning: str) -> Iterator[str]:
    """Yield a line of TOML, followed by its meaning as a comment."""
    if not meaning:
        yield line
        return
    first, *rest = textwrap.wrap(meaning, 86)
    yield f"{line:<29} # {first}"
    for more in rest:
        yield f"{'':<30}# {more}"


def toml(value: Any) -> str:
    """Return a value as TOML writes it."""
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, int | float):
        return repr(value)
    if isinstance(value, list | tuple):
        return "[" + ", ".join(toml(item) for item in value) + "]"
    return json.dumps(str(value), ensure_ascii=False)
