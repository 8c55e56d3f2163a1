"""A simulated hand of 17 motors, an emulated one of 5, and a finger of 3 joints with 4 motors over 20 seeds, against
their truths.

    python benchmarks/hand.py [--only hand emulated finger] [--seeds 20] [--workers 2]

Each motor has its own cable and friction; the hand has two recordings of 20 s of each, a seed of the finger one of
10 s. A campaign records and identifies both. An entry counts as held if its 95 % interval has the truth; a value is
confidently wrong if it is trusted, its interval has not the truth, and it is off by more than 10 %. Rows of the finger:
with its true routing, with turns that are off by their stated uncertainty of 3 %, and with a torque scale that is off
by its stated 2 % too, ten draws a seed of each. The emulated hand is served by `hil emulate dynamixel --hand` on one
port and recorded in real time by `hil hand`, beside one busy loop. Its motors' encoders see the cable in series with
the fixture, and the stand states the torque constant of the emulated servos, as after a calibration. Writes
results/hand.csv.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from page import machine, write_result

from hil.api.hand import load_hand
from hil.campaign.conduct import Desk, identify_all, record_all
from hil.campaign.fingers import motors
from hil.campaign.journal import Journal
from hil.campaign.plan import of_hand
from hil.campaign.results import results
from hil.hand.routing import Finger, Motor, Value, finger

Array = NDArray[np.float64]

NAMES = [f"{name}-{joint}" for name in ("index", "middle", "ring", "little") for joint in ("spread", "mcp", "pip")]
NAMES += ["thumb-cmc", "thumb-spread", "thumb-mcp", "thumb-ip", "wrist"]
FINGER = {
    "flexor": ("mcp", {"pip": 0.7, "dip": 0.4}),
    "extensor": ("mcp", {"pip": -0.5}),
    "pip": ("pip", {"dip": 0.6}),
    "dip": ("dip", {}),
}
TURNS_OFF, SCALE_OFF, DRAWS, WRONG = 0.03, 0.02, 10, 0.1
FIXTURE = 20.0  # N m/rad
EMULATED_CONSTANT = 0.52 / 1.47  # N m/A, at the emulator's stall point; the mean of the maker's three is 1.48 % more
HEAD = """
[hand]
backend = "sim"
repeats = {repeats}
duration = {duration}
[stand]
gear_ratio = 4.0
torque_source = "joint"
[limits]
torque = {torque}
deflection = 1.0
velocity = 100.0
[sim.fixture]
stiffness = {fixture}
"""


def written(
    path: Path, names: Sequence[str], generator: np.random.Generator, *, scale: float = 1.0, **head: float
) -> dict[str, Array]:
    """Write a hand with a cable drawn for each name, and return Kc and Bc of each. scale: of all torques."""
    text, truth = HEAD.format(torque=0.03 * scale, fixture=FIXTURE, **head), {}
    for name in names:
        truth[name] = scale * np.array([18e-3, 1.9e-4]) * np.exp(0.3 * generator.standard_normal(2))
        joint, turns = FINGER.get(name, (name, {}))
        inside = ", ".join(f"{key} = {value}" for key, value in turns.items())
        text += f'[[joint]]\nname = "{name}"\nmoves = "{joint}"\nalso_moves = {{{inside}}}\n'
        text += f"sim.coupling.stiffness = {truth[name][0]}\nsim.coupling.damping = {truth[name][1]}\n"
        text += f"sim.coupling.coulomb_friction = {scale * generator.uniform(0.0, 1e-4)}\n"
        text += f"sim.coupling.bristle_stiffness = {scale * 0.02}\n"
    path.write_text(text)
    return truth


def identified(path: Path, workers: int) -> list[Motor]:
    """Record and identify a hand, and return what was identified of each motor."""
    plan = of_hand(path)
    journal, desk = Journal(plan), Desk(lambda _text: None, lambda _text: None)
    record_all(plan, journal, desk)
    identify_all(plan, journal, desk, workers=workers)
    return motors(plan, results(plan, journal))


def whole_hand(folder: Path, workers: int) -> list[str]:
    truth = written(folder / "hand.toml", NAMES, np.random.default_rng(17), repeats=2, duration=20.0)
    every = identified(folder / "hand.toml", workers)
    lines = [
        "| value | joints | trusted | held by the interval | confidently wrong | median error % |",
        "| --- " * 6 + "|",
    ]
    for number, kind in enumerate(("Kc", "Bc")):
        held, wrong, errors = 0, 0, []
        for motor in every:
            value = (motor.stiffness, motor.damping)[number]
            if value is not None:
                low, high = value.ci95(motor.torque_uncertainty)
                error = value.value / truth[motor.name][number] - 1.0
                inside = low <= truth[motor.name][number] <= high
                held, wrong, errors = held + inside, wrong + (not inside and abs(error) > WRONG), [*errors, error]
        middle = 100.0 * np.median(np.abs(errors)) if errors else np.nan
        lines.append(f"| {kind} | {len(truth)} | {len(errors)} | {held} | {wrong} | {middle:.2f} |")
    return lines


def held(estimate: Finger, true: Finger) -> list[tuple[int, int]]:
    """Return for K and B how many entries, each pair of joints once, are held, and how many there are."""
    counts = []
    for mine, right in ((estimate.stiffness, true.stiffness), (estimate.damping, true.damping)):
        upper = np.triu_indices(len(right.joints))
        inside = (mine.ci95[..., 0] <= right.values) & (right.values <= mine.ci95[..., 1])
        counts.append((int(inside[upper].sum()), int(np.isfinite(mine.values[upper]).sum())))
    return counts


def off(every: Sequence[Motor], generator: np.random.Generator, *, scale: bool) -> list[Motor]:
    """Return motors whose turns, and with `scale` whose torque, are off by a draw of what they state."""
    factor = 1.0 + SCALE_OFF * generator.standard_normal() * scale

    def scaled(value: Value | None) -> Value | None:
        return None if value is None else Value(value.value * factor, value.error * factor)

    return [
        replace(
            motor,
            stiffness=scaled(motor.stiffness),
            damping=scaled(motor.damping),
            torque_uncertainty=SCALE_OFF * scale,
            turns={name: turn * (1.0 + TURNS_OFF * generator.standard_normal()) for name, turn in motor.turns.items()},
            turns_uncertainty=TURNS_OFF,
        )
        for motor in every
    ]


def fingers_of_seeds(folder: Path, workers: int, seeds: int) -> list[str]:
    kinds = ("true routing", "turns off by 3 %", "turns off by 3 %, torque by 2 %")
    counts = np.zeros((len(kinds), 2, 2), dtype=int)
    for seed in range(seeds):
        generator, path = np.random.default_rng([3, seed]), folder / f"seed{seed}" / "hand.toml"
        path.parent.mkdir()
        truth = written(path, list(FINGER), generator, repeats=1, duration=10.0)
        every = identified(path, workers)
        values = {name: [Value(float(number)) for number in numbers] for name, numbers in truth.items()}
        true = finger([replace(one, stiffness=values[one.name][0], damping=values[one.name][1]) for one in every])
        counts[0] += held(finger(every), true)
        for kind, scale in ((1, False), (2, True)):
            for _ in range(DRAWS):
                counts[kind] += held(finger(off(every, generator, scale=scale)), true)
        print(f"seed {seed}: {counts.tolist()}", flush=True)
    lines = ["| finger of 3 joints, 4 motors | matrix | entries | held | held % |", "| --- " * 5 + "|"]
    for kind, pair in zip(kinds, counts.tolist(), strict=True):
        for matrix, (inside, count) in zip("KB", pair, strict=True):
            lines.append(f"| {kind} | {matrix} | {count} | {inside} | {100.0 * inside / max(count, 1):.1f} |")
    return lines


def emulated_hand(folder: Path, workers: int) -> list[str]:
    path, link = folder / "emulated" / "hand.toml", folder / "ttyHAND"
    path.parent.mkdir()
    truth = written(path, NAMES[:5], np.random.default_rng(5), scale=10.0, repeats=1, duration=20.0)
    text = path.read_text().replace('backend = "sim"', 'backend = "dynamixel"').replace('torque_source = "joint"\n', "")
    text = text.replace("duration = 20.0", "duration = 20.0\nrate = 200\nband = [0.1, 10.0]")
    text = text.replace("gear_ratio = 4.0", "motor_inertia = 3.2e-6\nmotor_damping = 1.6e-6")
    text = text.replace("velocity = 100.0", "velocity = 60.0\ntemperature = 65.0")
    table = f'[dynamixel]\nport = "{link}"\nmodel = "xl330-m288"\ntorque_constant = {EMULATED_CONSTANT}\n'
    text = text.replace("[sim.fixture]", f"{table}[sim.fixture]")
    for number, name in enumerate(truth, 1):
        text = text.replace(f'name = "{name}"\n', f'name = "{name}"\ndynamixel.id = {number}\n')
    path.write_text(text)
    hil = [sys.executable, "-m", "hil"]
    busy = subprocess.Popen([sys.executable, "-c", "while True: pass"])
    words = [*hil, "emulate", "dynamixel", "--hand", str(path), "--link", str(link)]
    served = subprocess.Popen(words, stderr=subprocess.PIPE, text=True)
    try:
        assert served.stderr is not None
        served.stderr.readline()
        ended = subprocess.run([*hil, "hand", str(path), "--yes", "--workers", str(workers)], check=False)
    finally:
        busy.kill()
        served.kill()
    print(f"hil hand ended with status {ended.returncode}")
    lines = ["| joint | Kc true, mN m/rad | Kc, mN m/rad | error % | held by the interval |", "| --- " * 5 + "|"]
    for motor in load_hand(path.parent / "hand").motors:
        true, value = 1.0 / (1.0 / truth[motor.name][0] + 1.0 / FIXTURE), motor.stiffness
        if value is None:
            lines.append(f"| {motor.name} | {1e3 * true:.2f} | not trusted | | |")
            continue
        low, high = value.ci95(motor.torque_uncertainty)
        error = 100.0 * (value.value / true - 1.0)
        inside = "yes" if low <= true <= high else "no"
        lines.append(f"| {motor.name} | {1e3 * true:.2f} | {1e3 * value.value:.2f} | {error:.2f} | {inside} |")
    return lines


STUDIES = {
    "hand": ("A simulated hand, two recordings of 20 s of each joint.", whole_hand),
    "emulated": ("An emulated hand of 5 servos on one port, a recording of 20 s of each.", emulated_hand),
    "finger": ("A simulated finger.", fingers_of_seeds),
}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", nargs="*", choices=STUDIES, default=[*STUDIES])
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--workers", type=int, default=2)
    options = parser.parse_args()
    text = [f"python benchmarks/hand.py --seeds {options.seeds}; {machine()}"]
    with tempfile.TemporaryDirectory() as folder:
        for name in options.only:
            title, study = STUDIES[name]
            further = {"seeds": options.seeds} if name == "finger" else {}
            text += ["", title, *study(Path(folder), options.workers, **further)]
    print("\n".join(text))
    if options.only == [*STUDIES]:
        write_result("hand", "\n".join(text))


if __name__ == "__main__":
    main()
