"""The textbook: each effect of a record on one joint, small, plain and large: `python benchmarks/textbook.py`.

A row is one recording, identified once with the model named and once with the default options. The torque comes from
the closed forms and differential equations below, which share nothing with the columns of the terms. The parameters
come from the record's `example`. Rows that are in results/textbook.csv are not made again, except with --again.
"""

from __future__ import annotations

import argparse
import csv
import re
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import cache
from itertools import product
from pathlib import Path
from typing import Any, NamedTuple
from zlib import crc32

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import odeint
from scipy.stats import norm

import hil
from ga.model.terms import TERMS, canonical
from hil.recording.writer import Header, write

Array = NDArray[np.float64]
Values = Mapping[str, float]

RATE, SAMPLES, NOISE = 500.0, 10_000, 0.2e-3  # Hz, -, N m
TIME = np.arange(SAMPLES) / RATE
BEFORE = 1.0  # s for which the joint moved before the recording
GEAR, INERTIA, DAMPING = 4.0, 2e-7, 1e-7  # of the motor: -, kg m^2, N m s/rad
STAND = f"""[stand]
name = "textbook"
backend = "sim"
gear_ratio = {GEAR}
motor_inertia = {INERTIA}
motor_damping = {DAMPING}
torque_source = "motor"
[limits]
torque = 1.0
deflection = 1.0
velocity = 1000.0
"""
SIZES = ("small", "plain", "large")
NOISES, SOURCES, SEEDS = (1, 2, 4), ("cell", "motor"), (1, 2)
KC, BC = {"right": 0.01, "wide": 0.05}, {"right": 0.05, "wide": 0.15}  # parts of the value
OUTCOMES = ("right", "wide", "missed", "refused", "wrong")
"""Near the truth or in a narrow interval; in a wide one; beside one by up to half of it; exit status 1; otherwise."""
RESULTS = Path(__file__).parent / "results" / "textbook.csv"


def angle(t: Any) -> Any:
    """A chirp of 0.1 to 15 Hz in 20 s and a slow sine, rad: both slow and fast, small and large motion."""
    return 0.31 * np.sin(_phase(t)) + 0.09 * np.sin(_slow(t))


def rate(t: Any) -> Any:
    return 0.31 * _speed(t) * np.cos(_phase(t)) + 0.09 * _SLOW * np.cos(_slow(t))


def acceleration(t: Any) -> Any:
    turning = _GROWTH * np.cos(_phase(t)) - _speed(t) ** 2 * np.sin(_phase(t))
    return 0.31 * turning - 0.09 * _SLOW**2 * np.sin(_slow(t))


_GROWTH, _SLOW = 2.0 * np.pi * 14.9 / 20.0, 2.0 * np.pi * 0.41


def _speed(t: Any) -> Any:
    return 2.0 * np.pi * 0.1 + _GROWTH * t


def _phase(t: Any) -> Any:
    return 2.0 * np.pi * 0.1 * t + 0.5 * _GROWTH * t**2 + 1.0


def _slow(t: Any) -> Any:
    return _SLOW * t + 2.0


@cache
def state(law: Callable[..., float], *values: float) -> Array:
    """The state z (n,) of dz/dt = law(z, t, *values), integrated from `BEFORE` on."""
    times = np.concatenate([[-BEFORE], TIME])
    return np.asarray(odeint(law, 0.0, times, values, rtol=1e-8, atol=1e-9, hmax=2e-3, mxstep=100_000)[1:, 0])


def dahl(z: Array, t: float, reach: float) -> float:
    v = rate(t)
    return float((v - abs(v) * z[0]) / reach)


def bouc_wen(z: Array, t: float, length: float) -> float:
    v = rate(t)
    return float(v * (1.0 - (abs(z[0]) if v * z[0] > 0.0 else 0.0)) / length)


def maxwell(y: Array, t: float, tau: float) -> float:
    return float((angle(t) - y[0]) / tau)


def lagging(r: Array, t: float, lag: float, *factors: float) -> float:
    """factors: stiffness, damping and inertia, SI."""
    stiffness, damping, inertia = factors
    return float((stiffness * angle(t) + damping * rate(t) + inertia * acceleration(t) - r[0]) / lag)


def parallel(p: Values, t: Any = TIME) -> Any:
    return p["Kc"] * angle(t) + p["Bc"] * rate(t)


def beyond(p: Values) -> Array:
    """The deflection from the flank that touches, 0 in the gap."""
    from_centre = angle(TIME) - p["centre"]
    return np.asarray(np.sign(from_centre) * np.maximum(np.abs(from_centre) - 0.5 * p["gap"], 0.0))


def backlash(p: Values) -> Array:
    """Spring and damper beyond the gap, which push and do not pull."""
    torque = p["Kc"] * beyond(p) + p["Bc"] * rate(TIME)
    return np.where(torque * beyond(p) > 0.0, torque, 0.0)


def slack(p: Values) -> Array:
    stretch = angle(TIME) - p["slack"]
    return np.where(stretch > 0.0, np.maximum(p["Kc"] * stretch + p["Bc"] * rate(TIME), 0.0), 0.0)


def stretched(p: Values) -> Array:
    return np.asarray(p["Kc"] * (angle(TIME) - p["rest"]))


def capstan(p: Values) -> Array:
    tension = stretched(p) + p["Bc"] * rate(TIME)
    return tension + p["mu"] * np.abs(tension) * np.sign(rate(TIME))


def pulley(p: Values) -> Array:
    spring = stretched(p)
    return np.asarray(spring + p["mu"] * np.abs(spring) * np.sign(rate(TIME)) + p["Bc"] * rate(TIME))


def sheath(p: Values) -> Array:
    tension = stretched(p) + p["Bc"] * rate(TIME)
    return np.asarray(tension + p["mu"] * np.abs(tension) * state(dahl, p["reach"]))


def gear(p: Values) -> Array:
    force = backlash(p)
    return np.asarray(force + (p["Fd"] + p["mu"] * np.abs(force)) * state(dahl, p["reach"]))


def exponential(u: Array, b: float) -> Array:
    return np.asarray(2.0 * (np.exp(u) - 1.0 - u) / b**2)


X, V = angle(TIME), rate(TIME)
LAWS: Mapping[str, Callable[[Values], Array]] = {
    "linear": parallel,
    "offset": parallel,
    "drift": lambda p: parallel(p) + p["drift"] * TIME,
    "coulomb": lambda p: parallel(p) + p["Fc"] * np.sign(V),
    "stribeck": lambda p: parallel(p) + (p["Fc"] + p["Fs"] * np.exp(-((V / p["vst"]) ** 2))) * np.sign(V),
    "smooth": lambda p: parallel(p) + p["Fc"] * np.tanh(V / p["vr"]),
    "dahl": lambda p: parallel(p) + p["Fd"] * state(dahl, p["reach"]),
    "boucwen": lambda p: parallel(p) + p["Fy"] * state(bouc_wen, p["yield"]),
    "quadratic": lambda p: parallel(p) + p["B2"] * V * np.abs(V),
    "cubic": lambda p: parallel(p) + p["K3"] * X**3,
    "quintic": lambda p: parallel(p) + p["K3"] * X**3 + p["K5"] * X**5,
    "asymmetric": lambda p: parallel(p) + p["Ka"] * np.abs(X - p["turn"]),
    "progressive": lambda p: parallel(p) + p["Kp"] * X**2,
    "hardening": lambda p: parallel(p) + p["Kh"] * X * np.abs(X),
    "exponential": lambda p: parallel(p) + p["Kh"] * np.sign(X) * exponential(p["exponent"] * np.abs(X), p["exponent"]),
    "toe": lambda p: parallel(p) + p["Kp"] * exponential(p["exponent"] * X, p["exponent"]),
    "softening": lambda p: parallel(p) + p["Ks"] * (TIME - 0.5 * TIME[-1]) * X,
    "maxwell": lambda p: parallel(p) + p["K1"] * (X - state(maxwell, p["tau1"])),
    "maxwell2": lambda p: LAWS["maxwell"](p) + p["K2"] * (X - state(maxwell, p["tau2"])),
    "inertia": lambda p: parallel(p) + p["J"] * acceleration(TIME),
    "backlash": backlash,
    "deadband": lambda p: p["Kc"] * beyond(p) + p["Bc"] * V,
    "slack": slack,
    "capstan": capstan,
    "pulley": pulley,
    "sheath": sheath,
    "gear": gear,
    "skew": parallel,
    "lag": parallel,
    "mean": parallel,
}
"""The torque of the coupling (n,), N m, by the name of the effect, without the offset of the reading."""


def reading(name: str, p: Values, motor: tuple[float, float]) -> Array:
    """What the sensor reads (n,), N m at the joint. motor: inertia and damping of the motor at the joint, 0 of none."""

    def torque(t: Any) -> Any:
        return parallel(p, t) + motor[0] * acceleration(t) + motor[1] * rate(t)

    if name == "skew":
        return np.asarray(torque(TIME - p["skew"]))
    if name == "lag":
        return state(lagging, p["lag"], p["Kc"], p["Bc"] + motor[1], motor[0])
    if name == "mean":
        return np.asarray(torque(TIME[:, None] + p["window"] * (np.arange(100) / 100 - 0.495)).mean(axis=1))
    return LAWS[name](p) + motor[0] * acceleration(TIME) + motor[1] * rate(TIME)


@cache
def example(name: str, size: str) -> Values:
    """The parameters, SI, of a record's example; what the term needs has its plain size.

    A spring that curves stands on a bench whose torque has its zero where the joint is unloaded: Kc is that place's.
    """
    given = dict(example(TERMS[name].needs or "linear", "plain")) if name != "linear" else {}
    given |= {"tau0": 0.0} if TERMS[name].role == "curve" else {}
    stroke = float(np.ptp(X))
    for word in TERMS[name].example.split("; "):
        found = re.fullmatch(r"(\w+) ([-\d., e]+)( % of (?:torque|stroke)|)(?: [\w*/]+|)", word)
        assert found, f"{name}: {word}"
        numbers = [float(number) for number in found[2].split(", ")]
        value = numbers[SIZES.index(size)] if len(numbers) > 1 else numbers[0]
        given[found[1]] = 0.01 * value * stroke if found[3].endswith("stroke") else value
        if found[3].endswith("torque"):
            given[found[1]] = 0.01 * value * given["Kc"] * float(np.abs(X).max())
    return given if "torque" not in TERMS[name].example else _scaled(name, given)


def _scaled(name: str, given: dict[str, float]) -> Values:
    """Torques become parameters, each of which makes that torque at its largest."""
    for word in TERMS[name].example.split("; "):
        if word.endswith("torque"):
            of = word.split()[0]
            if of == "tau0":
                continue
            one = LAWS[name](given | {of: 1.0}) - LAWS[name](given | {of: 0.0})
            given[of] /= float(np.abs(one).max())
    return given


class Row(NamedTuple):
    """One recording of the table."""

    term: str
    size: str
    noise: int
    torque: str
    seed: int


def channels(row: Row) -> dict[str, Array]:
    """The recording, (n,) each, SI."""
    p = example(row.term, row.size)
    motor = (INERTIA * GEAR**2, DAMPING * GEAR**2) if row.torque == "motor" else (0.0, 0.0)
    noise = np.random.default_rng([row.seed, crc32("/".join(map(str, row)).encode())]).standard_normal(SAMPLES)
    torque = reading(row.term, p, motor) + row.noise * NOISE * noise
    torque += p.get("tau0", 0.0)
    found = {"time": TIME, "read_time": TIME, "dtheta": X, "torque": torque}
    if row.torque == "motor":
        found |= {"motor_torque": torque / GEAR, "motor_position": X * GEAR}
    return found


def record(row: Row, path: Path) -> None:
    """Write the recording of a row."""
    text = STAND if row.torque == "motor" else ""
    write(path, Header(profile={"kind": "prescribed"}, stand_toml=text, seed=row.seed), channels(row))


def judged(row: Row, *, with_name: bool = True, selected: bool = True) -> dict[str, Any]:
    """The row of the table: how far the named model is off, and what the default options say."""
    with tempfile.TemporaryDirectory() as folder:
        record(row, path := Path(folder) / "one.h5")
        found = row._asdict() | (named(row, path) if with_name else {})
        return found | (by_default(row, path) if selected else {})


def named(row: Row, path: Path) -> dict[str, Any]:
    """off: of the parameters the largest error, in half widths, and whose. better: contained models that fit better."""
    model, truth, began = with_needs(row.term), dict(example(row.term, row.size)), time.perf_counter()
    result = hil.identify(path, model, workers=1)
    if "tau2" in truth and result["tau1"].value > result["tau2"].value:  # the two branches are alike
        truth = truth | {f"{a}{n}": truth[f"{a}{3 - n}"] for a in ("K", "tau") for n in (1, 2)}
    # tau0 is the torque at the deflection that deflections count from
    elsewhere = {"tau0"} if "unloaded-place" in {one.code for one in result.diagnostics} else set()
    off = {
        one.name: abs(one.value - truth.get(one.name, 0.0)) / max(one.half_width, 1e-300)
        for one in result.identification.estimates
        if one.name not in elsewhere
    }
    worst = max(off, key=lambda name: off[name])
    return {
        "named": model,
        "off": round(off[worst], 2),
        "of": worst,
        "better": " ".join(contained(row.term, model, path, result)),
        "named_trusted": result.trustworthy,
        "named_s": round(time.perf_counter() - began, 1),
    }


def joint(term: str) -> float:
    """Half widths within which all parameters of the smallest model with a term are in 95 of 100 recordings."""
    count = sum(len(TERMS[one].parameters) for one in with_needs(term).split("+"))
    return float(norm.isf(0.025 / count) / norm.isf(0.025))


def with_needs(term: str) -> str:
    """The smallest model with a term."""
    return canonical("linear") if term == "linear" else canonical(f"{with_needs(TERMS[term].needs or 'linear')}+{term}")


def contained(term: str, model: str, path: Path, result: hil.IdentificationResult) -> Iterable[str]:
    """The models that the named one contains, and whose error, in the samples of both, is smaller."""
    dropped = "+".join(one for one in model.split("+") if one != term)
    for name in {"linear", dropped} - {model, ""}:
        smaller = hil.identify(path, name, workers=1)
        here, there = result.identification, smaller.identification
        # a model with dry friction leaves out slow samples
        allowed = 1.0 + (1e-4 if here.samples == there.samples else 0.01)
        if there.optimum * allowed < here.optimum:
            yield name


def by_default(row: Row, path: Path) -> dict[str, Any]:
    """What the default options say. outcome: one of OUTCOMES, the worse of Kc and Bc."""
    truth, began = example(row.term, row.size), time.perf_counter()
    try:
        result = hil.identify(path, workers=1)
    except hil.NoResult:
        return {"selected": "", "outcome": "refused"}
    errors = {name: result[name].value / truth[name] - 1.0 for name in ("Kc", "Bc")}
    halves = {name: result[name].half_width / truth[name] for name in ("Kc", "Bc")}
    outcomes = [
        outcome(errors[name], halves[name], bars, known=result.trusted(name)) for name, bars in (("Kc", KC), ("Bc", BC))
    ]
    said = "refused" if not result.trustworthy else max(outcomes, key=OUTCOMES.index)
    return {
        "selected": result.model,
        "outcome": said,
        **{f"{name}_percent": f"{100 * errors[name]:+.2f} +- {100 * halves[name]:.2f}" for name in errors},
        "codes": " ".join(sorted({one.code for one in result.diagnostics})),
        "selected_s": round(time.perf_counter() - began, 1),
    }


def outcome(error: float, half: float, bars: Mapping[str, float], *, known: bool) -> str:
    if abs(error) > max(bars["right"], 1.5 * half) and known:
        return "wrong"
    if abs(error) <= bars["right"] or abs(error) <= half <= bars["wide"]:
        return "right"
    return "wide" if abs(error) <= half else "missed"


def rows_of(terms: Sequence[str]) -> list[Row]:
    """All rows of the terms; first one of each term, then another of each, spread over sizes, noises and seeds."""
    rows = (
        sorted(
            (Row(term, *rest) for rest in product(SIZES, NOISES, SOURCES, SEEDS)),
            key=lambda row: crc32(f"{row}".encode()),
        )
        for term in terms
    )
    return [row for each in zip(*rows, strict=True) for row in each]


def table(rows: Iterable[Mapping[str, Any]]) -> list[str]:
    """Lines of Markdown: for each effect and size, in how many of its rows it was right."""
    lines = ["| effect | size | rows | named | selected |", "|---|---|---|---|---|"]
    rows = list(rows)
    for term in TERMS:
        for size in SIZES:
            own = [row for row in rows if (row["term"], row["size"]) == (term, size)]
            good = sum(float(row["off"]) <= joint(term) and not row["better"] for row in own)
            said = Counter(row["outcome"] for row in own)
            counts = ", ".join(f"{said[one]} {one}" for one in OUTCOMES if said[one])
            lines += [f"| `{term}` | {size} | {len(own)} | {good} | {counts} |"] if own else []
    return lines


FIELDS = (*Row._fields, "named", "off", "of", "better", "named_trusted", "named_s", "selected", "outcome")
FIELDS = (*FIELDS, "Kc_percent", "Bc_percent", "codes", "selected_s")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--terms", default=",".join(LAWS), help="only these, separated by commas")
    parser.add_argument("--rows", type=int, default=10_000, help="at most so many further rows")
    parser.add_argument("--again", action="store_true", help="make the rows anew")
    parser.add_argument("--results", type=Path, default=RESULTS)
    options = parser.parse_args()
    wanted = rows_of(options.terms.split(","))
    old: list[dict[str, Any]] = []
    if options.results.exists():
        with options.results.open(encoding="utf-8", newline="") as file:
            old = list(csv.DictReader(file))
    terms = set(options.terms.split(",")) if options.again else set()
    old = [row for row in old if row["term"] not in terms]
    done = {tuple(str(row[name]) for name in Row._fields) for row in old}
    wanted = [row for row in wanted if tuple(map(str, row)) not in done][: options.rows]
    with options.results.open("w", encoding="utf-8", newline="") as file:
        lines = csv.DictWriter(file, FIELDS, restval="", lineterminator="\n")
        lines.writeheader()
        lines.writerows(old)
        for row in wanted:
            old.append(judged(row))
            lines.writerow(old[-1])
            file.flush()
    print("\n".join(table(old)))


if __name__ == "__main__":
    main()
