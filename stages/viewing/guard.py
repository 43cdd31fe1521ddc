"""Decides who may use the viewer: requests for its own address, from its own page, and from elsewhere with the token.

The page can start commands, so pages of other sites must not reach it: browsers let any page open a websocket to this
machine. A request must name an address of this machine (otherwise a foreign name was pointed at it: DNS rebinding), and
a websocket must come from a page of that address.
"""

import hmac
import http
import ipaddress
import secrets
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from http.cookies import CookieError, SimpleCookie
from typing import Any
from urllib.parse import parse_qs, urlsplit

from stages.configs.view import HERE

COOKIE = "stylerf_view"
Handler = Callable[[Any, Any], Any]


def new_token() -> str:
    """Return a token for the URL, of 128 random bits."""
    return secrets.token_urlsafe(16)


class Guard:
    """Accepts or refuses requests. token: empty if only this machine can reach the viewer."""

    def __init__(self, token: str = "") -> None:
        self.token = token

    def refusal(self, path: str, headers: Any) -> str:
        """Return why a request is refused, empty if it is accepted.

        Args:
            path: with its query.
            headers: of the request, by name.
        """
        host = headers.get("Host", "")
        if not self.token and _name_of(host) not in HERE:
            return "this viewer only answers requests for this machine's own address"
        if headers.get("Upgrade", "").lower() == "websocket":
            origin = urlsplit(headers.get("Origin", ""))
            if origin.netloc.lower() != host.lower():
                return "a page of another site must not use this viewer"
        if self.token and not (self.has_token(path) or self._has_cookie(headers.get("Cookie", ""))):
            return "the token is missing: open the full address that `stylerf view` printed"
        return ""

    def has_token(self, path: str) -> bool:
        """Return whether a path's query contains the token."""
        given = parse_qs(urlsplit(path).query).get("token", [""])[0]
        return bool(self.token) and hmac.compare_digest(given.encode(), self.token.encode())

    def cookie(self) -> str:
        """Return the Set-Cookie header of a page opened with the token, since its websocket sends no query."""
        return f"{COOKIE}={self.token}; HttpOnly; SameSite=Strict; Path=/"

    def _has_cookie(self, text: str) -> bool:
        try:
            found = SimpleCookie(text).get(COOKIE)
        except CookieError:
            return False
        return found is not None and hmac.compare_digest(found.value.encode(), self.token.encode())

    def over(self, handler: Handler) -> Handler:
        """Return a websockets process_request that asks the guard first, then `handler`."""

        def guarded(connection: Any, request: Any) -> Any:
            why = self.refusal(request.path, request.headers)
            if why:
                return connection.respond(http.HTTPStatus.FORBIDDEN, why + "\n")
            response = handler(connection, request)
            if response is not None:
                response.headers["Referrer-Policy"] = "no-referrer"
                response.headers["X-Frame-Options"] = "DENY"
                if self.has_token(request.path):
                    response.headers["Set-Cookie"] = self.cookie()
            return response

        return guarded

    @contextmanager
    def set_over_servers(self) -> Iterator[list[int]]:
        """Guard every websockets server that starts within the block; yields a list with an entry for each.

        viser accepts no request handler, but starts its server with this function.
        """
        import websockets.asyncio.server as servers

        plain, started = servers.serve, list[int]()

        def serve(*arguments: Any, process_request: Handler, **options: Any) -> Any:
            started.append(1)
            return plain(*arguments, process_request=self.over(process_request), **options)

        servers.serve = serve  # type: ignore[assignment,misc]
        try:
            yield started
        finally:
            servers.serve = plain  # type: ignore[misc]


def _name_of(host: str) -> str:
    """Return the name in a Host header, without the port and an IPv6 address's brackets."""
    try:
        name = urlsplit(f"//{host}").hostname or ""
        return str(ipaddress.ip_address(name)) if ":" in name else name
    except ValueError:
        return ""
