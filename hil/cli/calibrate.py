"""`hil calibrate`: measure the torque cell's scale and delay, the fixture's compliance and the zero, and store them in
the stand file.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from drivers.servo import Quantity
from hil.cli import options
from hil.cli.examples import below_help
from hil.cli.terminal import asking, command_line, out, print_diagnostics, say
from hil.errors import Untrustworthy, WrongUse
from hil.printable import quoted

if TYPE_CHECKING:
    from hil.calibration.points import Load
    from hil.calibration.step import StepResponse
    from hil.calibration.torque import Point, Scale
    from hil.stand.file import Stand

calibrate = typer.Typer(
    help="Measure what identification needs to know of a stand, and store it with date and uncertainty in its file.",
    no_args_is_help=True,
)

StandPath = Annotated[Path, typer.Argument(help="The stand file, which keeps its comments.")]
Yes = Annotated[bool, typer.Option("--yes", help="Ask and wait for nothing: for scripts.")]


@calibrate.command(epilog=below_help("calibrate torque"))
def torque(
    stand: StandPath,
    joint: options.Joint = None,
    arm: Annotated[float | None, options.measured("--arm", "length", "Length of the lever, m, or 50mm.")] = None,
    arm_uncertainty: Annotated[
        float, options.measured("--arm-uncertainty", "length", "Its standard uncertainty, m, or 0.5mm.")
    ] = 0.5e-3,
    points: Annotated[Path | None, typer.Option(help="CSV of mass (kg) or torque (N m), and value if read.")] = None,
    step: Annotated[
        bool, typer.Option("--step", help="Measure delay and bandwidth instead, by taking a load off.")
    ] = False,
    yes: Yes = False,
) -> None:
    """Calibrate the torque cell with known weights on a lever.

    Example: hil calibrate torque stand.toml --arm 50mm. Hang at least five weights while loading and while unloading,
    on both sides of the lever; the cell is tared first. A negative mass hangs on the other side.
    """
    from drivers.clock import MonotonicClock
    from hil.api.calibration import read_loads, store_step, store_torque
    from hil.calibration.points import read_points
    from hil.calibration.session import cell_table, opened_cell
    from hil.hand.file import load_stand
    from hil.recording.output import check_output

    check_output(stand, force=True)  # before the weights are hung
    opened = load_stand(stand, joint)
    cell_table(opened)
    clock = MonotonicClock()
    if step:
        with opened_cell(opened, clock) as cell:
            _wait(
                "hang a weight and let it come to rest; press Enter, then take it off at once within ten seconds",
                yes=yes,
            )
            _print_step(store_step(stand, cell, clock, joint))
        return
    lever = None if arm is None else (arm, arm_uncertainty)
    if lever is not None and not (lever[0] > 0.0 and lever[1] >= 0.0):
        raise WrongUse(f"--arm {arm:g}, --arm-uncertainty {arm_uncertainty:g}: a lever is longer than 0")
    given = None if points is None else read_points(points, arm)
    if given is not None and all(one.value is not None for one in given):
        known = read_loads(opened, given, None, clock, lambda _: True)
        _print_scale(*store_torque(stand, known, tare=0.0, arm=lever, joint=joint))
        return
    if given is None and yes:
        raise WrongUse("with --yes no weights are asked for: give them with --points FILE.csv")
    if given is None and arm is None:
        raise WrongUse("a weight makes a torque only on a lever: give the lever's length, such as --arm 50mm")
    _wait("leave the lever in place without a weight; the cell is tared", yes=yes)
    with opened_cell(opened, clock) as cell:
        if given is None:
            measured = _guided(opened, lambda loads: read_loads(opened, loads, cell, clock, lambda _: True), arm)
        else:
            measured = read_loads(opened, given, cell, clock, lambda one: _wait(f"hang {one.name}", yes=yes))
        _print_scale(*store_torque(stand, measured, tare=cell.tare, arm=lever, joint=joint))


@calibrate.command(epilog=below_help("calibrate fixture"))
def fixture(
    stand: StandPath,
    joint: options.Joint = None,
    recording: Annotated[Path | None, typer.Option(help="Use this recording of the empty rig; drive nothing.")] = None,
    profile: options.Kind = "chirp",
    amplitude: options.Amplitude = None,
    band: options.Band = None,
    duration: options.Duration = None,
    rate: options.Rate = options.DEFAULT_RATE,
    mode: options.Mode = Quantity.TORQUE,
    output: options.Output = None,
    force: options.Force = False,
    yes: Yes = False,
) -> None:
    """Record the empty rig, with a stiff link in place of the joint, and store the stand's own compliance.

    `hil identify run.h5 --fixture stand.toml` then removes it from Kc and Bc.
    """
    from hil.api import runs
    from hil.api.calibration import store_fixture
    from hil.cli.progress import progress
    from hil.hand.file import load_stand
    from hil.recording.output import check_output

    check_output(stand, force=True)
    load_stand(stand, joint)  # before the link is mounted
    if recording is None:
        torque_or_angle, hertz = options.amplitude_of(amplitude, mode), options.band_of(band)
        _wait("put a stiff link in the place of the joint; the motor will push against it", yes=yes)
        run = runs.record(
            stand,
            profile,
            joint=joint,
            amplitude=torque_or_angle,
            band=hertz,
            duration=duration,
            rate=rate,
            mode=mode,
            note="empty rig, hil calibrate fixture",
            output=output,
            force=force,
            command_line=command_line(),
            warn=print_diagnostics,
            alarm=say,
            agree=asking(yes=yes),
        )
        if run.outcome.signal:
            raise typer.Exit(128 + run.outcome.signal)
        recording = run.path
    with progress() as show:
        found = store_fixture(stand, recording, joint=joint, progress=show).identification
    kc, bc = found["Kc"], found["Bc"]
    out(f"the fixture has {kc.value:.4g} N m/rad and {bc.value:.3g} N m s/rad, from {recording}")
    print_diagnostics(found.diagnostics)
    rig = stand if joint is None else recording
    say(f"stored in [calibration.fixture] of {stand}; use it with: hil identify run.h5 --fixture {quoted(rig)}")


@calibrate.command(epilog=below_help("calibrate zero"))
def zero(stand: StandPath, joint: options.Joint = None, yes: Yes = False) -> None:
    """Store the motor's angle at rest as the stand's zero. The torque is off; nothing is driven."""
    from hil.api.calibration import store_zero
    from hil.recording.output import check_output

    check_output(stand, force=True)
    found = store_zero(stand, lambda what: _wait(what, yes=yes), joint)
    out(f"zero = {found.value:.6g} +- {1.96 * found.uncertainty:.2g} rad at the motor (95 %)")
    say(f"stored as stand.zero and [calibration.zero] in {stand}")


def _wait(what: str, *, yes: bool) -> bool:
    """Print what to do. Unless `yes`, wait until the person presses Enter. Return whether to continue."""
    say(what)
    if not yes:
        typer.prompt("press Enter when it is done", default="", show_default=False, err=True)
    return True


def _guided(stand: Stand, read: Callable[[list[Load]], list[Point]], arm: float | None) -> list[Point]:
    """Ask for one weight after the other until the answer is empty; return the points. An impossible weight is left
    out.
    """
    from hil.calibration.points import weight
    from hil.calibration.torque import implausible

    limit = None if stand.limits is None else stand.limits.torque
    points: list[Point] = []
    for text in _answers():
        try:
            (point,) = read([weight(text, arm)])
            if problem := implausible([*points, point], limit):
                raise WrongUse(problem)
        except (WrongUse, Untrustworthy) as error:
            say(f"{error}; this weight was left out")
            continue
        points.append(point)
        say(f"{point.name}: {point.value:.6g} at {point.torque:.4g} N m")
    return points


def _answers() -> Iterator[str]:
    while text := typer.prompt(
        "the mass that hangs now, kg, or with its unit (200g); with a minus on the other side; Enter for no more",
        default="",
        show_default=False,
        err=True,
    ).strip():
        yield text


def _print_scale(found: Scale, keys: list[str]) -> None:
    from hil.report.formatting import engineering, rounded

    exponent = 10.0 ** -int(f"{found.scale:e}".partition("e")[2])
    low, high = found.ci95
    value, half = rounded(0.5 * (high - low) * exponent, found.scale * exponent)
    out(
        f"scale = ({value} +- {half})e{f'{found.scale:e}'.partition('e')[2]} N m for a reading of 1 (95 %), from "
        f"{found.points} points"
    )
    out(f"  uncertainty of Kc and Bc from it: {100.0 * found.uncertainty:.2g} % (one standard deviation)")
    out(f"  off the line: {engineering(found.residual, 'N m')} (root mean square)")
    if found.hysteresis == found.hysteresis:
        out(f"  hysteresis: {engineering(found.hysteresis, 'N m')}; it would look like dry friction of this size")
    else:
        say("warning [no-hysteresis]: no load was measured both while loading and unloading: hysteresis is not known")
    if found.one_sided:
        say("warning [one-sided]: all loads pulled the same way: the scale of the other direction is not measured")
    say(f"stored: {', '.join(keys)} and [calibration.torque]")


def _print_step(found: StepResponse) -> None:
    from hil.report.formatting import engineering

    out(
        f"delay = {engineering(found.delay, 's')} +- {engineering(1.96 * found.uncertainty, 's', 2)} (95 %), bandwidth "
        f"{found.bandwidth:.3g} Hz; the cell answers like {'an average' if found.shape == 'average' else 'a low-pass'}"
    )
    say(f"stored: joint_sensor.delay and [calibration.step]; keep the excitation below {found.bandwidth / 4.0:.2g} Hz")
