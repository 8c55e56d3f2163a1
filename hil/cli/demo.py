"""`hil demo`: the main job on the simulated servo, of one joint or of a small hand."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from hil.cli import options
from hil.cli.identify import publish
from hil.cli.many.campaign import hand as conduct_hand
from hil.cli.progress import progress
from hil.cli.record import record
from hil.cli.terminal import UNTRUSTWORTHY, detail, out
from hil.printable import quoted

HAND = """\
# A hand with three joints of the simulator: the tendon of the finger's flexor passes a second joint,
# and the palm yields.
[hand]
name = "demo"
backend = "sim"
repeats = 1
duration = 10
[stand]
gear_ratio = 4.0
torque_source = "joint"
[limits]
torque = "30 mN*m"
deflection = 1.0
velocity = 100.0
[sim.fixture]
palm = 30.0
[[joint]]
name = "index_mcp"
also_moves = {index_pip = 0.75}
routing_uncertainty = 0.03
[[joint]]
name = "index_pip"
sim.coupling.stiffness = 0.021
[[joint]]
name = "thumb_mcp"
sim.coupling.stiffness = 0.03
sim.coupling.damping = 3e-4
"""


def demo(
    output: options.Folder = Path("hil-demo"),
    hand: Annotated[bool, typer.Option("--hand", help="A hand of three joints, in place of a joint.")] = False,
) -> None:
    """Run the main job on the simulated servo: record a chirp, identify, write the report, compare with the truth."""
    if hand:
        _hand(output)
    else:
        _joint(output)


def _joint(output: Path) -> None:
    from hil.recording.output import check_output, next_free

    path = next_free(output)
    page = path.with_suffix(".html")
    check_output(page, force=False)
    detail("1 of 3: recording a 20 s chirp, 0.1 to 15 Hz, on the simulated joint; the first run compiles it first ...")
    from hil.api.analysis import identify
    from hil.api.recordings import load
    from hil.report.identification import truth_lines

    record(backend="sim", note="hil demo", output=path)
    detail("2 of 3: identifying stiffness and damping ...")
    with progress() as show:
        found = identify(path, progress=show)
    detail("3 of 3: writing the report ...")
    publish(found, page)
    for line in truth_lines(found.identification, load(path).truth):
        out(line)
    detail(f"The recording is {path}; look at it with: hil inspect {quoted(path)}")
    if not found.trustworthy:
        raise typer.Exit(UNTRUSTWORTHY)


def _hand(output: Path) -> None:
    from hil.recording.output import writing

    path = output / "hand.toml"
    with writing(path):
        output.mkdir(parents=True, exist_ok=True)
        if not path.exists():
            path.write_text(HAND, encoding="utf-8")
    detail(f"1 of 2: recording and identifying the joints of {path}: hil hand {quoted(path)} --yes")
    conduct_hand(path, yes=True)
    from hil.api.hand import load_hand
    from hil.hand.file import load

    detail("2 of 2: comparing with the truth ...")
    found = load_hand(output / "hand")
    for joint in load(path).joints:
        true, motor = joint.stand.simulated().coupling, found[joint.name]
        for name, unit, value, held in (
            ("Kc", "mN m/rad", true.stiffness, motor.stiffness),
            ("Bc", "mN m s/rad", true.damping, motor.damping),
        ):
            if held is not None:
                out(_compared(f"{name} of {joint.name}", unit, value, held.ci95(motor.torque_uncertainty)))
    detail(f"For a simulator: hil export {quoted(output / 'hand')} -o priors.json")


def _compared(name: str, unit: str, true: float, interval: tuple[float, float]) -> str:
    low, high = (f"{1e3 * limit:.4g}" for limit in interval)
    holds = "holds" if interval[0] <= true <= interval[1] else "does not hold"
    return f"true {name}: {1e3 * true:.4g} {unit}; the interval, {low} to {high}, {holds} it"
