"""Write charts as PNG files."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from hil.errors import WrongUse
from hil.recording.output import atomic_write, check_folder, check_output, writing
from hil.report.html_page import Picture
from hil.report.pictures.canvas import check_matplotlib, drawn

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def write_pictures(pictures: Sequence[Picture], folder: Path, *, force: bool) -> list[Path]:
    """Write each picture as NAME.png into a folder; return the paths. Creates the folder. force: replace existing
    files. Raises WrongUse.
    """
    paths = [folder / f"{one.name}.png" for one in pictures]
    check_pictures(folder, [path.name for path in paths], force=force)
    for one, path in zip(pictures, paths, strict=True):
        save_picture(drawn(one.chart()), path, force=force)
    return paths


def check_pictures(folder: Path, names: Sequence[str] = (), *, force: bool) -> None:
    """Raise WrongUse if matplotlib is missing, `folder` is the name of a picture, or no file with one of the names can
    be written there. Changes nothing.
    """
    check_matplotlib()
    if folder.suffix.lower() in {".png", ".svg", ".pdf", ".jpg"}:
        raise WrongUse(f"{folder} is the name of a picture, and --plot names a folder for PNG files: {folder.stem}")
    check_folder(folder)
    for name in names if folder.exists() else ():
        check_output(folder / name, force=force)


def save_picture(figure: Figure, path: Path, *, force: bool) -> None:
    """Write a figure as a PNG file, and make its folder if there is none. force: replace an existing file. Raises
    WrongUse if the file cannot be written.
    """
    with writing(path.parent):
        path.parent.mkdir(parents=True, exist_ok=True)
    with atomic_write(path, force=force) as temporary:
        figure.savefig(temporary, format="png", dpi=110)
