"""The command lines that the page can start: a table of the fields allowed in each, so that no text becomes an
option.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, Final, NamedTuple

from hil.errors import WrongUse, unknown
from hil.studio.folder import Folder, is_report

SIZES: Final = ("profile", "amplitude", "band", "duration", "rate", "mode")
"""The fields of the page that describe an excitation, which are options of `hil record` too."""
ROUGH: Final = ("kc", "bc")
"""The fields with rough values of the joint, which are options of `hil design` too."""
_WINDOW: Final = ("from", "to")
_LONGEST: Final = 200  # characters of a value
_EXPORTS: Final = (".csv", ".parquet", ".mat", ".mcap", ".xml", ".urdf", ".sdf", ".h", ".json")


class Line(NamedTuple):
    """A command line. words: its words after `hil`. output: the file that it writes. moves: whether the motor may be
    driven. module: the Python module that runs the words.
    """

    kind: str
    words: list[str]
    output: Path | None = None
    moves: bool = False
    module: str = "hil"


def line_of(wanted: Mapping[str, Any], folder: Folder) -> Line:
    """Return the command line for a request of the page. wanted: texts by name, "kind" among them. Raises WrongUse."""
    makers: dict[str, Callable[[Mapping[str, Any], Folder], Line]]
    makers = {"readings": _readings, "doctor": _doctor, "record": _record, "identify": _identify, "compare": _compare}
    makers |= {"export": _export, "design": _design, "stand": _stand}
    kind = text_of(wanted, "kind")
    if kind not in makers:
        raise unknown("command", kind, makers)
    return makers[kind](wanted, folder)


def text_of(wanted: Mapping[str, Any], name: str) -> str:
    """Return the value of a field of the page as a text, "" without one. Raises WrongUse."""
    text = str(wanted.get(name, "")).strip()
    if len(text) > _LONGEST or not text.isprintable():
        raise WrongUse(f"{name}: this is no value for it")
    return text


def options(wanted: Mapping[str, Any], names: Sequence[str]) -> list[str]:
    """Return the non-empty fields of `names` as options of the command line. Raises WrongUse."""
    return [f"--{name}={text}" for name in names if (text := text_of(wanted, name))]


def stand_of(wanted: Mapping[str, Any], folder: Folder) -> tuple[str, str]:
    """Return the stand file that the page names, "sim" for the simulated stand, and the joint of a hand's file, "" of
    any other. Raises WrongUse.
    """
    name = text_of(wanted, "stand")
    if name == "sim":
        return name, ""
    path, joint = folder.stand(name)
    return str(path), joint


def _argument(path: Path | str) -> str:
    return f"./{path}" if str(path).startswith("-") else str(path)  # or it would be an option


def _readings(wanted: Mapping[str, Any], folder: Folder) -> Line:
    return Line("readings", [*stand_of(wanted, folder)], module="hil.studio.readings")


def _doctor(wanted: Mapping[str, Any], folder: Folder) -> Line:
    stand, joint = stand_of(wanted, folder)
    if stand == "sim":
        return Line("doctor", ["doctor", "--json"])
    more = [f"--{name}" for name in ("commission", "move", "yes") if wanted.get(name) is True]
    return Line("doctor", ["doctor", _argument(stand), *_joint(joint), "--json", *more], moves=True)


def _stand(wanted: Mapping[str, Any], _folder: Folder) -> Line:
    name, answers = text_of(wanted, "file"), wanted.get("answers")
    if Path(name).name != name or Path(name).suffix != ".toml" or not isinstance(answers, dict):
        raise WrongUse(f"file {name!r}: give a name for a file of this folder, such as stand.toml")
    given = [f"--set={key}={text}" for key in answers if (text := text_of(answers, key))]
    words = ["stand", "new", "--yes", f"--backend={text_of(wanted, 'backend')}", *given, f"--output={name}"]
    return Line("stand", words, Path(name))


def _excited(wanted: Mapping[str, Any], folder: Folder) -> list[str]:
    stand, joint = stand_of(wanted, folder)
    return ["--backend=sim" if stand == "sim" else f"--stand={stand}", *_joint(joint), *options(wanted, SIZES)]


def _joint(name: str) -> list[str]:
    return [f"--joint={name}"] if name else []


def _design(wanted: Mapping[str, Any], folder: Folder) -> Line:
    return Line("design", ["design", *_excited(wanted, folder), *options(wanted, ROUGH), "--json"])


def _record(wanted: Mapping[str, Any], folder: Folder) -> Line:
    output = folder.next_recording()
    words = [*_excited(wanted, folder), *options(wanted, ["note"])]
    agreed = ["--yes"] if wanted.get("yes") is True else []
    shown = [f"--output={output}", "--json", "--realtime"]  # a real stand takes its time anyway
    return Line("record", ["record", *words, *shown, *agreed], output, moves=True)


def _identify(wanted: Mapping[str, Any], folder: Folder) -> Line:
    (recording,) = _recordings(wanted, folder, 1, 1)
    return _reported(
        ["identify", _argument(recording), *options(wanted, _WINDOW)], recording.with_suffix(".html"), folder
    )


def _compare(wanted: Mapping[str, Any], folder: Folder) -> Line:
    chosen = _recordings(wanted, folder, 2, 20)
    page = chosen[0].with_name(f"{'-'.join(one.stem for one in chosen)[:_LONGEST]}.html")
    return _reported(["compare", *map(_argument, chosen)], page, folder)


def _reported(words: list[str], page: Path, folder: Folder) -> Line:
    replaced = ["--force"] if is_report(folder.place / page) else []
    return Line(words[0], [*words, "--json", f"--report={page}", *replaced], page)


def _export(wanted: Mapping[str, Any], folder: Folder) -> Line:
    (recording,) = _recordings(wanted, folder, 1, 1)
    suffix = text_of(wanted, "suffix")
    if suffix not in _EXPORTS:
        raise unknown("format", suffix, _EXPORTS)
    output = recording.with_suffix(suffix)
    return Line("export", ["export", _argument(recording), f"--output={output}"], output)


def _recordings(wanted: Mapping[str, Any], folder: Folder, least: int, most: int) -> list[Path]:
    names = wanted.get("recordings")
    if not isinstance(names, list) or not least <= len(names) <= most:
        raise WrongUse(f"choose {'one recording' if most == 1 else f'{least} to {most} recordings'} in the list")
    return [folder.inside(str(name)) for name in names]
