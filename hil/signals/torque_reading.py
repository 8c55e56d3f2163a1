"""Recognise a torque reading that is later than the models of the coupling describe."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hil.signals.constants import DELAYS_A_PERIOD, LATE, LATEST
from hil.signals.prepare import Signals

Array = NDArray[np.float64]


def long_delay(signals: Signals, longest: float) -> str:
    """Return, as text, the delay of the torque reading and the remedy, if the delay exceeds `longest`, s; else "".

    longest: the longest delay that the models of the coupling describe.
    """
    motion = signals.motion
    if signals.slower or motion.part_of is not None or len(motion.starts) > 1:
        return ""
    late = _delay(signals, motion.step)
    if late <= longest:
        return ""
    return (
        f"the torque reading is {1e3 * late:.3g} ms late, and a model corrects at most {1e3 * longest:.2g} ms. "
        "Subtract the delay from the time stamps of the torque, or find what delays its readings"
    )


def _delay(signals: Signals, step: float) -> float:
    """Return the delay of the torque, s, if spring and damper explain the torque much better with that delay; else
    0.
    """
    motion, torque = signals.motion, signals.torque
    columns = np.stack([motion.dtheta, motion.dtheta_dot, np.ones(len(motion))], axis=1)
    pace = max(step, 1.0 / (DELAYS_A_PERIOD * signals.band[1]))
    most = min(int(LATEST / pace), len(torque) // (4 * max(1, round(pace / step))))
    tried = pace * np.arange(most + 1)
    inside = slice(int(LATEST / step) + 1, None)

    def left(delay: float) -> float:
        shift = round(delay / step)
        then = columns[inside.start - shift : len(columns) - shift]
        found = torque[inside]
        return float(np.sum((found - then @ np.linalg.lstsq(then, found, rcond=None)[0]) ** 2))

    if len(torque[inside]) < 8 * columns.shape[1]:
        return 0.0
    rest = np.array([left(delay) for delay in tried.tolist()])
    return float(tried[np.argmin(rest)]) if rest.min() < LATE * rest[0] else 0.0
