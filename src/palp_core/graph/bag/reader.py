"""Read a bag: typed messages from a folder or a file, with nothing but the bag.

::

    for message in read("bags/session", topics=["/estimator/belief"]):
        print(message.sequence, message.value.posterior)

    torque_n_m = to_numpy("bags/session", "/torque/block", "torque_n_m")
"""

import re
from collections.abc import Callable, Collection, Iterator
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any, NamedTuple, Self

import msgspec
import numpy as np
from numpy.typing import NDArray

from palp_core.errors import BagDamaged, BagError
from palp_core.graph.bag.mcap.file_reader import FileReader
from palp_core.graph.bag.metadata import bag_files, named_files
from palp_core.graph.bag.stream import Stream, decoder_for
from palp_core.graph.messages.topic import Topic


class RecordedMessage(NamedTuple):
    """A message as it was recorded.

    Attributes:
        stream: Its topic, type and epoch.
        sequence: Its place in its topic and epoch, from 1.
        log_ns: When it was recorded, on the graph's clock.
        publish_ns: When it was published, on the graph's clock.
        payload: The bytes as on the wire.
    """

    stream: Stream
    sequence: int
    log_ns: int
    publish_ns: int
    payload: bytes


class BagMessage(msgspec.Struct, frozen=True, gc=False):
    """A decoded message; ``value`` has the message's fields as attributes, arrays as read-only numpy."""

    topic: str
    epoch: int
    sequence: int
    log_ns: int
    publish_ns: int
    value: Any


class Bag(AbstractContextManager["Bag"]):
    """An open bag.

    Args:
        path: A bag's folder or one of its files.

    Attributes:
        files: Its files in order.

    Raises:
        BagError: No such bag.
        BagDamaged: One of its files is not an MCAP file.
    """

    def __init__(self, path: str | Path) -> None:
        self.path = Path(path)
        self.files: list[FileReader] = []
        self._streams: list[dict[int, Stream]] = []
        try:
            for file in bag_files(self.path):
                self.files.append(FileReader(file))
                self._streams.append({})
        except BaseException:
            self.close()
            raise

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        for file in self.files:
            file.close()

    def whole(self) -> Self:
        """Return the bag, or raise a BagError, so that what is made of it lacks nothing unnoticed."""
        if problems := self.problems:
            self.close()
            raise BagError(f"{self.path}: {problems[0]}; save what is intact: palp bag recover BAG -o NEW")
        return self

    @property
    def problems(self) -> list[str]:
        """What is wrong with the bag, as far as opening it shows."""
        return [
            *(f"{file.path.name}: {problem}" for file in self.files for problem in file.problems),
            *self.misnamed,
        ]

    @property
    def misnamed(self) -> list[str]:
        """Which files have the names of others by ``metadata.yaml``, so that their order is wrong."""
        found = []
        spans = named_files(self.path) if len(self.files) > 1 else {}
        for file in self.files:
            if file.statistics is not None:
                span = file.statistics.message_start_time, file.statistics.message_end_time
                others = [name for name, known in spans.items() if known == span]
                if others and file.path.name not in others:
                    found.append(f"{file.path.name}: it is {others[0]} by metadata.yaml; rename it")
        return found

    def streams(self) -> Iterator[Stream]:
        """Iterate the streams, file by file; of a damaged file, those of its intact chunks."""
        for place, file in enumerate(self.files):
            file.find_definitions()
            yield from (self.stream(place, channel) for channel in sorted(file.channels))

    def topics(self) -> dict[str, Topic]:
        """Return the topics by name; of a damaged file, those of its intact chunks."""
        return dict(sorted({stream.topic.name: stream.topic for stream in self.streams()}.items()))

    def stream(self, file: int, channel: int) -> Stream:
        """Return the stream of a channel of a file."""
        known = self._streams[file].get(channel)
        if known is None:
            reader = self.files[file]
            try:
                entry = reader.channels[channel]
                schema = reader.schemas[entry.schema_id] if entry.schema_id else None
                known = self._streams[file][channel] = Stream.of(entry, schema)
            except (KeyError, ValueError) as error:
                what = f"the definition of channel {channel} is missing or wrong: {error}"
                raise BagDamaged(reader.path, 0, what) from error
        return known

    def recorded(
        self,
        topics: Collection[str] | None = None,
        start_ns: int | None = None,
        end_ns: int | None = None,
    ) -> Iterator[RecordedMessage]:
        """Iterate messages undecoded, in the order of the recording; see :func:`read`."""
        for place, raw in self._raw(topics, start_ns, end_ns):
            streams = self._streams[place]
            for channel, sequence, log_ns, publish_ns, payload in raw:
                stream = streams[channel]
                yield RecordedMessage(
                    stream, stream.sequence_high << 32 | sequence, log_ns, publish_ns, payload
                )

    def messages(
        self, topics: Collection[str] | None = None, start_ns: int | None = None, end_ns: int | None = None
    ) -> Iterator[BagMessage]:
        """Iterate decoded messages; the arguments are those of :func:`read`."""
        routes: dict[tuple[int, int], tuple[str, int, int, Callable[[bytes], Any]]] = {}
        for place, raw in self._raw(topics, start_ns, end_ns):
            for channel, sequence, log_ns, publish_ns, payload in raw:
                route = routes.get((place, channel))
                if route is None:
                    stream = self._streams[place][channel]
                    high = stream.sequence_high << 32
                    route = stream.topic.name, stream.epoch, high, decoder_for(stream)
                    routes[place, channel] = route
                topic, epoch, high, decode = route
                try:
                    value = decode(payload)
                except (msgspec.MsgspecError, ValueError, RecursionError) as error:
                    where = f"{self.path}: {topic} epoch {epoch} sequence {high | sequence}"
                    raise BagError(f"{where}: not of its schema: {error}") from error
                yield BagMessage(topic, epoch, high | sequence, log_ns, publish_ns, value)

    def attachments(self) -> dict[str, bytes]:
        """Return the attachments by name; of the same name, the latest file's."""
        found: dict[str, bytes] = {}
        for file in self.files:
            found |= file.attachments()
        return found

    def metadata(self) -> dict[str, dict[str, str]]:
        """Return the metadata records by name; of the same name, the latest file's."""
        found: dict[str, dict[str, str]] = {}
        for file in self.files:
            found |= file.metadata()
        return found

    def _raw(
        self, topics: Collection[str] | None, start_ns: int | None, end_ns: int | None
    ) -> Iterator[tuple[int, list[tuple[int, int, int, int, bytes]]]]:
        for place, file in enumerate(self.files):
            wanted = None if topics is None and place == 0 else _Wanted(self, place, topics)
            for raw in file.messages(wanted, start_ns, end_ns):
                for channel in {message[0] for message in raw}:
                    self.stream(place, channel)
                yield place, raw


class _Wanted:
    """The channels of a file that somebody wants; asked while its definitions are still being found.

    Latched messages that a later file repeats are not wanted.
    """

    def __init__(self, bag: Bag, file: int, topics: Collection[str] | None) -> None:
        self._bag, self._file, self._topics = bag, file, topics
        self._known: dict[int, bool] = {}

    def __contains__(self, channel: object) -> bool:
        assert isinstance(channel, int)
        known = self._known.get(channel)
        if known is None:
            stream = self._bag.stream(self._file, channel)
            named = self._topics is None or stream.topic.name in self._topics
            known = self._known[channel] = named and not (stream.repeated and self._file)
        return known


def read(
    bag: str | Path,
    topics: Collection[str] | None = None,
    start_ns: int | None = None,
    end_ns: int | None = None,
) -> Iterator[BagMessage]:
    """Iterate a bag's messages in the order of the recording.

    Args:
        bag: A bag's folder or one of its files.
        topics: Only these; None: all.
        start_ns: Only from this log time on; chunks before it are not read.
        end_ns: Only before this log time.

    Yields:
        One decoded message after another, in flat memory.

    Raises:
        BagError: No such bag, no such topic, or a payload that is not of its schema.
        BagDamaged: The bytes are not what was written; all messages before them have been yielded.
    """
    with Bag(bag) as opened:
        if topics is not None and all(file.closed for file in opened.files):
            unknown = [topic for topic in topics if topic not in opened.topics()]
            if unknown:
                has = ", ".join(opened.topics()) or "none"
                raise BagError(f"{bag} has no topic {', '.join(unknown)}; it has: {has}")
        yield from opened.messages(topics, start_ns, end_ns)


def to_numpy(bag: str | Path, topic: str, field: str) -> NDArray[Any]:
    """Return one field of a topic over the whole bag.

    Args:
        bag: A bag's folder or one of its files.
        topic: As in ``/torque/block``.
        field: As in ``torque_n_m``; of a nested message ``pose.depth_m``; also ``sequence``, ``log_ns`` and
            ``publish_ns``, where the message has no such field.

    Returns:
        Shape (messages,) for a scalar; for arrays, (messages, n) if all have n elements, else all of them
        one after another, (total,).

    Raises:
        BagError: No such bag, topic or field, or a field that is no number.
    """
    values = [_dig(message, field) for message in read(bag, [topic])]
    if values and isinstance(values[0], np.ndarray):
        sizes = {value.size for value in values}
        return np.stack(values) if len(sizes) == 1 else np.concatenate(values)
    array = np.array(values)
    if array.dtype == object:
        raise BagError(f"{topic}: {field} is neither a number nor text")
    return array


def _dig(message: BagMessage, field: str) -> Any:
    value = message.value
    for name in field.split("."):
        if isinstance(value, dict) and name in value:
            value = value[name]
        elif isinstance(value, msgspec.Struct) and hasattr(value, name):
            value = getattr(value, name)
        elif field in ("sequence", "log_ns", "publish_ns"):
            return getattr(message, field)
        else:
            has = value.__struct_fields__ if isinstance(value, msgspec.Struct) else ()
            raise BagError(f"{message.topic} has no field '{field}'; it has: {', '.join(has)}")
    return value


def topic_selection(
    topics: Collection[str] = (), regex: str | None = None, exclude_regex: str | None = None
) -> Callable[[str], bool]:
    """Return the test whether a topic is chosen: by default all are; an excluded one never is."""
    names = set(topics)
    try:
        wanted, unwanted = (re.compile(text) if text else None for text in (regex, exclude_regex))
    except re.error as error:
        raise BagError(f"'{error.pattern!s}' is not a regular expression: {error}") from error

    def chosen(topic: str) -> bool:
        if unwanted is not None and unwanted.search(topic):
            return False
        if not names and wanted is None:
            return True
        return topic in names or (wanted is not None and wanted.search(topic) is not None)

    return chosen
