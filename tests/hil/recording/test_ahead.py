from __future__ import annotations

import threading
from collections.abc import Iterator

import pytest

from hil.recording.ahead import ahead


def test_items_come_in_order_and_all_of_them() -> None:
    assert list(ahead(range(100))) == list(range(100))
    assert list(ahead([])) == []
    assert list(ahead([None, 0, ()])) == [None, 0, ()]


def test_the_next_item_is_computed_while_one_is_used() -> None:
    second = threading.Event()

    def items() -> Iterator[int]:
        yield 1
        second.set()
        yield 2

    for item in ahead(items()):
        assert second.wait(10.0), f"nothing was computed while {item} was used"


def test_an_error_comes_when_its_item_would() -> None:
    def items() -> Iterator[int]:
        yield 1
        raise ValueError("damaged")

    found = ahead(items())
    assert next(found) == 1
    with pytest.raises(ValueError, match="damaged"):
        next(found)


def test_who_stops_early_leaves_no_thread() -> None:
    """That no thread is left is what every test is held to."""
    for item in ahead(range(10)):
        if item == 3:
            break


def test_an_interrupt_does_not_wait_for_an_item_that_waits_itself() -> None:
    computing, enough = threading.Event(), threading.Event()

    def items() -> Iterator[int]:
        yield 1
        computing.set()
        enough.wait(60.0)
        yield 2

    before, found = set(threading.enumerate()), ahead(items())
    assert next(found) == 1
    assert computing.wait(10.0)
    with pytest.raises(KeyboardInterrupt):
        found.throw(KeyboardInterrupt())
    assert not enough.is_set()
    enough.set()
    for thread in set(threading.enumerate()) - before:
        thread.join(10.0)
