"""`hil stand new` and `hil stand schema`: write a stand file, and the schema for editors."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from hil.cli import options
from hil.cli.examples import below_help
from hil.cli.terminal import note, out, say
from hil.errors import WrongUse, meant
from hil.printable import quoted

if TYPE_CHECKING:
    from hil.stand.draft import Draft, Question

stand = typer.Typer(help="Write a stand file, or its schema for an editor.", no_args_is_help=True)


@stand.command(epilog=below_help("stand new"))
def new(
    output: Annotated[
        Path | None,
        typer.Option("-o", "--output", help="The file to write [default: stand.toml, with --scan hand.toml]."),
    ] = None,
    scan: Annotated[
        str | None,
        typer.Option(metavar="PORT", help="Write the file of a hand from the servos that answer on this port."),
    ] = None,
    backend: Annotated[str | None, typer.Option(help="The drive; see hil record --list-backends.")] = None,
    sensor: Annotated[str | None, typer.Option(help="The kind of a joint sensor on its own link.")] = None,
    answer: Annotated[
        list[str] | None,
        typer.Option("--set", metavar="KEY=VALUE", help="An answer, such as dynamixel.port=/dev/ttyUSB0."),
    ] = None,
    yes: Annotated[bool, typer.Option("--yes", help="Ask nothing: use the defaults.")] = False,
    force: options.Force = False,
) -> None:
    """Ask for the data of a stand and write a commented stand.toml; or, with --scan, find servos and write a hand.toml.

    --scan only reads: nothing moves and no torque is switched on.
    """
    from hil.recording.output import atomic_write, check_output
    from hil.stand.devices import BACKENDS, SENSORS, check_backend, check_sensor
    from hil.stand.draft import Draft
    from hil.stand.file import checked, parse

    output = output or Path("stand.toml" if scan is None else "hand.toml")
    check_output(output, force=force)
    if scan is not None:
        if backend is not None:
            raise WrongUse(f"--backend {backend}: --scan finds out which drives there are; omit one of the two")
        _write_hand(scan, output, None if sensor is None else check_sensor(sensor), answer or [], force=force)
        return
    if backend is None:
        backend = "sim" if yes else typer.prompt(f"Which drive ({', '.join(BACKENDS)})", default="dynamixel", err=True)
    check_backend(backend)  # before any other question
    if sensor is None and SENSORS and not yes:
        kind = typer.prompt(
            f"A sensor at the joint on its own link (none, {', '.join(SENSORS)})", default="none", err=True
        )
        sensor = None if kind == "none" else kind
    draft = Draft(backend, None if sensor is None else check_sensor(sensor))
    answers = _given(draft, answer or [])
    open_questions = [question for question in draft.questions() if question.key not in answers]
    if yes:
        _check_defaults(draft, open_questions)
    for question in open_questions:
        answers[question.key] = question.default if yes else _asked(draft, question)
    text = draft.text(answers)
    checked(parse(text, str(output)), str(output))
    with atomic_write(output, force=force) as temporary:
        temporary.write_text(text, encoding="utf-8")
    note(f"wrote {output}; look at the drive with: hil doctor {quoted(output)}")


def _write_hand(port: str, output: Path, sensor: str | None, answers: list[str], *, force: bool) -> None:
    """Write the file of a hand from the servos on a port, and say what must still be edited."""
    from hil.hand.draft import found_on, hand_text
    from hil.hand.file import parse
    from hil.recording.output import atomic_write
    from hil.stand.draft import Draft

    note(f"looking for servos on {port} at every baud rate: half a minute")
    found = found_on(port)
    text = hand_text(found, _given(Draft(found.backend, sensor), answers), sensor)
    with atomic_write(output, force=force) as temporary:
        temporary.write_text(text, encoding="utf-8")
    for sentence in found.others:
        say(f"not in {output}: {sentence}")
    count = len(found.servos)
    note(f"wrote {output} with {count} joint{'s' if count > 1 else ''}: {', '.join(found.models)}")
    try:
        parse(text, str(output))
    except WrongUse as error:
        say(f"before anything is driven, correct this: {error}")
    note(f"name the joints, correct the limits, and look at them with: hil doctor {quoted(output)}")


@stand.command(epilog=below_help("stand schema"))
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
            hint = meant(key, draft.keys())
            raise WrongUse(f"--set {word}: write KEY=VALUE; {hint}keys are {', '.join(draft.keys())}")
        value = draft.value(question, text)
        problem = draft.error(question, value)
        if problem:
            raise WrongUse(f"--set {word}: {problem}")
        answers[key] = value
    return answers


def _check_defaults(draft: Draft, questions: list[Question]) -> None:
    """Raise WrongUse if a question has no default answer; the message lists all such questions and their answers."""
    missing = [question for question in questions if question.default is None]
    if missing:
        words = " ".join(f"--set {question.key}=..." for question in missing)
        known = [said for question in missing if (said := _listed(question, draft.answers(question)))]
        keys = ", ".join(question.key for question in missing)
        raise WrongUse("\n".join([f"{keys}: there is no default; add {words}", *known]))


def _asked(draft: Draft, question: Question) -> Any:
    """Ask the user a question, again until the answer is valid; return the answer. Known answers are listed first."""
    default, known = question.default, draft.answers(question) if question.default is None else []
    if question.default is None and (said := _listed(question, known)):
        say(said)
    if len(known) == 1 and question.name == "port":
        default = known[0].split()[0]
    meaning = f" ({question.meaning})" if question.meaning else ""
    while True:
        text = typer.prompt(f"{question.key}{meaning}", default=None if default is None else str(default), err=True)
        value = draft.value(question, text)
        problem = draft.error(question, value)
        if not problem:
            return value
        say(f"{text}: {problem}")


def _listed(question: Question, known: list[str]) -> str:
    """Return the sentence that lists the known answers to a question, "" if every text can be one."""
    if question.name == "port" and not known:
        return f"{question.key}: no serial port is connected to this computer"
    return f"{question.key} is one of: {', '.join(known)}" if known else ""
