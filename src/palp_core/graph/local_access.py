"""Who may ask a server on this host: one policy for pages and viewers.

A page in somebody's browser may connect to any port of their own host, and a name of another site may lead
here (DNS rebinding). So a request must have the token, call the host by a name of its own, and come from a
page that the server admits (``Origin``).
"""

import hmac
import secrets
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass
from enum import Enum
from urllib.parse import urlsplit

LOOPBACK_NAMES = frozenset({"localhost", "127.0.0.1", "::1"})


class Refusal(Enum):
    """What of a request is not admitted."""

    HOST = 1
    ORIGIN = 2
    TOKEN = 3


@dataclass(frozen=True)
class AccessPolicy:
    """Who is let in.

    Attributes:
        admits: Tells of an ``Origin`` and the request's ``Host`` whether that page may ask.
    """

    token: str
    admits: Callable[[str, str], bool]
    hosts: Collection[str] = LOOPBACK_NAMES

    def refusal(self, hosts: Sequence[str], origins: Sequence[str], tokens: Sequence[str]) -> Refusal | None:
        """Judge a request by its headers ``Host`` and ``Origin`` and its tokens; None: it is let in."""
        if named_host(hosts) not in self.hosts:
            return Refusal.HOST
        if not all(self.admits(origin, hosts[0]) for origin in origins):
            return Refusal.ORIGIN
        # compared in constant time
        known = len(tokens) == 1 and hmac.compare_digest(tokens[0].encode(), self.token.encode())
        return None if known else Refusal.TOKEN


def new_token() -> str:
    """Return a token that cannot be guessed: 192 bits, for an address."""
    return secrets.token_urlsafe(24)


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
