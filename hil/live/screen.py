"""The live view as text for a terminal of any size: traces, torque-deflection loop, margins to the limits, first
estimates.
"""

from __future__ import annotations

import math
from itertools import zip_longest
from typing import Any, NamedTuple

from hil.live.state import Margin, State

_SMALLEST = (60, 16)  # columns and lines below which there is a single line
_POINTS = 400  # of a trace
_LEGEND = 4  # lines below the pictures
_ASCII = str.maketrans("─│┌┐└┘├┤┬┴┼", "-|+++++++++")
_TALL = 8  # lines of a picture for which its ticks are a line further apart
_ROUND = (1.0, 1.5, 2.0, 2.5, 3.0, 4.0, 5.0, 10.0, 15.0, 20.0, 25.0, 30.0, 40.0, 50.0)
_SHOWN = {"time": (1.0, "s"), "torque": (1e3, "torque, mN m"), "dtheta": (1e3, "deflection, mrad")}
KEYS = "space or q: stop softly, and keep the rows; q again: torque off at once"


def drawn(state: State, width: int, height: int, *, unicode: bool = True, keys: bool = False) -> str:
    """Return the text of the live view: at most `width` columns and `height` lines, without colours.

    unicode: whether the terminal can show line and dot characters. keys: whether keys are read; then the text names
    them.
    """
    if state.count < 2:
        return "starting"
    if width < _SMALLEST[0] or height < _SMALLEST[1]:
        return line(state)[:width]
    rows = min(height - 2, 24) - _LEGEND - int(keys)
    left, right = width * 3 // 5, width - width * 3 // 5
    marker = "braille" if unicode else "*"
    torque = _plot(state, ("time", "torque"), (left, rows // 2), marker)
    dtheta = _plot(state, ("time", "dtheta"), (left, rows - rows // 2), marker)
    loop = _plot(state, ("dtheta", "torque"), (right, rows), marker)
    pictures = [f"{one:<{left}}{other}".rstrip() for one, other in zip_longest([*torque, *dtheta], loop, fillvalue="")]
    text = "\n".join([*pictures, *(one[:width] for one in _legend(state)), *([KEYS[:width]] if keys else [])])
    return text if unicode else text.translate(_ASCII).encode("ascii", "replace").decode()


def line(state: State) -> str:
    """Return a summary of the state in one line of less than 80 columns."""
    if state.count < 2:
        return "starting"
    torque, angle = state.last
    return (
        f"{state.left:6.1f} s left  {state.rate:5.0f} Hz  torque {_torque(torque):>11} at {angle:+7.4f} rad  "
        f"{state.lost} lost"
    )


def _legend(state: State) -> list[str]:
    torque, angle = state.last
    margins = [_margin(one) for one in state.margins]
    return [
        f"{state.left:.1f} s left   {state.rate:.0f} Hz, jitter {state.jitter * 1e6:.0f} us   {state.lost} lost   "
        f"{_torque(torque)} at {angle:+.4f} rad",
        "limits: " + ("   ".join(margins) or "none known"),
        _estimates(state),
        "",
    ]


def _margin(one: Margin) -> str:
    return f"{one.name} {one.used:.0%} of {one.limit:g} {one.unit}"


def _estimates(state: State) -> str:
    found = state.fit.estimate
    if found is None:
        return "preliminary: Kc and Bc cannot be estimated yet"
    kc, bc = found
    factor, unit = (1.0, "N m") if abs(kc) >= 1.0 else (1e3, "mN m")
    return f"preliminary: Kc {kc * factor:.4g} {unit}/rad   Bc {bc * factor:.3g} {unit} s/rad   (hil identify decides)"


def _torque(value: float) -> str:
    return f"{value:+.2f} N m" if abs(value) >= 1.0 else f"{value * 1e3:+.2f} mN m"


class Axis(NamedTuple):
    """The scale of an axis: the values at its first and its last character, and its ticks with their texts."""

    ends: tuple[float, float]
    ticks: list[float]
    texts: list[str]


def axis(low: float, high: float, cells: int, apart: int) -> Axis | None:
    """Return the narrowest axis of `cells` characters that holds `low` to `high`; None if it has no room for two ticks.

    The ticks are round numbers, whole characters from one to the next, at least `apart`.
    """
    if cells <= apart:
        return None
    least = max(high - low, 1e-3 * abs(high), 1e-6) / (cells - 1)  # of one character
    power = 10.0 ** math.floor(math.log10(least * apart))
    for size, step in sorted((m * power / k, m * power) for m in _ROUND for k in range(apart, 2 * apart)):
        start = math.floor(low / size) * size
        end = start + (cells - 1) * size
        ticks = [at * step for at in range(math.ceil(start / step - 1e-9), math.floor(end / step + 1e-9) + 1)]
        if end >= high and len(ticks) > 1:
            break
    else:
        return None
    digits = max(0, 1 - math.floor(math.log10(step)))
    texts = [f"{round(one, digits) + 0.0:.{digits}f}" for one in ticks]
    while all(text.endswith("0") for text in texts) and "." in texts[0]:
        texts = [text[:-1].rstrip(".") for text in texts]
    return Axis((start, end), ticks, texts)


def _plot(state: State, channels: tuple[str, str], size: tuple[int, int], marker: str) -> list[str]:
    """Return a plot of one channel over another as lines of text, all of the same width."""
    import plotext

    plot: Any = plotext
    x, y = state.points(*channels, _POINTS)
    plot.clear_figure()
    plot.plot_size(*size)
    plot.theme("clear")
    plot.title(_SHOWN[channels[1]][1] + ("" if channels[0] == "time" else " over mrad"))
    if len(x):
        across, up = x * _SHOWN[channels[0]][0], y * _SHOWN[channels[1]][0]
        labels = 0
        if vertical := axis(float(up.min()), float(up.max()), size[1] - 4, min(3, 1 + size[1] // _TALL)):
            labels = max(map(len, vertical.texts))
            plot.ylim(*vertical.ends)
            plot.yticks(vertical.ticks, vertical.texts)
        if level := axis(float(across.min()), float(across.max()), size[0] - labels - 2, max(8, size[0] // 6)):
            plot.xlim(*level.ends)
            plot.xticks(level.ticks, level.texts)
        plot.plot(across.tolist(), up.tolist(), marker=marker)
    text = str(plot.uncolorize(plot.build()))
    return [one[: size[0]].ljust(size[0]) for one in text.splitlines()]
