"""Who may ask a server on this host: a client that has its token and calls the host by a name of its own.

A page that somebody has open may connect to any port of their own host, and a name of another site may lead
here (DNS rebinding). Which pages may ask (``Origin``) is each server's own.
"""

import hmac
import secrets
from collections.abc import Sequence
from urllib.parse import urlsplit

LOOPBACK_NAMES = frozenset({"localhost", "127.0.0.1", "::1"})


def new_token() -> str:
    """Return a token that cannot be guessed: 192 bits, for an address."""
    return secrets.token_urlsafe(24)


def is_token(given: str, token: str) -> bool:
    """Compare in constant time."""
    return hmac.compare_digest(given.encode(), token.encode())


def named_host(headers: Sequence[str]) -> str:
    """Return the name in a request's only ``Host`` header; "" if there are several, none, or it is no host.

    >>> named_host(["[::1]:80"]), named_host(["a@localhost"]), named_host(["localhost", "evil.example"])
    ('::1', '', '')
    """
    if len(headers) != 1 or "@" in headers[0]:
        return ""
    try:
        return urlsplit(f"//{headers[0]}").hostname or ""
    except ValueError:
        return ""
