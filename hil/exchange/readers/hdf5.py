"""Read any HDF5 file with h5py: also MATLAB 7.3, netCDF-4, and the tables of PyTables and pandas."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from hil.errors import WrongUse
from hil.exchange.nested import Names, names_of
from hil.exchange.readers.columns import MOST, Columns, of_matrix, titled
from hil.exchange.readers.matlab import no_numbers

_CLASS = "MATLAB_class"
_NUMBERS = ("double", "single", "logical", *(f"{sign}int{bits}" for sign in ("", "u") for bits in (8, 16, 32, 64)))


@dataclass(frozen=True, slots=True)
class _Part:
    """An array in a file: the place of its dataset, a field of a compound type or None, and its shape, in MATLAB's
    order for MATLAB's files.
    """

    place: str
    field: str | None
    shape: tuple[int, ...]


def read(source: Path) -> Columns:
    """Return the columns of all datasets by path: "run/q[:,2]", "run/table.tau"; of MATLAB's as "log.q(:,3)".

    Raises WrongUse for a recording of hil, and for a file of MATLAB's that holds objects only.
    """
    with h5py.File(source) as file:
        if {"samples", "profile"} <= set(file):
            raise WrongUse(f"{source} is a recording of hil, which needs no import: hil identify {source}")
        kinds = {path: _kind(item) for path, item in _items(file)}
        found: dict[str, Callable[[], Any]] = {}
        for path, item in _items(file):
            if isinstance(item, h5py.Dataset) and kinds[path] in {"", "cell", *_NUMBERS}:
                matlab = any(kinds.values())
                beside = _names_beside(item)
                for name, part in _parts(file, path, item, matlab=matlab):
                    for column, index in of_matrix(name, part, matlab=matlab, beside=beside):
                        found[titled(column, dict(item.attrs))] = partial(
                            _values, source, part, index[::-1] if matlab else index
                        )
    objects = {path: kind for path, kind in kinds.items() if kind not in {"", "cell", "char", "struct", *_NUMBERS}}
    return found | no_numbers(source, objects, alone=not found)


def _names_beside(item: h5py.Dataset) -> Names:
    """Return the lists of names that stand in the group of a matrix."""
    near = item.parent.values() if item.ndim > 1 else ()
    texts = [one for one in near if isinstance(one, h5py.Dataset) and one.ndim == 1 and one.size <= MOST]
    return names_of(
        one.asstr(errors="replace")[()].tolist() for one in texts if h5py.check_string_dtype(one.dtype) is not None
    )


def _items(file: h5py.File) -> Iterator[tuple[str, Any]]:
    """Yield every group and dataset with its path, without those to which only references of MATLAB's lead."""
    found: list[tuple[str, Any]] = []
    file.visititems(lambda path, item: found.append((path, item)))
    yield from (one for one in found if not one[0].startswith("#"))


def _kind(item: Any) -> str:
    kind = item.attrs.get(_CLASS, b"")
    return "empty" if "MATLAB_empty" in item.attrs else kind.decode() if isinstance(kind, bytes) else str(kind)


def _parts(file: h5py.File, path: str, item: Any, *, matlab: bool) -> Iterator[tuple[str, _Part]]:
    """Yield the arrays in a dataset: itself, each field of a compound type, and those to which its references lead."""
    name = path.replace("/", ".") if matlab else path
    if h5py.check_ref_dtype(item.dtype) is not None:
        group, _, last = name.rpartition(".")
        cell = _kind(item) == "cell"
        for at, reference in enumerate(item[()].ravel(), start=1):
            inner = file[reference] if reference else None
            if isinstance(inner, h5py.Dataset) and _kind(inner) in _NUMBERS:
                word = f"{name}{{{at}}}" if cell else f"{group}({at}).{last}"
                yield word, _Part(inner.name, None, inner.shape[::-1])
    elif item.dtype.names is not None:
        for field in item.dtype.names:
            yield f"{name}.{field}", _Part(path, field, item.shape + item.dtype[field].shape)
    elif item.shape is not None:
        yield name, _Part(path, None, item.shape[::-1] if matlab else item.shape)


def _values(source: Path, part: _Part, index: tuple[int | slice, ...]) -> Any:
    """Return a column (n,); packed numbers of netCDF as what they mean."""
    with h5py.File(source) as file:
        dataset = file[part.place]
        if dataset.external or dataset.is_virtual:
            raise WrongUse(f"{source}: {part.place} keeps its data in another file: hil does not open such a file")
        if h5py.check_string_dtype(dataset.dtype) is not None:
            return dataset.asstr(errors="replace")[index].astype(str)
        values = dataset[index] if part.field is None else dataset[part.field][index]
        packed = {key: np.ravel(dataset.attrs[key])[0] for key in _PACKING if key in dataset.attrs}
    if not packed:
        return np.ravel(values)
    plain = np.where(values == packed.get("_FillValue"), np.nan, values)
    return plain * packed.get("scale_factor", 1.0) + packed.get("add_offset", 0.0)


_PACKING = ("_FillValue", "scale_factor", "add_offset")
