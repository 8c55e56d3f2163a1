"""Tables that PlotJuggler exports: the time is the column `__time`, a joint's position is `TOPIC/JOINT/position`."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from hil.errors import WrongUse
from hil.exchange.bags import UNITS
from hil.exchange.headings import listed

TIME = "__time"


def renamed(source: Path, titles: Sequence[str], topic: str | None, joint: str | None) -> list[str]:
    """Return the headings of a table of PlotJuggler, with the unit added to the time, and the columns of the chosen
    joint renamed as those of a ROS 2 bag.

    Raises WrongUse for a topic or joint that the table does not have, with the list of those that it has.
    """
    if TIME not in titles:
        if topic is not None or joint is not None:
            raise WrongUse(f"{source} is no bag, nor a table of PlotJuggler: name its columns, not a topic or joint")
        return list(titles)
    names = {title: title for title in titles} | {TIME: f"{TIME} [s]"}
    if topic is not None or joint is not None:
        chosen = _joint(source, titles, topic, joint)
        names |= {TIME: "time [s]"} | {f"{chosen}/{name}": f"{name} [{unit}]" for name, unit in UNITS.items()}
    return [names[title] for title in titles]


def _joint(source: Path, titles: Sequence[str], topic: str | None, joint: str | None) -> str:
    """Return the path of the chosen joint, such as "/joint_states/finger"."""
    paths = [title.removesuffix("/position") for title in titles if title.endswith("/position")]
    of_topic = [path for path in paths if topic is None or path.rpartition("/")[0].strip("/") == topic.strip("/")]
    found = [path for path in of_topic if joint is None or path.rpartition("/")[2] == joint]
    if len(found) == 1:
        return found[0]
    what = "no joint state" if not found else "several joint states"
    asked = " ".join(part for part in (topic, joint) if part)
    raise WrongUse(f"{source} has {what} for {asked}; it has {listed(paths) if paths else 'none'}")
