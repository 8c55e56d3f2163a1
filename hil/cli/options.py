"""The options that several commands share, and what their values stand for."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from drivers.servo import Quantity
from hil.errors import WrongUse

if TYPE_CHECKING:
    from hil.identification.model_choice import Coupling
    from hil.stand.file import Stand

DEFAULT_SEED = 0
"""The seed of every command that is given none."""
LARGEST_SEED = 2**63 - 1
"""The largest integer that an attribute of a recording holds."""
DEFAULT_RATE = 500.0
"""Hz."""
ALL_CORES = os.cpu_count() or 1

Backend = Annotated[str | None, typer.Option(help="A stand that needs no stand file: sim.")]
StandFile = Annotated[Path | None, typer.Option(help="The stand file (stand.toml).")]
Kind = Annotated[str, typer.Option("--profile", help="The excitation; hil record --list-profiles explains them.")]
Mode = Annotated[Quantity, typer.Option(help="Command torque or position.")]
Amplitude = Annotated[float | None, typer.Option(help="N m or rad at the joint [default: a fifth of the limit].")]
Band = Annotated[str | None, typer.Option(help="Hz, LOW:HIGH or one frequency.")]
Duration = Annotated[float | None, typer.Option(help="s [default: 20, or the length of the set-point file].")]
Rate = Annotated[float, typer.Option(help="Samples per second.")]
Setpoints = Annotated[Path | None, typer.Option(help="CSV of time (s) and set-point, for --profile file.")]
Seed = Annotated[int, typer.Option(min=0, max=LARGEST_SEED, help="Seed of everything random.")]
Model = Annotated[str, typer.Option(help="auto: model selection; or terms, as in linear+offset; or FILE.py:NAME.")]
Workers = Annotated[int, typer.Option(min=1, help="Threads [default: all cores].", show_default=False)]
Checkpoint = Annotated[Path | None, typer.Option(help="Save the search to this file; resume from it if it exists.")]
Output = Annotated[Path | None, typer.Option("-o", "--output", help="The file to write.")]
Folder = Annotated[Path, typer.Option("-o", "--output", help="The folder to write into.")]
Force = Annotated[bool, typer.Option("--force", help="Overwrite existing files.")]
Json = Annotated[bool, typer.Option("--json", help="One JSON object on standard output, the rest on standard error.")]


def stand_of(backend: str | None, path: Path | None) -> Stand:
    """Return the stand that --backend or --stand names. Raises WrongUse."""
    from hil.stand.devices import check_backend
    from hil.stand.file import SIMULATED, load, parse

    if path is not None and backend is not None:
        raise WrongUse("give --backend or --stand, not both: a stand file names its own backend")
    if path is not None:
        return load(path)
    if backend is None:
        raise WrongUse("which stand? --backend sim for the simulated one, --stand stand.toml for your own")
    if check_backend(backend) != "sim":
        raise WrongUse(f"backend {backend!r} needs a stand file, with its limits and its port: --stand stand.toml")
    return parse(SIMULATED)


def checked_rate(rate: float) -> float:
    """Return `rate`, Hz. Raises WrongUse where no drive could be asked so often or so rarely."""
    if not 20.0 <= rate <= 10_000.0:
        raise WrongUse(
            f"--rate {rate:g}: it must lie between 20 and 10000 Hz; a drive that is asked less often assumes that its "
            "host is dead and turns the torque off"
        )
    return rate


def limit_of(stand: Stand, mode: Quantity) -> float:
    """Return the stand's limit on what is commanded, N m or rad at the joint. Raises WrongUse where it sets none."""
    limits = stand.checked_limits()
    return limits.torque if mode is Quantity.TORQUE else limits.deflection


def model_of(name: str) -> Coupling | None:
    """Return the coupling model of that name, None for model selection ("auto"). Raises WrongUse."""
    from ga.model.coupling import parse

    if name == "auto":
        return None
    if ".py:" in name:
        from hil.identification.user_model import load

        return load(name)
    try:
        return parse(name)
    except ValueError as error:
        raise WrongUse(f"--model {name!r}: {error}") from None


def band_of(text: str | None) -> tuple[float, float] | None:
    """Return the two ends, Hz, that --band names; None without one. Raises WrongUse."""
    if text is None:
        return None
    try:
        parts = [float(part) for part in text.split(":")]
    except ValueError:
        parts = []
    if len(parts) not in {1, 2}:
        raise WrongUse(f"--band {text!r}: write LOW:HIGH in Hz, such as 0.1:15, or one frequency")
    return parts[0], parts[-1]
