"""`hil stand new` and `hil stand schema`: write a stand file, and the schema for editors."""

from __future__ import annotations

import json
from difflib import get_close_matches
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from hil.cli import options
from hil.cli.terminal import out, say
from hil.errors import WrongUse

if TYPE_CHECKING:
    from hil.stand.draft import Draft, Question

stand = typer.Typer(help="Write a stand file, or its schema for an editor.", no_args_is_help=True)


@stand.command()
def new(
    output: Annotated[Path, typer.Option("-o", "--output", help="The file to write.")] = Path("stand.toml"),
    backend: Annotated[str | None, typer.Option(help="The drive; see hil record --list-backends.")] = None,
    sensor: Annotated[str | None, typer.Option(help="The kind of a joint sensor on its own link.")] = None,
    answer: Annotated[
        list[str] | None, typer.Option("--set", help="An answer: KEY=VALUE, such as dynamixel.port=/dev/ttyUSB0.")
    ] = None,
    yes: Annotated[bool, typer.Option("--yes", help="Ask nothing: use the defaults.")] = False,
    force: options.Force = False,
) -> None:
    """Ask for the data of a stand and write a commented stand.toml."""
    from hil.recording.output import atomic_write, check_output
    from hil.stand.devices import BACKENDS, SENSORS, check_backend, check_sensor
    from hil.stand.draft import Draft
    from hil.stand.file import parse

    check_output(output, force=force)
    if backend is None:
        backend = "sim" if yes else typer.prompt(f"Which drive ({', '.join(BACKENDS)})", default="dynamixel", err=True)
    if sensor is None and SENSORS and not yes:
        kind = typer.prompt(
            f"A sensor at the joint on its own link (none, {', '.join(SENSORS)})", default="none", err=True
        )
        sensor = None if kind == "none" else kind
    draft = Draft(check_backend(backend), None if sensor is None else check_sensor(sensor))
    answers = _given(draft, answer or [])
    for question in draft.questions():
        if question.key not in answers:
            answers[question.key] = _default(question) if yes else _asked(draft, question)
    text = draft.text(answers)
    parse(text, str(output))
    with atomic_write(output, force=force) as temporary:
        temporary.write_text(text, encoding="utf-8")
    say(f"wrote {output}; look at the drive with: hil doctor {output}")


@stand.command()
def schema() -> None:
    """Print the JSON schema of stand.toml, with which an editor checks and completes it."""
    from hil.stand.json_schema import stand_schema

    out(json.dumps(stand_schema(), indent=2, allow_nan=False))


def _given(draft: Draft, words: list[str]) -> dict[str, Any]:
    answers = {}
    for word in words:
        key, equals, text = word.partition("=")
        question = draft.question(key)
        if not equals or question is None:
            near = get_close_matches(key, draft.keys(), n=1)
            hint = f"did you mean {near[0]}? " if near else ""
            raise WrongUse(f"--set {word}: write KEY=VALUE; {hint}keys are {', '.join(draft.keys())}")
        value = draft.value(question, text)
        problem = draft.error(question, value)
        if problem:
            raise WrongUse(f"--set {word}: {problem}")
        answers[key] = value
    return answers


def _default(question: Question) -> Any:
    if question.default is None:
        raise WrongUse(f"{question.key} has no default: add --set {question.key}=...")
    return question.default


def _asked(draft: Draft, question: Question) -> Any:
    """Return the user's answer, asked for again until it is valid."""
    default = _port_here() if question.name == "port" else question.default
    meaning = f" ({question.meaning})" if question.meaning else ""
    while True:
        text = typer.prompt(f"{question.key}{meaning}", default=None if default is None else str(default), err=True)
        value = draft.value(question, text)
        problem = draft.error(question, value)
        if not problem:
            return value
        say(f"{text}: {problem}")


def _port_here() -> str | None:
    """Return the only serial port of this machine, None where there are none or several."""
    from drivers.ports import serial_ports

    ports = serial_ports()
    return ports[0].name if len(ports) == 1 else None
