"""What a plotter takes: two ZeroMQ frames, topic and a msgpack map of plain numbers and lists with its time.

PlotJuggler sees no msgpack ``bin``, so arrays become lists; a block of samples (``start_ns``, ``rate_hz`` and
arrays of one length) becomes one map per sample, each at its own time. It draws a series per element of a
list and keeps every point, so what comes faster than wanted is thinned, and long lists are left out.
"""

from collections.abc import Iterator
from typing import Any

import msgpack
import zmq

from palp_core.errors import SecurityError
from palp_core.graph.network.listen_address import host_and_port, resolve

TIME = "timestamp"
LONGEST_LIST = 100
SEND_QUEUE = 10_000
_BLOCK = ("start_ns", "rate_hz")


def points(message: dict[str, Any], stamp_ns: int) -> Iterator[tuple[float, dict[str, Any]]]:
    """Yield a message's points as times in s and maps without long lists.

    Args:
        message: Plain values, arrays as lists.
        stamp_ns: When it was published, on the graph's clock.

    >>> block = {"start_ns": 0, "rate_hz": 1000.0, "torque_n_m": [0.5, 0.25]}
    >>> [(time_s, point["torque_n_m"]) for time_s, point in points(block, 7)]
    [(0.0, 0.5), (0.001, 0.25)]
    """
    lists = {name: value for name, value in message.items() if isinstance(value, list)}
    lengths = {len(value) for value in lists.values()}
    if lists and len(lengths) == 1 and all(name in message for name in _BLOCK) and message["rate_hz"] > 0:
        once = {name: value for name, value in message.items() if name not in lists}
        for i in range(lengths.pop()):
            time_s = message["start_ns"] / 1e9 + i / message["rate_hz"]
            yield time_s, {**once, **{name: value[i] for name, value in lists.items()}}
        return
    yield stamp_ns / 1e9, _without_long_lists(message)


def _without_long_lists(value: Any) -> Any:
    if isinstance(value, dict):
        return {
            name: _without_long_lists(item)
            for name, item in value.items()
            if not (isinstance(item, list) and len(item) > LONGEST_LIST)
        }
    return value


class TapFeed:
    """The sending end.

    Args:
        endpoint: ``tcp://HOST:PORT`` of this host, or ``ipc://PATH``; bound.
        fastest_hz: Points per second of a topic; 0: all of them.

    Attributes:
        sent_count: Points so far.

    Raises:
        SecurityError: Other hosts could reach it; a plotter has no keys.
        OSError: It is taken.
    """

    def __init__(self, endpoint: str, fastest_hz: float) -> None:
        if not endpoint.startswith("ipc://"):
            host, port = host_and_port(endpoint)
            number = resolve(host, endpoint)
            if not number.is_loopback:
                raise SecurityError(
                    f"refusing to send to {endpoint}: other hosts could read along, and a plotter has no "
                    "keys; use 127.0.0.1, and ssh -L to look from elsewhere"
                )
            endpoint = (
                f"tcp://[{number}]:{port or '*'}" if number.version == 6 else f"tcp://{number}:{port or '*'}"
            )
        self._period_s = 1.0 / fastest_hz if fastest_hz else 0.0
        self._last_s: dict[str, float] = {}
        self.sent_count = 0
        self._context = zmq.Context()
        self._socket = self._context.socket(zmq.PUB)
        self._socket.setsockopt(zmq.SNDHWM, SEND_QUEUE)
        self._socket.setsockopt(zmq.LINGER, 200)
        try:
            self._socket.bind(endpoint)
        except zmq.ZMQError as error:
            self._context.destroy(linger=0)
            raise OSError(error.errno, f"{endpoint}: {error.strerror}") from error
        self.endpoint = self._socket.getsockopt_string(zmq.LAST_ENDPOINT)

    def send(self, topic: str, message: dict[str, Any], stamp_ns: int) -> None:
        """Send the points of a message that are due."""
        for time_s, point in points(message, stamp_ns):
            last_s = self._last_s.get(topic)
            # Half a nanosecond of grace: the times of samples on the very grid are sums of floats.
            if last_s is not None and last_s <= time_s < last_s + self._period_s - 0.5e-9:
                continue
            self._last_s[topic] = time_s
            payload = msgpack.packb({TIME: time_s, **point})
            self._socket.send_multipart([topic.encode(), payload])
            self.sent_count += 1

    def close(self) -> None:
        """Send what is queued and let go."""
        self._context.destroy(linger=200)
