"""Read any HDF5 file with h5py: also MATLAB 7.3, netCDF-4, and the tables of PyTables and pandas."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping
from functools import partial
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from hil.errors import WrongUse
from hil.exchange.nested import Names, names_of
from hil.exchange.readers.columns import MOST, Columns, of_matrix, titled
from hil.exchange.readers.matlab import no_numbers
from hil.printable import quoted

_NUMBERS = ("double", "single", "logical", *(f"{sign}int{bits}" for sign in ("", "u") for bits in (8, 16, 32, 64)))
_BLOCK = re.compile(r"((?:.*/)?)(block\d+|axis\d)_?(values|items|)")
_PACKING = ("_FillValue", "scale_factor", "add_offset")


def read(source: Path) -> Columns:
    """Return the columns of all datasets by path: "run/q[:,2]", "run/table.tau"; of MATLAB's as "log.q(:,3)".

    The file stays open, and each column is read when it is used. Raises WrongUse for a recording of hil, and for a file
    of MATLAB's that holds objects only.
    """
    try:
        file = h5py.File(source)
    except OSError as error:
        if not any(one in str(error) for one in ("truncated", "already open", "flags")):
            raise
        raise WrongUse(
            f"{source} was not closed by the program that wrote it, as after a kill or a loss of power ({error}): try "
            f"h5clear -s --increment {quoted(source)} on a copy, or use the logger's other file"
        ) from None
    if {"samples", "profile"} <= set(file):
        raise WrongUse(f"{source} is a recording of hil, which needs no import: hil identify {quoted(source)}")
    items: dict[str, Any] = {}
    file.visititems(lambda path, item: items.update({path: item}))
    kinds = {
        path: _kind(item) for path, item in items.items() if not path.startswith("#")
    }  # not what only MATLAB names
    matlab, found = any(kinds.values()), dict[str, Callable[[], Any]]()
    for path, kind in kinds.items():
        if (block := _BLOCK.fullmatch(path)) and f"{block[1]}axis0" in items:  # of a data frame of pandas
            found |= _of_block(source, items, block)
        elif isinstance(items[path], h5py.Dataset) and kind in {"", "cell", *_NUMBERS}:
            beside, attributes = _names_beside(items[path]), dict(items[path].attrs)
            for name, part, field in _parts(file, path.replace("/", ".") if matlab else path, items[path]):
                shape = part.shape if field is None else part.shape + part.dtype[field].shape
                for column, index in of_matrix(name, shape[::-1] if matlab else shape, matlab=matlab, beside=beside):
                    place = index[::-1] if matlab else index
                    found[titled(column, attributes)] = partial(_values, source, part, field, place)
    objects = {path: kind for path, kind in kinds.items() if kind not in {"", "cell", "char", "struct", *_NUMBERS}}
    return found | no_numbers(source, objects, alone=not found)


def _of_block(source: Path, items: Mapping[str, Any], block: re.Match[str]) -> dict[str, Callable[[], Any]]:
    """Return the columns of a block of a data frame, "run/tau", by the names that stand beside it."""
    values, named = items[block[0]], items.get(f"{block[1]}{block[2]}_items")
    if block[3] != "values" or named is None or h5py.check_string_dtype(named.dtype) is None or values.ndim != 2:
        return {}
    names = named.asstr(errors="replace")[()].tolist()[: values.shape[1]]
    return {
        f"{block[1]}{name}": partial(_values, source, values, None, (slice(None), at)) for at, name in enumerate(names)
    }


def _names_beside(item: h5py.Dataset) -> Names:
    """Return the lists of names in the same group as a matrix."""
    near = item.parent.values() if item.ndim > 1 else ()
    texts = [one for one in near if isinstance(one, h5py.Dataset) and one.ndim == 1 and one.size <= MOST]
    return names_of(
        one.asstr(errors="replace")[()].tolist() for one in texts if h5py.check_string_dtype(one.dtype) is not None
    )


def _kind(item: Any) -> str:
    """Return the class that MATLAB gave to an item, "" for a file of another program."""
    kind = item.attrs.get("MATLAB_class", b"")
    return "empty" if "MATLAB_empty" in item.attrs else kind.decode() if isinstance(kind, bytes) else str(kind)


def _parts(file: h5py.File, name: str, item: Any) -> Iterator[tuple[str, Any, str | None]]:
    """Yield name, dataset and field (None without fields) of all data in a dataset: the dataset itself, each field of a
    compound type, or the datasets to which its references lead.
    """
    if h5py.check_ref_dtype(item.dtype) is not None:
        group, _, last = name.rpartition(".")
        for at, reference in enumerate(item[()].ravel(), start=1):
            inner = file[reference] if reference else None
            if isinstance(inner, h5py.Dataset) and _kind(inner) in _NUMBERS:
                yield f"{name}{{{at}}}" if _kind(item) == "cell" else f"{group}({at}).{last}", inner, None
    elif item.shape is not None:
        for field in item.dtype.names or [None]:
            yield name if field is None else f"{name}.{field}", item, field


def _values(source: Path, dataset: Any, field: str | None, index: tuple[int | slice, ...]) -> Any:
    """Return a column (n,). Packed numbers of netCDF are converted to the values that they stand for."""
    if dataset.external or dataset.is_virtual:
        raise WrongUse(f"{source}: {dataset.name} keeps its data in another file: hil does not open such a file")
    if h5py.check_string_dtype(dataset.dtype) is not None:
        return dataset.asstr(errors="replace")[index].astype(str)
    values = np.ravel(dataset[index] if field is None else dataset[field][index])
    packed = {key: np.ravel(dataset.attrs[key])[0] for key in _PACKING if key in dataset.attrs}
    if not packed:
        return values
    plain = np.where(values == packed.get("_FillValue"), np.nan, values)
    return plain * packed.get("scale_factor", 1.0) + packed.get("add_offset", 0.0)
