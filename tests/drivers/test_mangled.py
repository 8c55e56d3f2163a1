"""Replies that are changed, cut short, doubled, merged, from elsewhere or late: every adapter, in any order of them."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.servo import BadReply, Command, DeviceFault, DriverError, Limits, Quantity, Sample
from sim_backend.wire.canbus.bus import CanDelivery

from .conftest import sampled

LIMITS = Limits(torque=0.02, velocity=60.0, temperature=85.0, position=(-8.0, 8.0))
PUSH = Command(Quantity.TORQUE, 0.005)
LATE = 0.012  # s: after the deadline of every drive, and within the next tick's
SERIAL, CAN = ("rig", "mx", "feetech", "foc"), ("odrive", "mit", "moteus", "cia402", "robstride")
CHECKED = ("rig", "mx", "feetech")  # their packets have a checksum
ACCEPTED_BY_CHANCE = {"merged"}  # changes of many bytes: a checksum of one byte accepts one such reply in 256

Mangled = Callable[[list[Any]], list[Any]]


def flipped(data: bytes, at: int) -> bytes:
    """Data in which one bit differs."""
    out = bytearray(data)
    if out:
        out[at // 8 % len(out)] ^= 1 << at % 8
    return bytes(out)


def mangled(how: str, at: int, replies: Sequence[Any], last: list[bytes]) -> list[tuple[float, bytes]]:
    """The replies, each its time and bytes, with one thing done to them; last: those of the request before."""
    kept = [(when, bytes(data)) for when, data in replies]
    before, last[:] = list(last), [data for _, data in kept]
    if how == "twice":
        return [one for one in kept for _ in range(2)]
    if how == "older":
        return [(when, old) for (when, _), old in zip(kept, before, strict=False)]
    if how == "lost":
        return []
    return [(when + LATE * (how == "late"), changed(how, at, data)) for when, data in kept]


def changed(how: str, at: int, data: bytes) -> bytes:
    """The bytes of a reply with one thing done to them."""
    done = {
        "flip": flipped(data, at),
        "cut": data[: at % (len(data) + 1)],
        "merged": data[: len(data) // 2] + data,
        "noise": bytes((at * k) % 256 for k in range(1, 8)) + data + b"\xff",
    }
    return done.get(how, data)


def mangled_frames(how: str, at: int, replies: list[CanDelivery], last: list[bytes]) -> list[CanDelivery]:
    """The same on a CAN bus, where a reply may also come from another node; noise is a heartbeat of any node."""
    if how == "elsewhere":
        return [CanDelivery(when, replace(one, ident=one.ident ^ 1 << at % 11)) for when, one in replies]
    done = mangled("none" if how in {"merged", "noise"} else how, at, [(w, one.data) for w, one in replies], last)
    shape = replies[0][1] if replies else None
    frames = [CanDelivery(when, replace(shape, data=data)) for when, data in done] if shape is not None else []
    extra = [CanDelivery(when, replace(one, ident=0x700 + at % 128)) for when, one in replies] if how == "noise" else []
    same = [one for _, one in replies]
    if len(done) == len(same):
        frames = [CanDelivery(when, replace(one, data=data)) for (when, data), one in zip(done, same, strict=True)]
    return extra + frames


WAYS = ("flip", "cut", "twice", "merged", "noise", "older", "late", "lost", "elsewhere")
HOW = st.tuples(st.sampled_from(["good", "good", *WAYS]), st.integers(0, 4095))


def opened(request: pytest.FixtureRequest, kind: str) -> Any:
    """A rig of this kind of drive."""
    make: Callable[..., Any] = request.getfixturevalue(f"make_{'rig' if kind == 'mx' else kind}")
    return make("mx-64") if kind == "mx" else make()


@sampled(6)
@pytest.mark.parametrize("kind", [*SERIAL, *CAN])
def test_mangled_replies_raise_only_named_errors_and_the_torque_goes_off(
    request: pytest.FixtureRequest, kind: str, nth: int
) -> None:
    @settings(max_examples=30 // nth, database=None)
    @given(plan=st.lists(HOW, min_size=3, max_size=14))
    def holds(plan: list[tuple[str, int]]) -> None:
        hold_against(opened(request, kind), kind, plan)

    holds()


def hold_against(rig: Any, kind: str, plan: list[tuple[str, int]]) -> None:
    servo = rig.armed(LIMITS)
    receive = rig.bus.receive
    last: list[bytes] = []
    change: Any = mangled_frames if kind in CAN else mangled
    for how, at in plan:
        rig.bus.receive = lambda *words, how=how, at=at: change(how, at, receive(*words), last)
        rig.wait(4e-3)
        try:
            believed: Sample = servo.exchange(PUSH)
        except DeviceFault:  # a status without a checksum is believed: the recorder would stop here
            break
        except DriverError:
            continue
        if kind not in CHECKED:
            continue
        assert abs(believed.motor_torque) <= servo.info.torque_most
        if how in ACCEPTED_BY_CHANCE:
            break  # any value in range may follow from it
        assert abs(believed.motor_position) < 2.0 * math.pi  # as the emulator stands; a changed byte would be seen
        assert abs(believed.motor_torque) < 1.0
    rig.bus.receive = receive
    rig.wait(0.05)
    with contextlib.suppress(DriverError):
        servo.disarm()
    servo.disarm()
    assert not rig.motor.enabled
    servo.close()


@sampled(5)
@pytest.mark.parametrize("kind", [*SERIAL, *CAN])
def test_mangled_replies_while_it_is_opened_armed_and_stopped_raise_only_named_errors(
    request: pytest.FixtureRequest, kind: str, nth: int
) -> None:
    change: Any = mangled_frames if kind in CAN else mangled
    count = 0
    for seed in range(0, 30, nth):
        rng, rig, last = np.random.default_rng(seed), opened(request, kind), list[bytes]()
        receive, share = rig.bus.receive, (0.02, 0.1, 0.3)[seed % 3]

        def damaging(*words: Any) -> Any:
            how = str(rng.choice(("cut",) * 9 + WAYS)) if rng.random() < share else "good"  # noqa: B023 - called within the loop
            return change(how, int(rng.integers(4096)), receive(*words), last)  # noqa: B023

        rig.bus.receive = damaging
        with contextlib.suppress(DriverError):
            servo = rig.open()
            count += 1
            for call in (partial(servo.arm, LIMITS), partial(servo.exchange, PUSH), servo.disarm) * 2:
                with contextlib.suppress(DriverError):
                    call()
            servo.close()
    assert count >= 10 // nth


@pytest.mark.parametrize("kind", [*SERIAL, *CAN])
def test_a_torque_beyond_the_range_of_the_drive_is_a_damaged_reply(request: pytest.FixtureRequest, kind: str) -> None:
    servo = opened(request, kind).open()
    servo.exchange(Command.rest())
    servo.info = replace(servo.info, torque_most=-1.0)
    with pytest.raises(BadReply, match=r"torque of .* N m, .* is damaged, and the sample is dropped; check the cable"):
        servo.exchange(Command.rest())
    servo.close()


@pytest.mark.parametrize("kind", ["mx", "feetech"])
def test_a_damaged_current_whose_checksum_agrees_is_dropped(request: pytest.FixtureRequest, kind: str) -> None:
    rig = opened(request, kind)
    servo = rig.open()
    receive = rig.bus.receive

    def damaged(*words: Any) -> list[Any]:
        bodies = [(when, bytes(data)[:-3] + b"\xdc\xf5") for when, data in receive(*words)]  # the current is the last
        return [(when, body + bytes([~sum(body[2:]) & 0xFF])) for when, body in bodies]

    rig.bus.receive = damaged
    with pytest.raises(BadReply, match="torque of"):
        servo.exchange(Command.rest())
    rig.bus.receive = receive
    assert servo.exchange(Command.rest()).motor_torque == 0.0
    servo.close()
