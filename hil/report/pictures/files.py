"""Write charts as PNG files."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from hil.errors import WrongUse
from hil.recording.output import atomic_write, check_folder, check_output, writing
from hil.report.html_page import Picture
from hil.report.pictures.canvas import drawn

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def write_pictures(pictures: Sequence[Picture], folder: Path, *, force: bool) -> list[Path]:
    """Write each picture as NAME.png into a folder; return the paths. Creates the folder. force: replace existing
    files. Raises WrongUse.
    """
    make_picture_folder(folder)
    paths = [folder / f"{one.name}.png" for one in pictures]
    for path in paths:
        check_output(path, force=force)
    for one, path in zip(pictures, paths, strict=True):
        save_picture(drawn(one.chart()), path, force=force)
    return paths


def make_picture_folder(folder: Path) -> None:
    """Create the folder of pictures. Raises WrongUse if that is impossible, or if `folder` is the name of a picture."""
    if folder.suffix.lower() in {".png", ".svg", ".pdf", ".jpg"}:
        raise WrongUse(f"{folder} is the name of a picture, and --plot names a folder for PNG files: {folder.stem}")
    check_folder(folder)
    with writing(folder):
        folder.mkdir(parents=True, exist_ok=True)


def save_picture(figure: Figure, path: Path, *, force: bool) -> None:
    """Write a figure as a PNG file. force: replace an existing file. Raises WrongUse if the file cannot be written."""
    with atomic_write(path, force=force) as temporary:
        figure.savefig(temporary, format="png", dpi=110)
