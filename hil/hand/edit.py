"""Set keys in a stand file or a hand's file that people wrote; its comments, order and other keys are not changed."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from hil.errors import WrongUse, unknown
from hil.hand.file import parse
from hil.recording.input import read_text
from hil.recording.output import atomic_write
from hil.stand.file import LARGEST
from hil.stand.file import parse as parse_stand


def update(path: Path, changes: Mapping[str, Mapping[str, Any]], joint: str = "") -> None:
    """Set keys in the stand file at `path`, or in the [[joint]] named `joint` of a hand's file. Either all changes are
    written or none.

    changes: keys and values by table, such as {"calibration.zero": {"zero": 0.1}}. Raises WrongUse if the file cannot
    be read or written, has no such joint, or would not be valid after the change.
    """
    import tomlkit
    from tomlkit.exceptions import TOMLKitError

    path = path.resolve()  # a link stays one
    try:
        document = tomlkit.parse(read_text(path, largest=LARGEST))
        root = _joint_in(document, joint, path) if joint else document
        for name, values in changes.items():
            table: Any = root
            for part in name.split("."):
                if part not in table:
                    table[part] = tomlkit.table(is_super_table=part == "calibration")
                table = table[part]
            for key, value in values.items():
                table[key] = value
    except TOMLKitError as error:
        raise WrongUse(f"{path} is not TOML: {error}") from None
    text = tomlkit.dumps(document)
    (parse if joint else parse_stand)(text, str(path))
    with atomic_write(path, force=True) as temporary:
        temporary.write_text(text, encoding="utf-8")


def _joint_in(document: Any, name: str, path: Path) -> Any:
    joints = document.get("joint", [])
    for table in joints:
        if table.get("name") == name:
            return table
    raise unknown(f"joint in {path}", name, [str(table.get("name")) for table in joints])
