"""The options that several commands share, and functions that read their values."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any

import typer

from drivers.servo import Quantity
from hil.errors import WrongUse, decimal_comma
from hil.units import quantity

DEFAULT_SEED = 0
"""The seed for random numbers in every command without --seed."""
LARGEST_SEED = 2**63 - 1
"""The largest allowed seed: the largest integer that can be stored in a recording."""
DEFAULT_RATE = 500.0
"""The sampling rate without --rate, Hz."""
ALL_CORES = os.cpu_count() or 1
_HERE, _HAND_HERE = Path("stand.toml"), Path("hand.toml")


def measured(option: str, dimension: str, text: str) -> Any:
    """Return the definition of an option whose value is a number with or without a unit, converted to SI.

    option: name. dimension: of the quantity. text: the help. The option raises WrongUse for a wrong unit.
    """

    def parsed(given: str) -> float:
        try:
            return quantity(str(given), dimension)[0]
        except WrongUse as error:
            raise WrongUse(f"{option} {error}") from None

    return typer.Option(option, parser=parsed, metavar="NUMBER", help=text)


def searched(text: str, *, least: float | None = None, most: float | None = None) -> Any:
    """Return the definition of an option of the paper's genetic algorithm; the help lists these options separately.

    text: the help. least, most: the range of a number.
    """
    return typer.Option(min=least, max=most, help=text, rich_help_panel="The paper's genetic algorithm")


Backend = Annotated[str | None, typer.Option(help="A stand that needs no stand file: sim, or replay FILE.")]
StandFile = Annotated[
    Path | None, typer.Option(help="The stand file [default: stand.toml in this folder, where there is one].")
]
Joint = Annotated[str | None, typer.Option("--joint", help="The joint, if the stand file is that of a hand.")]
Faults = Annotated[Path | None, typer.Option(help="A TOML file of faults that happen (docs/reliability.md).")]
Kind = Annotated[str, typer.Option("--profile", help="The excitation; hil record --list-profiles explains them.")]
Mode = Annotated[Quantity, typer.Option(help="Command torque or position.")]
Amplitude = Annotated[
    str | None,
    typer.Option(
        metavar="NUMBER", help="N m or rad at the joint, or with a unit: '5 deg' [default: a fifth of the limit]."
    ),
]
Band = Annotated[str | None, typer.Option(help="Hz, LOW:HIGH or one frequency.")]
Duration = Annotated[
    float | None,
    measured("--duration", "time", "s, or with a unit: '2 min' [default: 20, or the length of the set-point file]."),
]
Rate = Annotated[float, measured("--rate", "frequency", "Samples per second, Hz.")]
EvenRate = Annotated[float | None, measured("--rate", "frequency", "Rows per second, Hz, if no column has the time.")]
Fade = Annotated[float, measured("--fade", "time", "s over which the excitation fades in and out.")]
Trials = Annotated[
    int | None, typer.Option(min=1, help="Independent searches [default: 30; 5 with nonlinear parameters].")
]
Fixture = Annotated[
    Path | None,
    typer.Option(help="Subtract the compliance of the fixture: a recording of the empty rig, or a stand file."),
]
Bounds = Annotated[
    list[str] | None,
    typer.Option(metavar="NAME=LOW:HIGH", help="In SI, or Kc=10:30mN*m/rad; repeat for several."),
]
Unasked = Annotated[bool, typer.Option("--yes", help="Do not ask before a real motor moves for the first time.")]
Setpoints = Annotated[Path | None, typer.Option(help="CSV of time (s) and set-point, for --profile file.")]
Seed = Annotated[int, typer.Option(min=0, max=LARGEST_SEED, help="Seed of everything random.")]
Model = Annotated[str, typer.Option(help="auto: model selection; or terms, as in linear+offset; or FILE.py:NAME.")]
Workers = Annotated[int, typer.Option(min=1, help="Cores to use [default: all].", show_default=False)]
Checkpoint = Annotated[Path | None, typer.Option(help="Save the search to this file; resume from it if it exists.")]
Output = Annotated[Path | None, typer.Option("-o", "--output", help="The file to write.")]
Folder = Annotated[Path, typer.Option("-o", "--output", help="The folder to write into.")]
Force = Annotated[bool, typer.Option("--force", help="Overwrite existing files.")]
NoGuardian = Annotated[
    bool,
    typer.Option(
        "--no-guardian",
        help="Run without the process that switches the torque off if hil is killed, frozen or late. Then only the "
        "drive's own watchdog does it.",
    ),
]
Rerun = Annotated[
    str, typer.Option(metavar="PLACE", help="Stream the run to Rerun: window, or a file .rrd (hil[view]).")
]
Plot = Annotated[Path | None, typer.Option(help="Also draw pictures (PNG) into this folder.")]
From = Annotated[
    str | None,
    typer.Option("--from", metavar="S", help="Use the rows from this time on, s: 2, '500 ms' [default: all]."),
]
To = Annotated[str | None, typer.Option("--to", metavar="S", help="Use the rows up to this time, s.")]
Json = Annotated[bool, typer.Option("--json", help="One JSON object on standard output, the rest on standard error.")]


def _list_models(wanted: bool) -> None:
    from hil.cli.terminal import out
    from hil.identification.user_model import listed

    if wanted:
        for name, meaning in listed():
            out(f"{name:10} {meaning}")
        raise typer.Exit


ListModels = Annotated[
    bool,
    typer.Option("--list-models", callback=_list_models, is_eager=True, help="List the terms and models, and end."),
]


def stand_of(backend: str | None, path: Path | None, joint: str | None = None) -> str | Path:
    """Return the stand file, or "sim", from --backend or --stand. Without both, return the stand.toml in the working
    directory, with --joint the hand.toml, and print that.

    Raises WrongUse.
    """
    from hil.cli.terminal import note
    from hil.stand.devices import check_backend

    if path is not None and backend is not None:
        raise WrongUse("give --backend or --stand, not both: a stand file names its own backend")
    if path is not None:
        return path
    if backend is not None and joint is not None:
        raise WrongUse(f"--joint {joint}: only the file of a hand has joints: --stand hand.toml")
    here = _HERE if joint is None else _HAND_HERE
    if backend is None and here.is_file():
        note(f"using {here}, the {'stand file' if joint is None else 'hand'} of this folder")
        return here
    if backend is None:
        raise WrongUse("which stand? --backend sim for the simulated one, --stand stand.toml for your own")
    if backend == "replay":
        raise WrongUse("which recording? hil record --backend replay FILE")
    if check_backend(backend) != "sim":
        raise WrongUse(f"backend {backend!r} needs a stand file, with its limits and its port: --stand stand.toml")
    return backend


def amplitude_of(text: str | None, mode: Quantity) -> float | None:
    """Return the amplitude in the unit that the mode needs, N m or rad; None if none was given. Raises WrongUse for
    another unit.
    """
    wanted = "torque" if mode is Quantity.TORQUE else "angle"
    if text is None:
        return None
    try:
        value, dimension = quantity(text, "torque", "angle")
    except WrongUse as error:
        raise WrongUse(f"--amplitude {error}") from None
    if dimension not in {None, wanted}:
        other = "position" if mode is Quantity.TORQUE else "torque"
        raise WrongUse(f"--amplitude {text!r}: --mode {mode.value} takes {wanted}s; or record with --mode {other}")
    return value


def check_report(report: Path | None, inputs: Sequence[Path], *, force: bool) -> None:
    """Raise WrongUse if --report would overwrite a file, or is not a name for an HTML file. Called before any work is
    done.
    """
    from hil.recording.output import check_output
    from hil.report.html_page import check_page_name

    if report is not None:
        check_output(check_page_name(report), force=force, inputs=inputs)


def band_of(text: str | None) -> tuple[float, float] | None:
    """Return the lowest and highest frequency in --band, Hz; None if no band was given. Raises WrongUse."""
    if text is None:
        return None
    try:
        parts = span_of(text, "frequency") if ":" in text else 2 * [quantity(text, "frequency")[0]]
    except WrongUse:
        remedy = decimal_comma(text) or ": write LOW:HIGH in Hz, such as 0.1:15, or one frequency"
        raise WrongUse(f"--band {text!r}{remedy}") from None
    return parts[0], parts[1]


def span_of(text: str, *dimensions: str) -> list[float]:
    """Return the two numbers of LOW:HIGH, SI. A unit after HIGH applies to LOW as well if LOW has no unit."""
    low, colon, high = text.partition(":")
    (first, stated), (second, dimension) = quantity(low, *dimensions), quantity(high, *dimensions)
    if not colon or (stated and dimension and stated != dimension):
        raise WrongUse(f"{text!r}: write LOW:HIGH")
    if stated is None and dimension is not None:
        first = quantity(low + high.lstrip("+-0123456789.eE "), dimension)[0]
    return [first, second]
