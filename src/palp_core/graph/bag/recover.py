"""Save what is intact of a damaged bag into a new one."""

from contextlib import suppress
from pathlib import Path

import msgspec

from palp_core.counted import counted
from palp_core.errors import BagError
from palp_core.graph.bag.account import TopicAccount
from palp_core.graph.bag.info import noted_complete
from palp_core.graph.bag.mcap.chunk import Compression, RawMessage
from palp_core.graph.bag.mcap.records import Attachment, Metadata
from palp_core.graph.bag.mcap.salvage import Salvage, salvage
from palp_core.graph.bag.metadata import bag_files, in_order, missing_files
from palp_core.graph.bag.reader import Bag
from palp_core.graph.bag.recorder import RECOVERED_NAME, SUMMARY_NAME
from palp_core.graph.bag.stream import Stream
from palp_core.graph.bag.writer import BagWriter, whole_folder


class RecoverReport(msgspec.Struct, kw_only=True):
    """What was saved and what was not.

    Attributes:
        missing_files: Files that ``metadata.yaml`` names and that are gone.
        message_count: Messages saved, per topic.
        unverified_count: Of them, those that no CRC covers: from a chunk that the file's end cuts off (the
            last ones), or, of another program, from a chunk without a CRC or outside any chunk.
        unchecked_chunk_count: Chunks without a CRC, of those counted as intact.
        gaps: Messages that are missing between saved ones, per topic.
        complete: Nothing was lost, as far as the damaged bag shows, and its writer knows.
        problems: What is wrong with each file.
        orphan_count: Messages whose topic is no longer known; they are not saved.
    """

    files: list[str] = []
    missing_files: list[str] = []
    chunk_count: int = 0
    damaged_chunk_count: int = 0
    damaged_bytes: int = 0
    message_count: dict[str, int] = {}
    unverified_count: int = 0
    unchecked_chunk_count: int = 0
    orphan_count: int = 0
    gaps: dict[str, int] = {}
    complete: bool = True
    problems: list[str] = []

    def text(self) -> str:
        lines = [f"{counted(sum(self.message_count.values()), 'message')} saved; {self.damage()}"]
        if self.unverified_count:
            lines.append(f"no CRC covers {self.unverified_count} of them: they may be wrong")
        lines += [f"{name} is missing, with all its messages" for name in self.missing_files]
        lines += [f"{name}: {lost} missing in between" for name, lost in self.gaps.items() if lost]
        return "\n".join(lines + self.problems)

    def damage(self) -> str:
        """Return what is intact and what is not."""
        parts = [
            counted(self.chunk_count, "intact chunk"),
            counted(self.damaged_chunk_count, "damaged chunk"),
            counted(self.damaged_bytes, "damaged byte"),
        ]
        if self.orphan_count:
            parts.append(f"{counted(self.orphan_count, 'message')} of unknown topics not saved")
        return ", ".join(parts)


def recover(bag: str | Path, out: str | Path, compression: Compression = "zstd") -> RecoverReport:
    """Write everything intact of a bag into a new bag; a bag that is whole comes out whole.

    Nothing is left of the new bag after an error, as where nothing could be saved.
    """
    path = Path(bag)
    files = [path] if path.is_file() else in_order(path) or bag_files(path)  # which raises why there is none
    report = RecoverReport(missing_files=missing_files(path))
    misnamed: list[str] = []
    with suppress(BagError), Bag(path) as opened:
        report.problems += (misnamed := opened.misnamed)
    with whole_folder(out) as folder, BagWriter(folder, compression=compression) as writer:
        saver, ended = _Saver(writer), True
        attachments: dict[str, Attachment] = {}
        metadata: dict[str, Metadata] = {}
        for file in files:
            found = salvage(file)
            ended &= found.ended
            name = file.name.encode(errors="replace").decode()
            report.files.append(name)
            report.problems += [f"{name}: {problem}" for problem in found.problems]
            chunks = [chunk for chunk in found.chunks if not chunk.bare]
            report.chunk_count += len(chunks)
            report.damaged_chunk_count += found.damaged_chunk_count
            report.damaged_bytes += found.damaged_bytes
            report.unchecked_chunk_count += sum(chunk.offset in found.unchecked for chunk in chunks)
            for messages, checked in found.messages():
                saved = saver.save(found, messages)
                report.unverified_count += 0 if checked else saved
            report.unverified_count += saver.save(found, found.torn_messages())
            attachments |= found.attachments  # of the same name, the latest file's
            metadata |= found.metadata
        noted = noted_complete({name: attachment.data for name, attachment in attachments.items()})
        for attachment in attachments.values():
            if attachment.name not in (SUMMARY_NAME, RECOVERED_NAME):
                writer.attach(attachment.name, attachment.data, attachment.media_type)
        for record in metadata.values():
            writer.add_metadata(record.name, record.metadata)
        report.orphan_count = saver.orphan_count
        report.gaps = {name: account.lost for name, account in sorted(saver.accounts.items())}
        report.message_count = {name: account.count for name, account in sorted(saver.accounts.items())}
        harm = misnamed or report.missing_files or report.damaged_bytes or report.orphan_count
        report.complete = ended and noted and not (harm or any(report.gaps.values()))
        writer.attach(RECOVERED_NAME, msgspec.json.encode(report), "application/json")
        if not (report.message_count or report.complete):
            why = "; ".join([report.damage(), *report.problems])
            raise BagError(f"{path}: no message could be saved: {why}")
    return report


class _Saver:
    """Writes messages that were found; repeated ones only where the original is lost."""

    def __init__(self, writer: BagWriter) -> None:
        self._writer = writer
        self.accounts: dict[str, TopicAccount] = {}
        self.orphan_count = 0
        self._seen: set[tuple[str, int, int]] = set()
        self._streams: dict[tuple[Path, int], Stream | None] = {}

    def save(self, found: Salvage, messages: list[RawMessage]) -> int:
        saved = 0
        for channel, low, log_ns, publish_ns, payload in messages:
            place = found.path, channel
            if place not in self._streams:
                self._streams[place] = _stream(found, channel)
            stream = self._streams[place]
            if stream is None:
                self.orphan_count += 1
                continue
            topic, sequence = stream.topic, stream.sequence_high << 32 | low
            if topic.latched_depth:
                key = (topic.name, stream.epoch, sequence)
                if stream.repeated and key in self._seen:
                    continue
                self._seen.add(key)
            stream = msgspec.structs.replace(stream, repeated=False) if stream.repeated else stream
            self._writer.write(self._writer.stream(stream), sequence, log_ns, publish_ns, payload)
            self.accounts.setdefault(topic.name, TopicAccount()).epoch(stream.epoch, stream.publisher).add(
                sequence
            )
            saved += 1
        return saved


def _stream(found: Salvage, channel: int) -> Stream | None:
    try:
        entry = found.channels[channel]
        return Stream.of(entry, found.schemas[entry.schema_id] if entry.schema_id else None)
    except (KeyError, ValueError):
        return None
