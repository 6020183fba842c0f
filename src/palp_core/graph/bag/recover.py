"""Save what is intact of a damaged bag into a new one."""

from pathlib import Path

import msgspec

from palp_core.errors import BagError
from palp_core.graph.bag.account import TopicAccount
from palp_core.graph.bag.mcap.chunk import RawMessage
from palp_core.graph.bag.mcap.compression import Compression
from palp_core.graph.bag.mcap.salvage import Salvage, salvage
from palp_core.graph.bag.metadata import bag_files, in_order
from palp_core.graph.bag.recorder import SUMMARY_NAME
from palp_core.graph.bag.stream import Stream
from palp_core.graph.bag.writer import BagWriter


class RecoverReport(msgspec.Struct, kw_only=True):
    """What was saved and what was not.

    Attributes:
        message_count: Messages saved, per topic.
        unverified_count: Of them, those for which no CRC vouches: from a chunk that the file's end cuts off
            (the last ones), or from one that another program wrote without a CRC.
        unchecked_chunk_count: Chunks without a CRC, of those counted as intact.
        gaps: Messages that are missing between saved ones, per topic.
        orphan_count: Messages whose topic is no longer known; they are not saved.
    """

    files: list[str] = []
    chunk_count: int = 0
    damaged_chunk_count: int = 0
    damaged_bytes: int = 0
    message_count: dict[str, int] = {}
    unverified_count: int = 0
    unchecked_chunk_count: int = 0
    orphan_count: int = 0
    gaps: dict[str, int] = {}

    def text(self) -> str:
        """Say it in words."""
        lines = [
            f"{sum(self.message_count.values())} messages saved from {self.chunk_count} intact chunks; "
            f"{self.damaged_chunk_count} damaged chunks, {self.damaged_bytes} damaged bytes"
        ]
        if self.unverified_count:
            lines.append(
                f"no CRC vouches for {self.unverified_count} of them, from a torn chunk or from "
                f"{self.unchecked_chunk_count} chunks that have none: they may be wrong"
            )
        if self.orphan_count:
            lines.append(f"{self.orphan_count} messages of unknown topics are not saved")
        lines += [f"{name}: {lost} missing in between" for name, lost in self.gaps.items() if lost]
        return "\n".join(lines)


def recover(bag: str | Path, out: str | Path, compression: Compression = "zstd") -> RecoverReport:
    """Write everything intact of a bag into a new bag; a bag that is whole comes out whole.

    Args:
        bag: A bag's folder or one of its files, in whatever state.
        out: The new bag, which must not exist.
        compression: Of the new bag.

    Raises:
        BagError: No such bag, or the new one exists.
    """
    report = RecoverReport()
    accounts: dict[str, TopicAccount] = {}
    seen: set[tuple[str, int, int]] = set()
    path = Path(bag)
    files = [path] if path.is_file() else _files(path)
    with BagWriter(out, compression=compression) as writer:
        for place, file in enumerate(files):
            found = salvage(file)
            report.files.append(file.name)
            report.chunk_count += len(found.chunks)
            report.damaged_chunk_count += found.damaged_chunk_count
            report.damaged_bytes += found.damaged_bytes
            saver = _Saver(writer, report, accounts, seen, found)
            report.unchecked_chunk_count += len(found.unchecked)
            for messages, checked in found.messages():
                saved = saver.save(messages)
                report.unverified_count += 0 if checked else saved
            report.unverified_count += saver.save(found.torn_messages())
            for attachment in found.attachments.values():
                if attachment.name != SUMMARY_NAME and place == len(files) - 1:
                    writer.attach(attachment.name, attachment.data, attachment.media_type)
            for metadata in found.metadata.values():
                if place == len(files) - 1:
                    writer.add_metadata(metadata.name, metadata.values)
        report.gaps = {name: account.lost for name, account in sorted(accounts.items())}
        report.message_count = {name: account.count for name, account in sorted(accounts.items())}
        writer.attach("palp/recovered.json", msgspec.json.encode(report), "application/json")
    return report


class _Saver:
    """Writes the messages of one file; repeated ones only where the original is lost."""

    def __init__(
        self,
        writer: BagWriter,
        report: RecoverReport,
        accounts: dict[str, TopicAccount],
        seen: set[tuple[str, int, int]],
        found: Salvage,
    ) -> None:
        self._writer, self._report, self._accounts, self._seen = writer, report, accounts, seen
        self._found = found
        self._streams: dict[int, Stream | None] = {}

    def save(self, messages: list[RawMessage]) -> int:
        """Save messages; return how many."""
        saved = 0
        for channel, low, log_ns, publish_ns, payload in messages:
            if channel not in self._streams:
                self._streams[channel] = self._stream(channel)
            stream = self._streams[channel]
            if stream is None:
                self._report.orphan_count += 1
                continue
            topic, sequence = stream.topic, stream.sequence_high << 32 | low
            if topic.latched_depth:
                key = (topic.name, stream.epoch, sequence)
                if stream.repeated and key in self._seen:
                    continue
                self._seen.add(key)
            stream = msgspec.structs.replace(stream, repeated=False) if stream.repeated else stream
            self._writer.write(self._writer.stream(stream), sequence, log_ns, publish_ns, payload)
            self._accounts.setdefault(topic.name, TopicAccount()).epoch(stream.epoch).add(sequence)
            saved += 1
        return saved

    def _stream(self, channel: int) -> Stream | None:
        try:
            entry = self._found.channels[channel]
            schema = self._found.schemas[entry.schema_id] if entry.schema_id else None
            return Stream.of(entry, schema)
        except (KeyError, ValueError):
            return None


def _files(folder: Path) -> list[Path]:
    """Return a folder's files; that ``metadata.yaml`` names more of them is no reason to give up."""
    try:
        return bag_files(folder)
    except BagError:
        files = in_order(folder)
        if not files:
            raise
        return files
