"""The connections that have not shown the key."""

from __future__ import annotations

import asyncio
import os
import socket
import sys

import pytest

pytest.importorskip("starlette", reason="PAGE NOT TESTED: pip install 'hil[studio]'")

from hil.studio import peers
from hil.studio.guard import Access
from hil.studio.peers import Strangers, user_of


@pytest.mark.skipif(sys.platform != "linux", reason="USER OF A CONNECTION NOT TESTED: this system does not tell it")
def test_the_user_at_the_other_end_of_a_connection_is_known() -> None:
    with socket.create_server(("127.0.0.1", 0)) as here, socket.create_connection(here.getsockname()) as there:
        with here.accept()[0] as accepted:
            assert user_of(accepted.getpeername(), accepted.getsockname()) == os.getuid()
            assert user_of(("127.0.0.1", 1), accepted.getsockname()) is None
        del there


class Transport:
    """A connection from a port."""

    def __init__(self, port: int) -> None:
        self.ends = {"peername": ("127.0.0.1", port), "sockname": ("127.0.0.1", 8455)}
        self.is_open = True

    def get_extra_info(self, name: str) -> tuple[str, int]:
        return self.ends[name]

    def abort(self) -> None:
        self.is_open = False


@pytest.mark.parametrize(
    ("user", "ours", "let_in"), [(12345, 1000, False), (1000, 1000, True), (0, 1000, True), (None, 1000, True)]
)
def test_another_users_connection_is_ended_at_once(
    monkeypatch: pytest.MonkeyPatch, user: int | None, ours: int, *, let_in: bool
) -> None:
    monkeypatch.setattr(peers, "user_of", lambda *_: user)
    monkeypatch.setattr(peers, "_our_user", lambda: ours)

    async def come() -> bool:
        Strangers().add(one := Transport(1))  # type: ignore[arg-type]
        return one.is_open

    assert asyncio.run(come()) == let_in


def test_a_thousand_connections_without_the_key_end_none_that_has_shown_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(peers, "_PATIENCE", 0.01)

    async def come() -> list[list[int]]:
        access = Access(8455)
        page, *many = connections = [Transport(port) for port in range(1200)]
        access.strangers.add(page)  # type: ignore[arg-type]
        assert not access.admits("x", ("127.0.0.1", 0))
        assert access.admits(access.key, ("127.0.0.1", 0))
        for one in many:
            access.strangers.add(one)  # type: ignore[arg-type]
        still = [[port for port, one in enumerate(connections) if one.is_open]]
        while any(one.is_open for one in many):
            await asyncio.sleep(0.01)
        return [*still, [port for port, one in enumerate(connections) if one.is_open]]

    few, least = asyncio.run(come())
    assert few == [0, *range(1200 - 256, 1200)]
    assert least == [0]
