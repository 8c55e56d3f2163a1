"""Set keys in a stand file that people wrote; its comments, its order and its other keys are not changed."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from hil.errors import WrongUse
from hil.recording.input import read_text
from hil.recording.output import atomic_write
from hil.stand.file import LARGEST, parse


def update(path: Path, changes: Mapping[str, Mapping[str, Any]]) -> None:
    """Set keys in the stand file at `path`. Either all changes are written or none.

    changes: keys and values by table, such as {"calibration.zero": {"zero": 0.1}}. Raises WrongUse if the file cannot
    be read or written, or if the changed file would not be a valid stand file.
    """
    import tomlkit
    from tomlkit.exceptions import TOMLKitError

    path = path.resolve()  # a link stays one
    try:
        document = tomlkit.parse(read_text(path, largest=LARGEST))
        for name, values in changes.items():
            table: Any = document
            for part in name.split("."):
                if part not in table:
                    table[part] = tomlkit.table(is_super_table=part == "calibration")
                table = table[part]
            for key, value in values.items():
                table[key] = value
    except TOMLKitError as error:
        raise WrongUse(f"{path} is not TOML: {error}") from None
    text = tomlkit.dumps(document)
    parse(text, str(path))
    with atomic_write(path, force=True) as temporary:
        temporary.write_text(text, encoding="utf-8")
