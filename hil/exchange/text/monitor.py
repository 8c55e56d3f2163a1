"""Lines of a serial monitor: a stamp before each line, and a label before each number."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from typing import NamedTuple

from hil.exchange.headings import is_unit

_TIME = r"(?:\d{4}-\d\d-\d\d[T ])?\d{1,2}:\d{2}:\d{2}(?:[.,:]\d+)?"
_LEVEL = r"\[?\s*(?:TRACE|DEBUG|INFO|NOTICE|WARN(?:ING)?|ERROR|FATAL)\s*\]?"
_STAMP = re.compile(
    rf"^\s*(?:{_LEVEL}\s*\[\s*(?P<leveled>\d+\.\d+)\s*\](?:\s*\[[\w./-]+\])?\s*:|"
    rf"(?P<logged>{_TIME})(?:\s*[-:]?\s*[\w./-]+)??\s*[-:]?\s*{_LEVEL}(?:\s*[-:]|\s*[\w./-]+\s*:(?!\s*[-+.\d]))?|"
    rf"[A-Z][a-z]{{2}} [ \d]\d (?P<journal>{_TIME}) \S+ [\w./-]+(?:\[\d+\])?:|[EWIDV] \((?P<ticks>\d+)\) [\w.-]+:|"
    rf"[\[(<]\s*(?P<inside>{_TIME}|\d+\.\d+)\s*[\])>]\s*(?:->|[:|>-](?!\d))?|(?P<before>{_TIME})\s*(?:->|>|\|))\s*"
)
_NUMBER = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?|[-+]?(?:nan|inf)\b"
_LABELLED = re.compile(
    rf"[\"']?(?P<label>[^\W\d][\w .\[\]()/*^-]{{0,40}}?)[\"']?\s*[:=]\s*(?P<value>{_TIME}|{_NUMBER})"
    r"(?:\s?(?P<unit>[A-Za-zµ°%][\w*/^.·-]*)(?!\s*[:=])(?=[\s,;|}]|$))?(?=[\s,;|}]|$)",
    re.IGNORECASE,
)
_FIRST = re.compile(rf"^\s*(?P<value>{_NUMBER})\s*(?P<unit>[mun]?s)?\s*[,;:|\s]\s*", re.IGNORECASE)
_BETWEEN = re.compile(r"[\s,;|{}]*")
_LONGEST = 500  # characters of a line with labels
_USUAL = 0.5  # share of the lines, that has a stamp or labels
UNNAMED = "number"
"""The name of the number that stands before the first label of each line."""


class Monitor(NamedTuple):
    """What stands in each line beside the numbers. stamped: a stamp. labels: a label before each number."""

    stamped: bool
    labels: tuple[str, ...]

    def plain(self, lines: Iterable[str], delimiter: str) -> Iterator[str]:
        """Yield the lines as rows of a table, with the stamp in the first cell."""
        for line in lines:
            stamp, rest = _split(line) if self.stamped else ("", line)
            if self.labels:
                found = _values(rest)
                rest = delimiter.join(found.get(one, ("", ""))[0] for one in self.labels) if found else rest
            yield f"{stamp}{delimiter}{rest}" if self.stamped and rest.strip() else rest


def monitor(lines: Sequence[str]) -> tuple[Monitor, list[str], dict[str, str]]:
    """Return what stands beside the numbers of the lines, the lines without stamps, and the unit behind each label."""
    full = [line for line in lines if line.strip()]
    stamped = sum(map(bool, map(_STAMP.match, full))) > _USUAL * len(full)
    plain = [_split(line)[1] if stamped else line for line in lines]
    found = [_values(line) for line in plain if line.strip()]
    counts = Counter(tuple(one) for one in found if one)
    labels = max(counts, key=lambda one: counts[one], default=())
    if len(labels) < 2 or sum(set(one) <= set(labels) for one in found if one) <= _USUAL * len(full):
        return Monitor(stamped, ()), plain, {}
    units = {name: {one[name][1] for one in found if name in one} for name in labels}
    said = {name: one for name, own in units.items() if len(own) == 1 and is_unit(one := next(iter(own)))}
    return Monitor(stamped, labels), plain, said


def _split(line: str) -> tuple[str, str]:
    match = _STAMP.match(line)
    if match is None:
        return "", line
    return next(filter(None, match.groups())).replace(",", "."), line[match.end() :]


def _values(line: str) -> dict[str, tuple[str, str]]:
    """Return number and unit by label; {} for a line that has anything but labels and numbers."""
    found, end = dict[str, tuple[str, str]](), 0
    if len(line) > _LONGEST:
        return {}
    if (first := _FIRST.match(line)) is not None:
        found[UNNAMED], end = (first["value"], first["unit"] or ""), first.end()
    for match in _LABELLED.finditer(line, end):
        if not _BETWEEN.fullmatch(line[end : match.start()]) or match["label"] in found:
            return {}
        found[match["label"]], end = (match["value"], match["unit"] or ""), match.end()
    is_whole = end > 0 and _BETWEEN.fullmatch(line[end:]) is not None
    return found if is_whole and len(found) > (UNNAMED in found) else {}
