"""The live view as text for a terminal of any size: traces, torque-deflection loop, margins to the limits, first
estimates.
"""

from __future__ import annotations

from itertools import zip_longest
from typing import Any

from hil.live.state import Margin, State

_SMALLEST = (60, 16)  # columns and lines below which there is a single line
_POINTS = 400  # of a trace
_LEGEND = 4  # lines below the pictures
_ASCII = str.maketrans("─│┌┐└┘├┤┬┴┼", "-|+++++++++")
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
        plot.plot((x * _SHOWN[channels[0]][0]).tolist(), (y * _SHOWN[channels[1]][0]).tolist(), marker=marker)
    text = str(plot.uncolorize(plot.build()))
    return [one[: size[0]].ljust(size[0]) for one in text.splitlines()]
