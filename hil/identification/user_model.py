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

import inspect
import re
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from types import FunctionType, ModuleType
from typing import Annotated, Any, get_args, get_origin, get_type_hints

import numpy as np

from ga.arrays import Array, Mask
from ga.model.record import Parameter, Term
from ga.model.separable import SeparableModel
from ga.model.terms import PARAMETERS, TERMS, add
from ga.model.trajectory import Motion
from hil.errors import WrongUse
from hil.plugins import MODELS, plugins
from hil.signals import constants as c

_TORQUE = re.compile(
    r"[mu]?N[\s*.·]?m(?![a-z])"
)  # what a unit begins with that is a torque, by itself or per something


@dataclass(frozen=True)
class UserModel:
    """A user's model in the form that `ga.model.separable` needs: it has no columns, and every parameter is nonlinear.

    low, high (q,): the bounds of the parameters, SI.
    """

    name: str
    function: Callable[..., Any]
    nonlinear: tuple[Parameter, ...]
    low: Array
    high: Array
    linear: tuple[Parameter, ...] = ()
    needs_ratio: bool = False
    chooses_edge: bool = False
    sticks: bool = False

    def __reduce__(self) -> tuple[Callable[[str], UserModel], tuple[str]]:
        """Return the instructions for pickling: another process loads the model by its name, because its file is no
        importable module.
        """
        return load, (self.name,)

    def anchored(self, motion: Motion) -> UserModel:
        """Return the model itself. Raises WrongUse if the function cannot be used on these data."""
        self._torque(motion, 0.5 * (self.low + self.high))
        return self

    def described(self, motion: Motion, _delay: float = 0.0) -> Mask:
        """Return that the model describes all samples (n,)."""
        return np.ones(len(motion), dtype=bool)

    def delay(self, _nonlinear: Array | None) -> float:
        """Return the delay of the torque reading, 0 s: the function gets angle and torque as they were read."""
        return 0.0

    def bounds(self, _motion: Motion, _highest: float) -> tuple[Array, Array]:
        """Return the lowest and the highest values (q,) of the parameters."""
        return self.low, self.high

    def columns(self, motion: Motion, _nonlinear: Array | None = None, _lag: float = 0.0) -> Array:
        """Return no columns, (n, 0)."""
        return np.zeros((len(motion), 0))

    def target(self, motion: Motion, torque: Array, nonlinear: Array | None = None) -> Array:
        """Return the torque (n,), N m, less the known part of the torque and less the value of the user's function."""
        values = 0.5 * (self.low + self.high) if nonlinear is None else nonlinear
        return np.asarray(torque - motion.known - self._torque(motion, values))

    def jacobian(
        self, motion: Motion, nonlinear: Array, _genes: Array, _lag: float = 0.0, _torque: Array | None = None
    ) -> Array:
        """Return the derivative of the torque by each parameter, (n, q), from differences within the bounds."""
        found = []
        for at, width in enumerate(self.high - self.low):
            step = np.zeros(len(nonlinear))
            step[at] = c.JACOBIAN_STEP * width
            above, below = np.minimum(nonlinear + step, self.high), np.maximum(nonlinear - step, self.low)
            found.append((self._torque(motion, above) - self._torque(motion, below)) / (above[at] - below[at]))
        return np.stack(found, axis=1)

    def _torque(self, motion: Motion, values: Array) -> Array:
        given = dict(zip((parameter.name for parameter in self.nonlinear), values.tolist(), strict=True))
        where = ", ".join(f"{name} = {value:g}" for name, value in given.items())
        whole, rows = (motion, slice(None)) if motion.behind is None else motion.whole
        arrays = [_read_only(values) for values in (whole.time, whole.dtheta, whole.dtheta_dot)]
        try:
            answer = np.asarray(self.function(*arrays, **given))
        except (Exception, SystemExit) as error:
            raise WrongUse(f"--model {self.name}: it raised {type(error).__name__}: {error}; at {where}") from error
        if answer.dtype.kind not in "fiu":
            raise WrongUse(f"--model {self.name}: it gave {answer.dtype} and not real numbers; at {where}")
        torque = answer.astype(np.float64)
        if torque.shape != whole.time.shape:
            raise WrongUse(f"--model {self.name}: it gave {torque.shape} for {whole.time.shape} samples; at {where}")
        if not np.isfinite(torque).all():
            raise WrongUse(f"--model {self.name}: it gave a torque that is not a number; at {where}")
        return whole.filtered(torque)[rows]


def _read_only(values: Array) -> Array:
    """Return a read-only view of the values, so that a function that writes into its arguments cannot change the
    recording.
    """
    view = values.view()
    view.flags.writeable = False
    return view


def refuse_without_coupling(model: SeparableModel | None, need: str, remedy: str = "") -> None:
    """Raise WrongUse if a model lacks Kc or Bc. need, remedy: text for what needs them, and for what else may help."""
    names = [parameter.name for parameter in (*model.linear, *model.nonlinear)] if model else []
    if model and not set(c.COUPLING) <= set(names):
        has = f"model {model.name!r} has {', '.join(names)}"
        raise WrongUse(f"{need}, but {has}: give its parameters these names{remedy}")


def of_package(name: str) -> UserModel | None:
    """Return the model of an entry point of the group `hil.models`; None if no entry point has this name.

    If entry points name coupling terms (`ga.model.record.Term`) of the model, these terms are added to the table of
    terms. Raises WrongUse if an entry point cannot be loaded.
    """
    known = plugins(MODELS)
    found = {word: known[word].load(Term, FunctionType) for word in name.split("+") if word in known}
    for word, one in found.items():
        if isinstance(one, Term):
            try:
                add(one)
            except ValueError as error:
                raise WrongUse(f"--model {name}: {word} of {known[word].package}: {error}") from None
    whole = found.get(name)
    return None if whole is None or isinstance(whole, Term) else _of(name, whole)


def listed() -> list[tuple[str, str]]:
    """Return name and meaning of every term, and of the models of other packages, with the name of the package.

    A model that cannot be loaded is listed with the reason.
    """
    lines = [(term.name, term.meaning) for term in TERMS.values() if term.name not in plugins(MODELS)]
    for name, plugin in plugins(MODELS).items():
        try:
            found = plugin.load(Term, FunctionType)
            meaning = found.meaning if isinstance(found, Term) else (found.__doc__ or "a model").strip().splitlines()[0]
            lines.append((name, f"{meaning} ({plugin.package})"))
        except WrongUse as error:
            lines.append((name, f"skipped: {error}"))
    return lines


def load(name: str) -> UserModel:
    """Return the model of `path/to/model.py:name`, or of an entry point. Raises WrongUse if there is none."""
    if ".py:" not in name and (found := of_package(name)) is not None:
        return found
    path, _, function = name.rpartition(":")
    file = Path(path)
    if not file.is_file():
        raise WrongUse(f"--model {name}: there is no file {path}; write path/to/model.py:name")
    if file.suffix != ".py":
        raise WrongUse(f"--model {name}: {path} is not a Python file")
    module = ModuleType(file.stem)
    module.__file__ = str(file)
    try:  # an import would write a folder of its own beside the user's file
        exec(compile(file.read_bytes(), file, "exec"), module.__dict__)  # noqa: S102
    except (Exception, SystemExit) as error:
        raise WrongUse(f"--model {name}: {path} raised {type(error).__name__}: {error}") from error
    found = getattr(module, function, None)
    if not callable(found):
        raise WrongUse(f"--model {name}: {path} has no function {function}")
    return _of(name, found)


def _of(name: str, function: Callable[..., Any]) -> UserModel:
    try:
        hints = get_type_hints(function, include_extras=True)
    except NameError as error:
        raise WrongUse(f"--model {name}: an annotation of it cannot be read ({error})") from None
    keywords = [p.name for p in inspect.signature(function).parameters.values() if p.kind is p.KEYWORD_ONLY]
    if not keywords:
        raise WrongUse(
            f"--model {name}: no parameters. Put them behind a * in the function's arguments, each with its unit and "
            "bounds: *, k: Annotated[float, unit, low, high]"
        )
    parameters, bounds = [], []
    for keyword in keywords:
        unit, low, high = _annotation(name, keyword, hints.get(keyword))
        # a name that a term uses, such as a gap, has that parameter's properties
        known = PARAMETERS.get(keyword, Parameter(keyword, unit, "", absent=None))
        scales = _TORQUE.match(unit) is not None
        parameters.append(replace(known, unit=unit, meaning="of the user's model", scales=scales))
        bounds.append((low, high))
    low, high = np.array(bounds).T
    return UserModel(name, function, tuple(parameters), low, high)


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
