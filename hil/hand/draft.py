"""A new hand.toml: the servos that answer on a port, and the commented file with a [[joint]] for each of them."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from drivers.servo import NoReply
from hil.errors import WrongUse
from hil.hand.file import HandTable
from hil.stand.draft import Draft, commented, toml

if TYPE_CHECKING:
    from drivers.packets.scan import FoundServo

_FAMILIES = {"dynamixel": "DYNAMIXEL", "feetech": "Feetech"}


@dataclass(frozen=True, slots=True)
class FoundHand:
    """The servos on the port `port`, all of the family `backend` and with one baud rate.

    others: what else answers there and is not driven by hil, each as a sentence.
    """

    port: str
    backend: str
    servos: tuple[FoundServo, ...]
    others: tuple[str, ...]

    @property
    def models(self) -> list[str]:
        """The models of the servos, each once."""
        return list(dict.fromkeys(one.kind.model for one in self.servos))


def found_on(port: str) -> FoundHand:
    """Search a serial port for DYNAMIXEL and Feetech servos at every baud rate. Nothing moves and no torque is switched
    on: only pings and reads are sent.

    Raises NoReply if no servo answers that hil drives, WrongUse if they are of two families or have several baud rates,
    and DriverError if the port cannot be opened.
    """
    from drivers.dynamixel.identity import scan as scan_dynamixel
    from drivers.feetech.identity import scan as scan_feetech

    return hand_of(port, {"dynamixel": scan_dynamixel(port), "feetech": scan_feetech(port)})


def hand_of(port: str, found: Mapping[str, Sequence[FoundServo]]) -> FoundHand:
    """Return the hand of the servos `found` by each family's search. Raises as `found_on`."""
    driven = {family: [one for one in servos if one.kind.model] for family, servos in found.items()}
    families = [family for family, servos in driven.items() if servos]
    places = {(one.ident, one.baudrate) for servos in driven.values() for one in servos}
    rest = [one for servos in found.values() for one in servos if (one.ident, one.baudrate) not in places]
    by_place = {(one.ident, one.baudrate): str(one) for one in sorted(rest, key=lambda one: bool(one.kind.firmware))}
    others = tuple(by_place[place] for place in sorted(by_place))
    if not families:
        known = f"; {'; '.join(others)}, and hil does not drive that" if others else ""
        raise NoReply(
            f"no DYNAMIXEL or Feetech servo that hil drives answers on {port} at any baud rate{known}: check the "
            "servos' power, the cable and the port (hil doctor lists the ports)"
        )
    if len(families) > 1:
        named = " and ".join(f"{_FAMILIES[one]} servos ({_ids(driven[one])})" for one in families)
        raise WrongUse(
            f"{named} answer on {port}, and a hand file has one family on a port: connect each family to its own port "
            "and scan each"
        )
    (backend,) = families
    servos = sorted(driven[backend], key=lambda one: one.ident)
    rates: dict[int, list[FoundServo]] = defaultdict(list)
    for one in servos:
        rates[one.baudrate].append(one)
    if len(rates) > 1:
        named = "; ".join(f"{_ids(rates[rate])} at {rate} baud" for rate in sorted(rates))
        raise WrongUse(
            f"the servos on {port} have several baud rates ({named}): set one for all with the maker's tool, then scan "
            "again"
        )
    return FoundHand(port, backend, tuple(servos), others)


def hand_text(hand: FoundHand, answers: Mapping[str, Any], sensor: str | None = None) -> str:
    """Return the text of a hand file. answers: values by key, such as limits.torque, that all joints share; a key
    without an answer gets the default of a new stand file. sensor: kind of the joint sensor, None without one.
    """
    backend, models = hand.backend, hand.models
    own = {"stand.name", "stand.backend", f"{backend}.id"}
    if len(models) > 1:
        own.add(f"{backend}.model")
    shared = {"port": hand.port, "baudrate": hand.servos[0].baudrate, "model": models[0]}
    known = {f"{backend}.{key}": value for key, value in shared.items()}
    lines = [
        f"# The servos that answered on {hand.port}. Correct the limits and name the joints; then: hil doctor, and",
        "# hil hand. A key of [stand], [limits] or "
        f"[{backend}] holds for all joints; a [[joint]] overrides it: limits.torque = 0.1",
        "",
        "[hand]",
        *commented('name = "my hand"', "what you call it"),
        f"backend = {toml(backend)}",
        *_hand_keys(),
        *Draft(backend, sensor).tables({**answers, **known}, own),
    ]
    for at, servo in enumerate(hand.servos):
        lines += ["", "[[joint]]"]
        lines += commented(
            f"name = {toml(f'joint_{servo.ident}')}", f"{servo.kind.words}, firmware {servo.kind.firmware}"
        )
        lines.append(f"{backend}.id = {servo.ident}")
        if len(models) > 1:
            lines.append(f"{backend}.model = {toml(servo.kind.model)}")
        if not at:
            lines += commented("# also_moves = {joint_b = 0.75}", "turns of further joints for one of its own")
    return "\n".join(lines) + "\n"


def _hand_keys() -> Iterator[str]:
    """Yield the lines of the most useful keys of [hand], with their defaults, as comments."""
    defaults = HandTable()
    yield from commented(f"# repeats = {toml(defaults.repeats)}", "recordings of each joint")
    yield from commented(f"# duration = {toml(defaults.duration)}", "s, of each recording")


def _ids(servos: Sequence[FoundServo]) -> str:
    ids = ", ".join(str(one.ident) for one in servos)
    return f"id{'s' if len(servos) > 1 else ''} {ids}"
