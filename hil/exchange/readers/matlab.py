"""Read MAT-files of versions 4 to 7 with SciPy: matrices, structs, cells and what Simulink saves in them.

SciPy ends the process on some damaged files: read them in a copy of the process.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from hil.errors import WrongUse
from hil.exchange.readers.columns import Columns, at, of_matrix


def read(source: Path) -> Columns:
    """Return the columns by the names that MATLAB gives them: "tau", "data(:,2)", "log.q", "out.signals(2).values".

    Raises WrongUse for a file with objects only, such as timeseries, which MATLAB alone can read.
    """
    from scipy.io import loadmat

    objects: dict[str, str] = {}
    with source.open("rb") as file:
        variables = {name: value for name, value in loadmat(file).items() if not str(name).startswith("__")}
    found = {
        column: partial(at, part, index)
        for name, value in variables.items()
        for path, part in _parts(str(name), value, objects)
        for column, index in of_matrix(path, part.shape, matlab=True)
    }
    return found | no_numbers(source, objects, alone=not found)


def no_numbers(source: Path, objects: Mapping[str, str], *, alone: bool) -> dict[str, Callable[[], Any]]:
    """Return for each of MATLAB's objects a column that refuses to be read. objects: their classes by name.

    alone: whether the file holds nothing else; then WrongUse is raised at once.
    """

    def refuse(name: str) -> None:
        raise WrongUse(
            f"{source}: {name!r} is an object of MATLAB's class {objects[name]}, which only MATLAB reads: save vectors "
            "there, such as t = x.Time; tau = x.Data; save('log.mat', 't', 'tau', '-v7'), or in Simulink the format "
            "'Structure With Time'"
        )

    if alone and objects:
        refuse(next(iter(objects)))
    return {name: partial(refuse, name) for name in objects}


def _parts(name: str, value: Any, objects: dict[str, str]) -> Iterator[tuple[str, Any]]:
    """Yield every array of numbers or texts in a variable with its name; the objects go into `objects`."""
    from scipy.io.matlab import MatlabFunction, MatlabObject, MatlabOpaque

    if isinstance(value, MatlabOpaque):
        own, kind = (np.ravel(value[field])[0] for field in ("s0", "s2"))
        objects[_text(own)] = _text(kind)
    elif isinstance(value, MatlabObject | MatlabFunction):
        objects[name] = getattr(value, "classname", "function_handle")
    elif value.dtype.names is not None and value.size > 1 and (rows := _rows(value)):
        yield from ((f"{name}.{field}", column) for field, column in rows.items())
    elif value.dtype.names is not None:
        for number, element in enumerate(value.ravel(), start=1):
            for field in value.dtype.names:
                yield from _parts(f"{name}{'' if value.size == 1 else f'({number})'}.{field}", element[field], objects)
    elif value.dtype.kind == "O":
        for number, element in enumerate(value.ravel(order="F"), start=1):
            yield from _parts(f"{name}{{{number}}}", element, objects)
    elif value.dtype.kind in "fiub" or (value.dtype.kind == "U" and value.size > 1):
        yield name, value


def _rows(value: Any) -> dict[str, Any]:
    """Return the fields of an array of structs as columns (n,), if each struct is a row of single numbers; else {}."""
    found = {}
    for field in value.dtype.names:
        cells = [np.asarray(one) for one in value.ravel(order="F")[field]]
        if any(one.size != 1 for one in cells):
            return {}
        if all(one.dtype.kind in "fiub" for one in cells):
            found[field] = np.array([one.item() for one in cells], dtype=np.float64)
    return found


def _text(item: Any) -> str:
    return item.decode("latin-1") if isinstance(item, bytes) else str(item)
