"""Where a graph is called from other hosts, and how: beyond this host only with keys."""

import ipaddress
import re
import socket
from pathlib import Path
from typing import NamedTuple

from palp_core.errors import SecurityError
from palp_core.graph.network.keys import KeyFolder

_ADDRESS = re.compile(r"tcp://(?P<host>\[[0-9A-Fa-f:.%\w]+\]|[^\s:/\[\]]+):(?P<port>\d{1,5}|\*)")


class ListenPlan(NamedTuple):
    """Where to listen, with the host as a number, whether behind CURVE, and what the user should know."""

    endpoint: str
    secured: bool
    warnings: list[str]


def host_and_port(address: str) -> tuple[str, int]:
    found = _ADDRESS.fullmatch(address)
    port = 0 if found is None or found["port"] == "*" else int(found["port"])
    if found is None or port > 65535:
        raise SecurityError(
            f"'{address}' is not an address; write tcp://HOST:PORT, as in tcp://192.168.1.5:7600"
        )
    return found["host"].strip("[]"), port


def plan_listening(address: str, keys: KeyFolder) -> ListenPlan:
    """Decide how to listen at ``tcp://HOST:PORT``: host ``*`` is every interface, port 0 any free one."""
    host, port = host_and_port(address)
    number = resolve("0.0.0.0" if host == "*" else host, address)
    endpoint = f"tcp://[{number}]:{port}" if number.version == 6 else f"tcp://{number}:{port}"
    own = keys.own()
    if own is None and not number.is_loopback:
        raise SecurityError(
            f"refusing to listen on {address}: other hosts can reach it, and there are no keys in "
            f"{keys.path}. Make a pair: palp keys generate; then let others in: palp keys allow FILE. "
            "To be reached from this host only: tcp://127.0.0.1:PORT"
        )
    warnings = []
    if own is None:
        warnings.append(
            f"listening on {address} without keys: every user of this host can join and command the nodes; "
            "make a pair: palp keys generate"
        )
    elif not keys.allowed():
        warnings.append(
            "no host is allowed to join; on the other host: palp keys generate; here: palp keys allow FILE"
        )
    warnings += [
        f"{keys.path / 'allowed' / name}.public contains no key; '{name}' is not allowed"
        for name in keys.spoiled()
    ]
    return ListenPlan(endpoint, own is not None, warnings)


def resolve(host: str, address: str) -> ipaddress.IPv4Address | ipaddress.IPv6Address:
    """Return a host's address as a number; errors name ``address``."""
    try:
        found = socket.getaddrinfo(host, None, type=socket.SOCK_STREAM)
    except OSError as error:
        if Path("/sys/class/net", host).exists():
            raise SecurityError(f"{address}: write the address of interface {host}, not its name") from error
        raise SecurityError(f"{address}: no host '{host}' ({error.strerror})") from error
    return ipaddress.ip_address(str(found[0][4][0]).partition("%")[0])


class Address(NamedTuple):
    """Where a graph is called; without CURVE the key is ""."""

    endpoint: str
    server_key: str


def plan_call(endpoint: str, server_key: str | None, keys: KeyFolder) -> Address:
    """Find the keys for a call; ``server_key`` is a public key, a file that holds it, or an allowed host."""
    host, _ = host_and_port(endpoint)
    number = resolve(host, endpoint)
    if server_key is None:
        if not number.is_loopback:
            raise SecurityError(
                f"{endpoint} is another host: give its public key with --server-key KEY or FILE; it is "
                "shown there by: palp keys list"
            )
        return Address(endpoint, "")
    own, key = keys.own(), keys.find(server_key)
    if own is None:
        raise SecurityError(
            f"this host has no keys in {keys.path}; make a pair: palp keys generate; then, where the "
            "graph runs: palp keys allow FILE"
        )
    return Address(endpoint, key)
