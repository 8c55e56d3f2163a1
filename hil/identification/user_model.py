"""A user's own model: a Python function with named, bounded, united parameters.

    from typing import Annotated

    def creeping(time, dtheta, dtheta_dot, *,
                 Kc: Annotated[float, "N*m/rad", 0.0, 1.0],
                 Bc: Annotated[float, "N*m*s/rad", 0.0, 0.01],
                 n: Annotated[float, "-", 0.5, 2.0]):
        return Kc * np.sign(dtheta) * np.abs(dtheta) ** n + Bc * dtheta_dot

`hil identify REC.h5 --model model.py:creeping`. The function gets arrays (n,) in SI and gives the torque (n,) in N m.
All its parameters are searched.
"""

from __future__ import annotations

import importlib.util
import inspect
import re
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, get_args, get_origin, get_type_hints

import numpy as np
from numpy.typing import NDArray

from ga.model.terms import Parameter
from ga.model.trajectory import Motion
from hil.errors import WrongUse

Array = NDArray[np.float64]

_TORQUE = re.compile(
    r"[mu]?N[\s*.·]?m(?![a-z])"
)  # what a unit begins with that is a torque, by itself or per something
_STEP = 1e-6  # of the bounds' width, for the slopes


@dataclass(frozen=True)
class OwnModel:
    """A model of `ga.model.separable` without columns: each parameter is of its shape. low, high: (q,), SI."""

    name: str
    function: Callable[..., Any]
    shape: tuple[Parameter, ...]
    low: Array
    high: Array
    linear: tuple[Parameter, ...] = ()
    lets_go: bool = False

    def anchored(self, motion: Motion) -> OwnModel:
        """The same: it takes nothing from the data. Raises WrongUse where the function cannot be used on them."""
        self._torque(motion, 0.5 * (self.low + self.high))
        return self

    def told(self, motion: Motion, _skew: float = 0.0) -> NDArray[np.bool_]:
        """All samples (n,)."""
        return np.ones(len(motion), dtype=bool)

    def bounds(self, _motion: Motion, _highest: float) -> tuple[Array, Array]:
        """Where each parameter can be: low (q,) and high (q,)."""
        return self.low, self.high

    def columns(self, motion: Motion, _shape: Array | None = None, _lag: float = 0.0) -> Array:
        """None, (n, 0)."""
        return np.zeros((len(motion), 0))

    def target(self, motion: Motion, torque: Array, shape: Array | None = None) -> Array:
        """What the function leaves of the torque (n,), N m."""
        values = 0.5 * (self.low + self.high) if shape is None else shape
        return np.asarray(torque - motion.known - self._torque(motion, values))

    def slopes(self, motion: Motion, shape: Array, _genes: Array, _lag: float = 0.0) -> Array:
        """How the torque changes with each parameter, (n, q), by differences within the bounds."""
        found = []
        for at, width in enumerate(self.high - self.low):
            step = np.zeros(len(shape))
            step[at] = _STEP * width
            above, below = np.minimum(shape + step, self.high), np.maximum(shape - step, self.low)
            found.append((self._torque(motion, above) - self._torque(motion, below)) / (above[at] - below[at]))
        return np.stack(found, axis=1)

    def _torque(self, motion: Motion, values: Array) -> Array:
        given = dict(zip((parameter.name for parameter in self.shape), values.tolist(), strict=True))
        where = ", ".join(f"{name} = {value:g}" for name, value in given.items())
        arrays = [_read_only(values) for values in (motion.time, motion.dtheta, motion.dtheta_dot)]
        try:
            answer = np.asarray(self.function(*arrays, **given))
        except (Exception, SystemExit) as error:
            raise WrongUse(f"--model {self.name}: it raised {type(error).__name__}: {error}; at {where}") from error
        if answer.dtype.kind not in "fiu":
            raise WrongUse(f"--model {self.name}: it gave {answer.dtype} and not real numbers; at {where}")
        torque = answer.astype(np.float64)
        if torque.shape != motion.time.shape:
            raise WrongUse(f"--model {self.name}: it gave {torque.shape} for {motion.time.shape} samples; at {where}")
        if not np.isfinite(torque).all():
            raise WrongUse(f"--model {self.name}: it gave a torque that is not a number; at {where}")
        return torque


def _read_only(values: Array) -> Array:
    """The same: a function that writes into what it is given would change the recording for all that follows."""
    view = values.view()
    view.flags.writeable = False
    return view


def load(name: str) -> OwnModel:
    """The model of `path/to/model.py:name`. Raises WrongUse for a file or function that is none."""
    path, _, function = name.rpartition(":")
    file = Path(path)
    if not file.is_file():
        raise WrongUse(f"--model {name}: there is no file {path}; write path/to/model.py:name")
    spec = importlib.util.spec_from_file_location(file.stem, file)
    if spec is None or spec.loader is None:
        raise WrongUse(f"--model {name}: {path} is not a Python file")
    module = importlib.util.module_from_spec(spec)
    try:
        spec.loader.exec_module(module)
    except (Exception, SystemExit) as error:
        raise WrongUse(f"--model {name}: {path} raised {type(error).__name__}: {error}") from error
    found = getattr(module, function, None)
    if not callable(found):
        raise WrongUse(f"--model {name}: {path} has no function {function}")
    return _of(name, found)


def _of(name: str, function: Callable[..., Any]) -> OwnModel:
    try:
        hints = get_type_hints(function, include_extras=True)
    except NameError as error:
        raise WrongUse(f"--model {name}: an annotation of it cannot be read ({error})") from None
    keywords = [p.name for p in inspect.signature(function).parameters.values() if p.kind is p.KEYWORD_ONLY]
    if not keywords:
        raise WrongUse(f"--model {name}: no parameters; name them after a * as Annotated[float, unit, low, high]")
    shape, bounds = [], []
    for keyword in keywords:
        unit, low, high = _annotation(name, keyword, hints.get(keyword))
        shape.append(Parameter(keyword, unit, "of the user's model", scales=_TORQUE.match(unit) is not None))
        bounds.append((low, high))
    low, high = np.array(bounds).T
    return OwnModel(name, function, tuple(shape), low, high)


def _annotation(name: str, keyword: str, hint: Any) -> tuple[str, float, float]:
    parts = get_args(hint)[1:] if get_origin(hint) is Annotated else ()
    if len(parts) == 3 and isinstance(parts[0], str):
        try:
            low, high = float(parts[1]), float(parts[2])
        except (TypeError, ValueError):
            low = high = np.nan
        if np.isfinite([low, high]).all() and low < high:
            return parts[0], low, high
    raise WrongUse(f'--model {name}: {keyword} needs Annotated[float, "unit", low, high], low below high, in SI')
