"""Insert into an XML file, or change attributes of its tags, and leave every other byte as it is."""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple
from xml.parsers import expat
from xml.sax.saxutils import quoteattr

from hil.errors import WrongUse
from hil.recording.input import open_input

LARGEST = 1 << 25
"""The largest allowed size of a model, bytes."""

_DEEPEST = 500
_UTF_16 = (b"\xff\xfe", b"\xfe\xff")
_WHOLE_TAG = re.compile(rb"""<(?:[^>"']|"[^"]*"|'[^']*')*>""")


@dataclass(slots=True)
class Tag:
    """An element of the file. path: the names of the elements around it, and its own name. start, end: byte at which
    its start tag and its end tag begin. inside: the elements in it.
    """

    path: tuple[str, ...]
    attributes: dict[str, str]
    start: int
    end: int = 0
    inside: list[Tag] = field(default_factory=list)


class Edit(NamedTuple):
    """Bytes that replace those from `start` to `end`."""

    start: int
    end: int
    text: bytes


@dataclass(frozen=True, slots=True)
class Document:
    """An XML file. tags: all elements in the file's order; the first is the root."""

    path: Path
    data: bytes
    tags: tuple[Tag, ...]

    def insertion(self, before: int, lines: Iterable[str]) -> Edit:
        """Return the edit that puts whole lines in front of the end tag at the byte `before`."""
        line_end = b"\r\n" if b"\r\n" in self.data else b"\n"
        start = self.data.rfind(b"\n", 0, before) + 1
        if self.data[start:before].strip():  # something stands in front of the tag, on the same line
            start, lines = before, ["", *lines]
        return Edit(start, start, b"".join(encoded(line) + line_end for line in lines))

    def changed(self, tag: Tag, values: dict[str, str]) -> Edit:
        """Return the edit that gives a start tag these attributes, each in the place of the present value or last."""
        match = _WHOLE_TAG.match(self.data, tag.start)
        if match is None:
            raise WrongUse(f"{self.path} has a tag without an end at byte {tag.start}: use another copy")
        text = match[0]
        for name, value in values.items():
            new = name.encode() + b"=" + encoded(quoteattr(value))
            present = re.compile(rb"(?<=\s)" + name.encode() + rb"""\s*=\s*("[^"]*"|'[^']*')""")
            text, count = present.subn(lambda _old, new=new: new, text)  # type: ignore[misc]
            if not count:
                closing = b"/>" if text.endswith(b"/>") else b">"
                text = text[: -len(closing)].rstrip() + b" " + new + closing
        return Edit(match.start(), match.end(), text)

    def edited(self, edits: Iterable[Edit]) -> bytes:
        """Return the bytes of the file with the edits, which do not overlap."""
        data = self.data
        for edit in sorted(edits, reverse=True):
            data = data[: edit.start] + edit.text + data[edit.end :]
        return data


def load(path: Path, root: str) -> Document:
    """Return the XML file at `path`. root: the name that its outermost element must have.

    The file may come from somebody else: no other file is opened for it, and no entity is expanded. Raises WrongUse for
    a file that is no XML, has another root, a document type or entities, is too large or is nested too deeply.
    """
    with open_input(path, largest=LARGEST) as file:
        data = file.read()
    if data.startswith(_UTF_16) or b"\0" in data:
        raise WrongUse(f"{path} is not stored as UTF-8: save it so")
    tags = _parsed(path, data)
    if tags[0].path != (root,):
        raise WrongUse(
            f"{path} begins with <{tags[0].path[0]}>, and the model of a hand with <{root}>: name that file with --into"
        )
    return Document(path, data, tuple(tags))


def encoded(text: str) -> bytes:
    """Return text for a file in any encoding that contains ASCII."""
    return text.encode("ascii", "xmlcharrefreplace")


def _parsed(path: Path, data: bytes) -> list[Tag]:
    tags, above = list[Tag](), list[Tag]()
    parser = expat.ParserCreate()

    def start(name: str, attributes: dict[str, str]) -> None:
        if len(above) >= _DEEPEST:
            raise WrongUse(f"{path} is nested more than {_DEEPEST} elements deep, as no model of a hand is")
        around = above[-1].path if above else ()
        tag = Tag((*around, name), attributes, parser.CurrentByteIndex)
        if above:
            above[-1].inside.append(tag)
        tags.append(tag)
        above.append(tag)

    def end(_name: str) -> None:
        above.pop().end = parser.CurrentByteIndex

    def document_type(*_words: object) -> None:
        raise WrongUse(
            f"{path} declares a document type or entities, which no model of a hand needs: remove <!DOCTYPE>"
        )

    parser.StartElementHandler, parser.EndElementHandler = start, end
    parser.StartDoctypeDeclHandler = document_type
    try:
        parser.Parse(data, True)
    except (expat.ExpatError, ValueError, LookupError) as error:
        raise WrongUse(f"{path} is no XML file ({error}): use another copy") from None
    return tags
