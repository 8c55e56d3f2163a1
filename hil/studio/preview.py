"""The preview of a run, computed in a separate process that is ended when a run begins.

`hil design` predicts the same numbers, and also searches the best excitation.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Mapping
from functools import partial
from typing import Any, Final

import numpy as np

from hil.acquisition.excitation import Profile
from hil.api.runs import DEFAULT_RATE, excitation, opened_stand, quantity_of
from hil.errors import WrongUse
from hil.experiment_design.assessment import LIMITED, UNITS, Task, assess, task_of
from hil.experiment_design.response import respond, set_points
from hil.recording.posix import in_child
from hil.report.formatting import json_number
from hil.report.pictures.thinning import trace_rows
from hil.units import quantity

_TIME, _MEMORY = 20, 200 << 20  # s of processor time and bytes for a prediction
_POINTS: Final = 8_000  # of a set-point that is shown without one
_DIMENSIONS: Final = {"duration": "time", "rate": "frequency", "kc": "stiffness", "bc": "damping"}


def preview(stand: str, fields: Mapping[str, str], joint: str | None = None) -> dict[str, Any]:
    """Return the preview of a run, SI. stand: a stand file or "sim"; joint: of a hand's file. fields: the excitation,
    and rough "kc" and "bc".

    curves: lists by name: time, command and, with a prediction, torque and dtheta. limits: by name, the peak, the
    limit, its unit, and peak divided by limit. errors: relative standard errors of Kc and Bc, None if they are not
    identifiable. said: the reason if there is no prediction. Raises WrongUse for an excitation that `hil record` would
    refuse.
    """
    opened, mode = opened_stand(stand, joint), quantity_of(fields.get("mode", "torque"))
    units = _DIMENSIONS | {"amplitude": "torque" if mode == "torque" else "angle"}
    given = {name: _number(name, fields[name], unit) for name, unit in units.items() if name in fields}
    low, _, high = fields.get("band", "").partition(":")
    band = (_number("band", low, "frequency"), _number("band", high or low, "frequency")) if low else None
    rate = given.get("rate", DEFAULT_RATE)
    size = (given.get("amplitude"), band, given.get("duration"))
    profile = excitation(opened, fields.get("profile", "chirp"), mode, size, rate=rate, setpoints=None)
    found = {"amplitude": profile.amplitude, "duration": profile.duration, "rate": rate, "limits": {}, "errors": {}}
    rough = {"kc": given.get("kc"), "bc": given.get("bc"), "torque_noise": None}
    try:
        task = task_of(opened, **rough, model="auto", mode=mode, rate=rate)
        more = in_child(partial(_predicted, task, profile), processor=_TIME, memory=_MEMORY)
        said = "the run is too long to be predicted here: `hil design` in a terminal predicts it"
    except WrongUse as error:
        more, said = None, str(error)
    if more is None:
        time = np.linspace(0.0, profile.duration, min(_POINTS, round(profile.duration * rate) + 1))
        more = {"said": said, "curves": {"time": time.tolist(), "command": profile.at(time).tolist()}}
    return found | more


def _predicted(task: Task, profile: Profile) -> dict[str, Any]:
    judged, (motion, _) = assess(task, profile), respond(task.joint, profile, task.rate)
    limits = zip(LIMITED, UNITS, judged.peaks, task.limits, judged.shares, strict=True)
    curves = {"command": set_points(profile, task.rate), "torque": motion.torque, "dtheta": motion.dtheta}
    rows = trace_rows(*curves.values())
    return {
        "limits": {
            name: {"unit": unit, "peak": p, "limit": most, "used": used} for name, unit, p, most, used in limits
        },
        "errors": {name: json_number(judged[name].error / judged[name].rough) for name in ("Kc", "Bc")},
        "curves": {"time": (rows / task.rate).tolist()} | {name: one[rows].tolist() for name, one in curves.items()},
    }


def _number(name: str, text: str, dimension: str) -> float:
    try:
        return quantity(text, dimension)[0]
    except WrongUse as error:
        raise WrongUse(f"{name} {error}") from None


if __name__ == "__main__":
    try:
        answer = preview(sys.argv[1], json.loads(sys.argv[3]), sys.argv[2] or None)
    except WrongUse as refused:
        answer = {"refused": str(refused)}
    sys.stdout.write(json.dumps(answer, allow_nan=False))
