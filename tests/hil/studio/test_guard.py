"""Who may in: a table of headers against the middleware, for requests and for websockets."""

from __future__ import annotations

import asyncio
from collections.abc import MutableMapping
from typing import Any

import pytest

pytest.importorskip("starlette", reason="PAGE NOT TESTED: pip install 'hil[studio]'")

from hil.studio.guard import Access, Guard

PORT = 8455
HERE, OURS = f"127.0.0.1:{PORT}", f"http://127.0.0.1:{PORT}"
ACCESS = Access(PORT)
KEY = f"Bearer {ACCESS.key}"
PAGE = {"host": HERE, "origin": OURS, "sec-fetch-site": "same-origin", "authorization": KEY}
EVIL = {"host": "evil.example:8455", "origin": "http://evil.example:8455", "sec-fetch-site": "same-origin"}


def without(*names: str) -> dict[str, str]:
    return {name: value for name, value in PAGE.items() if name not in names}


TABLE = [
    ("GET / HTTP", {"host": HERE, "sec-fetch-site": "none"}, 200),  # a link that is opened
    ("GET / HTTP", {"host": HERE, "sec-fetch-site": "cross-site"}, 200),  # the shell has no data
    ("GET /static/studio.js HTTP", {"host": f"localhost:{PORT}"}, 200),
    ("GET / HTTP", EVIL, 421),  # a name that was rebound to 127.0.0.1
    ("GET / HTTP", {"host": "127.0.0.1"}, 421),
    ("GET / HTTP", {"host": "127.0.0.1:80"}, 421),
    ("GET / HTTP", {"host": f"[::1]:{PORT}"}, 421),
    ("GET / HTTP", {}, 421),
    ("POST / HTTP", {"host": HERE}, 403),
    ("POST /static/studio.js HTTP", {"host": HERE, "origin": OURS}, 401),
    ("GET /api/folder HTTP", PAGE, 200),
    ("GET /api/folder HTTP", without("origin"), 200),  # a fetch of the page itself has none
    ("GET /api/folder HTTP", without("origin", "sec-fetch-site"), 200),  # an old browser
    ("GET /api/folder HTTP", without("authorization"), 401),
    ("GET /api/folder HTTP", PAGE | {"authorization": "Bearer wrong"}, 401),
    ("GET /api/folder HTTP", PAGE | {"authorization": "Bearer \xff"}, 401),
    ("GET /api/folder HTTP", without("authorization") | {"cookie": f"key={ACCESS.key}"}, 401),  # any port gets those
    ("GET /ticket/x HTTP", without("authorization", "origin"), 200),
    ("GET /ticket/x HTTP", without("authorization", "origin") | {"sec-fetch-site": "cross-site"}, 403),
    ("POST /ticket/x HTTP", without("authorization"), 401),
    ("GET /api/folder HTTP", without("origin") | {"sec-fetch-site": "cross-site"}, 403),
    ("GET /api/folder HTTP", without("origin") | {"sec-fetch-site": "same-site"}, 403),  # another port of this host
    ("GET /api/trace HTTP", without("origin") | {"sec-fetch-site": "none"}, 403),  # typed by hand: it has no page
    ("GET /api/folder HTTP", PAGE | {"origin": "null"}, 403),  # a report in its sandbox
    ("POST /api/stop HTTP", PAGE, 200),
    ("POST /api/stop HTTP", without("origin"), 403),
    ("POST /api/stop HTTP", without("authorization"), 401),
    ("POST /api/start HTTP", PAGE | {"origin": "http://evil.example"}, 403),
    ("POST /api/start HTTP", PAGE | {"origin": "http://127.0.0.1:8456"}, 403),
    ("POST /api/start HTTP", PAGE | {"origin": f"https://{HERE}"}, 403),
    ("DELETE /api/start HTTP", without("origin"), 403),
    ("POST /token HTTP", without("authorization"), 200),
    ("POST /token HTTP", without("authorization", "origin"), 403),
    ("GET /token HTTP", without("authorization"), 401),
    ("websocket /api/stream WS", without("sec-fetch-site"), 200),  # Chromium sends none with a handshake
    ("websocket /api/stream WS", without("sec-fetch-site", "authorization"), 200),
    ("websocket /api/stream WS", without("sec-fetch-site", "origin"), 403),
    ("websocket /api/stream WS", PAGE | {"origin": "http://evil.example"}, 403),
    ("websocket /api/stream WS", PAGE | {"origin": "null"}, 403),
    ("websocket / WS", EVIL, 403),
    ("websocket / WS", {"host": HERE}, 403),
]


async def asked(line: str, headers: dict[str, str]) -> tuple[int, dict[bytes, bytes]]:
    """The status with which a request ends, 403 for a websocket that is closed; and the headers of the answer."""
    method, path, kind = line.split()
    scope: MutableMapping[str, Any] = {"type": "http", "method": method, "path": path}
    if kind == "WS":
        scope = {"type": "websocket", "path": path}
    scope["headers"] = [(name.encode(), value.encode("latin-1")) for name, value in headers.items()]
    sent: list[MutableMapping[str, Any]] = []

    async def behind(scope: MutableMapping[str, Any], _receive: Any, send: Any) -> None:
        start = {"http": {"type": "http.response.start", "status": 200, "headers": []}}
        await send(start.get(scope["type"], {"type": "websocket.accept"}))

    async def receive() -> MutableMapping[str, Any]:
        return {"type": "websocket.connect"}

    async def send(message: MutableMapping[str, Any]) -> None:
        sent.append(message)

    await Guard(behind, ACCESS)(scope, receive, send)
    status = {"websocket.accept": 200, "websocket.close": 403}.get(sent[0]["type"])
    return status or sent[0]["status"], dict(sent[0].get("headers", []))


@pytest.mark.parametrize(("line", "headers", "status"), TABLE)
def test_a_request_passes_only_with_our_host_our_origin_and_the_key(
    line: str, headers: dict[str, str], status: int
) -> None:
    found, answered = asyncio.run(asked(line, headers))
    assert found == status
    if line.endswith("HTTP"):
        assert b"script-src 'self'" in answered[b"content-security-policy"]
        assert b"unsafe" not in answered[b"content-security-policy"]


def test_a_link_is_good_for_one_browser_and_only_the_newest() -> None:
    access = Access(PORT)
    assert not access.spend("")
    first, second = (access.link().partition("#")[2] for _ in range(2))
    assert [access.spend(token) for token in (first, second + "x", second, second)] == [False, False, True, False]
    assert access.key not in {first, second}
