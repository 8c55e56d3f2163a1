"""Access control of the page: one ASGI middleware for requests and websockets, and the token that admits a browser.

A page of another site can send requests to 127.0.0.1 from the browser of the person at the bench. The fixed list of
hosts refuses a page whose host name was rebound to 127.0.0.1; the checks of origin and cookie refuse all others.
Browsers apply neither CORS nor the same-origin policy to websockets, so their origin is checked here as well.
"""

from __future__ import annotations

import secrets
from collections.abc import Awaitable, Callable, Iterable, MutableMapping
from typing import Any, Final

Scope = MutableMapping[str, Any]
Message = MutableMapping[str, Any]
Receive = Callable[[], Awaitable[Message]]
Send = Callable[[Message], Awaitable[None]]
App = Callable[[Scope, Receive, Send], Awaitable[None]]

TOKEN_PATH: Final = "/token"  # noqa: S105 - a path
_READING: Final = frozenset({"GET", "HEAD"})
_HEADERS: Final = (
    (
        b"content-security-policy",
        b"default-src 'none'; script-src 'self'; style-src 'self'; connect-src 'self'; frame-src 'self'; "
        b"base-uri 'none'; form-action 'none'; frame-ancestors 'none'",
    ),
    (b"x-content-type-options", b"nosniff"),
    (b"referrer-policy", b"no-referrer"),
    (b"cross-origin-resource-policy", b"same-origin"),
    (b"cache-control", b"no-store"),
)


class Access:
    """The token of the printed link and the cookie that replaces it. port: of the server."""

    def __init__(self, port: int) -> None:
        self.port = port
        self.hosts = frozenset({f"127.0.0.1:{port}", f"localhost:{port}"})
        self.cookie = f"hil-studio-{port}"  # cookies ignore the port: two studios must not overwrite each other's
        self.secret = secrets.token_urlsafe(32)
        self._token = ""

    def link(self) -> str:
        """Return a new link; an earlier link that was not opened becomes invalid.

        The token stands behind '#': no log, no Referer header and no program that fetches links in advance sees it.
        """
        self._token = secrets.token_urlsafe(32)
        return f"http://127.0.0.1:{self.port}/#{self._token}"

    def spend(self, token: str) -> bool:
        """Return whether `token` is the link's token, and make the link invalid if it is."""
        right = bool(self._token) and secrets.compare_digest(token.encode(), self._token.encode())
        if right:
            self._token = ""
        return right

    def refusal(self, scope: Scope) -> tuple[int, str] | None:
        """Return the HTTP status and the reason for refusing a request or a websocket; None if it is allowed."""
        headers = _headers(scope)
        if [*headers("host")] not in [[host] for host in self.hosts]:
            return 421, f"this page is http://127.0.0.1:{self.port}: open the link that hil studio printed"
        method, path = scope.get("method", "websocket"), scope["path"]
        if method in _READING and (path == "/" or path.startswith("/static/")):
            return None  # a shell without data
        origins, ours = [*headers("origin")], {f"http://{host}" for host in self.hosts}
        foreign = any(site != "same-origin" for site in headers("sec-fetch-site")) or not ours.issuperset(origins)
        if foreign or not (origins or method in _READING):
            return 403, "the request does not come from this page"
        if (method, path) == ("POST", TOKEN_PATH) or self._has_cookie(headers("cookie")):
            return None
        return 401, "open the link that hil studio printed; Enter in its terminal prints a new one"

    def _has_cookie(self, lines: Iterable[str]) -> bool:
        pairs = (pair.strip().partition("=") for line in lines for pair in line.split(";"))
        given = [value for name, _, value in pairs if name == self.cookie]
        return len(given) == 1 and secrets.compare_digest(given[0].encode(), self.secret.encode())


class Guard:
    """The middleware: it refuses the requests that `access` refuses, and adds the headers that keep foreign scripts out
    of the page.
    """

    def __init__(self, app: App, access: Access) -> None:
        self._app, self._access = app, access

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer a request (the call of the ASGI interface)."""
        if scope["type"] not in {"http", "websocket"}:
            await self._app(scope, receive, send)
            return
        refused = self._access.refusal(scope)
        if refused is None:
            await self._app(scope, receive, _with_headers(send))
        elif scope["type"] == "websocket":
            await receive()
            await send({"type": "websocket.close", "code": 4403, "reason": refused[1]})
        else:
            status, reason = refused
            content = [(b"content-type", b"text/plain; charset=utf-8"), *_HEADERS]
            await send({"type": "http.response.start", "status": status, "headers": content})
            await send({"type": "http.response.body", "body": reason.encode()})


def _headers(scope: Scope) -> Callable[[str], Iterable[str]]:
    pairs = [(name.decode("latin-1").lower(), value.decode("latin-1")) for name, value in scope["headers"]]
    return lambda wanted: (value for name, value in pairs if name == wanted)


def _with_headers(send: Send) -> Send:
    """Return `send` extended by the headers that a response does not set itself."""

    async def sending(message: Message) -> None:
        if message["type"] == "http.response.start":
            there = {name.lower() for name, _ in message["headers"]}
            message["headers"] = [*message["headers"], *(pair for pair in _HEADERS if pair[0] not in there)]
        await send(message)

    return sending
