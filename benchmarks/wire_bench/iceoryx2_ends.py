"""iceoryx2 (the Python binding of Eclipse iceoryx2), reliable, one process per end.

The array is written once, into memory that is shared, and read there, as a numpy array. A reader's queue does
not overflow: a publisher waits for who is slow. Readers sleep until an event wakes them (a publisher notifies
after each message, a reader takes all that is there): to ask again and again would be faster and cost a core
each. No service of discovery runs; a service is found by its files.

To be known when its rates are read: a reader holds the array and touches none of it, and a stage of 1 MiB has
512 messages at most, so that above some 10,000 Hz the 10 ms that a stage may be late flatter it.

Run by the bench, with a Python that has it:
``python iceoryx2_ends.py pitcher|catcher FOLDER NUMBER READERS``.
"""

from __future__ import annotations

import ctypes
import gc
import struct
import sys
import time
from pathlib import Path
from typing import Any

import iceoryx2 as iox2
import numpy as np
from drive import Array, Drive, sleep_until
from meter import sign_in
from plan import Arrivals, read_plan

HEAD = struct.Struct("<qqq")  # index, stamp, bytes of the array or count
END = -1
GLANCE_NS = 10_000_000
QUEUE_BYTES = 64 << 20
MOST_DEEP = 1000
MOST_NODES = 8  # five readers and a publisher have room
Double = ctypes.c_double


class Topic:
    """One end of a topic: a service of messages, and one of events that wakes its readers."""

    def __init__(self, node: Any, name: str, deep: int, readers: int) -> None:
        self.data = (
            node.service_builder(iox2.ServiceName.new(name))
            .publish_subscribe(iox2.Slice[Double])
            .enable_safe_overflow(False)
            .subscriber_max_buffer_size(deep)
            .history_size(0)
            .max_publishers(1)
            .max_subscribers(readers)
            .max_nodes(MOST_NODES)
            .open_or_create()
        )
        events = node.service_builder(iox2.ServiceName.new(f"{name}/event")).event()
        self.event = events.max_notifiers(1).max_listeners(readers).max_nodes(MOST_NODES).open_or_create()

    def write(self, largest: int) -> Writer:
        """Return the writing end, for arrays of at most so many bytes."""
        return Writer(self, largest)

    def read(self) -> tuple[Any, Any]:
        """Return the reading end: what receives, and what waits."""
        listener = self.event.listener_builder().create()
        return self.data.subscriber_builder().create(), listener

    @property
    def readers(self) -> int:
        """How many read."""
        there = self.data.dynamic_config.number_of_subscribers
        return min(there, self.event.dynamic_config.number_of_listeners)


class Writer:
    """The writing end of a topic."""

    def __init__(self, topic: Topic, largest: int) -> None:
        doubles = (HEAD.size + largest) // ctypes.sizeof(Double)
        self.publisher = topic.data.publisher_builder().initial_max_slice_len(doubles).create()
        self.notifier = topic.event.notifier_builder().create()

    def send(self, head: bytes, values: Array | None) -> None:
        """Send a message."""
        size = 0 if values is None else values.nbytes
        loan = self.publisher.loan_slice_uninit((HEAD.size + size) // 8)
        place = loan.payload_ptr
        ctypes.memmove(place, head, HEAD.size)
        if values is not None:
            ctypes.memmove(place + HEAD.size, values.ctypes.data, size)
        loan.assume_init().send()
        self.notifier.notify()


def folder_topics(folder: Path, readers: int) -> tuple[Any, Topic, Topic, int]:
    """Return this process's node, the topics of messages and replies, and the bytes of the largest array."""
    iox2.set_log_level(iox2.LogLevel.Error)
    node = iox2.NodeBuilder.new().create(iox2.ServiceType.Ipc)
    largest = max(phase.size for phase in read_plan(folder))
    deep = min(MOST_DEEP, QUEUE_BYTES // largest)
    block = Topic(node, f"{folder.name}/block", deep, readers)
    return node, block, Topic(node, f"{folder.name}/reply", MOST_DEEP, 1), largest


class Pitcher(Drive):
    """The publishing end; waits for its readers."""

    def __init__(self, folder: Path, readers: int) -> None:
        super().__init__(folder)
        self.node, block, reply, largest = folder_topics(folder, readers)
        self.block = block.write(largest)
        self.replies, self.replied = reply.read()
        while block.readers < readers:
            sleep_until(time.monotonic_ns() + GLANCE_NS)
        gc.collect()
        gc.freeze()

    def send(self, index: int, values: Array) -> None:
        self.block.send(HEAD.pack(index, time.monotonic_ns(), values.nbytes), values)

    def receive(self, timeout_ns: int) -> tuple[int, int, int] | None:
        until_ns = time.monotonic_ns() + timeout_ns
        while (sample := self.replies.receive()) is None:
            left_ns = until_ns - time.monotonic_ns()
            if left_ns <= 0:
                return None
            self.replied.timed_wait(iox2.Duration.from_nanos(left_ns))
        index, sent_ns, count = HEAD.unpack(ctypes.string_at(sample.payload_ptr, HEAD.size))
        sample.delete()
        return index, sent_ns, count

    def end(self) -> None:
        """Tell the readers to end."""
        self.block.send(HEAD.pack(END, 0, 0), None)
        sleep_until(time.monotonic_ns() + 300_000_000)


def catch(folder: Path, number: int, readers: int) -> None:
    """Be the reading end until told to end."""
    sign_in(folder)
    node, block, reply, _ = folder_topics(folder, readers)
    answer = reply.write(0) if number == 0 else None
    messages, waking = block.read()
    arrivals = Arrivals()
    gc.collect()
    gc.freeze()
    while True:
        sample = messages.receive()
        if sample is None:
            waking.blocking_wait()
            continue
        place = sample.payload_ptr
        index, sent_ns, size = HEAD.unpack(ctypes.string_at(place, HEAD.size))
        if index == END:
            break
        np.frombuffer((ctypes.c_char * size).from_address(place + HEAD.size))
        arrived_ns = time.monotonic_ns()
        if arrivals.take(index, sent_ns, arrived_ns) and answer is not None:
            answer.send(HEAD.pack(index, sent_ns, arrivals.count), None)
        sample.delete()
    arrivals.write(folder / f"arrivals{number}.npy")
    del sample, messages, waking, node


if __name__ == "__main__":
    role, place, which, reader_count = sys.argv[1:]
    if role == "pitcher":
        pitcher = Pitcher(Path(place), int(reader_count))
        pitcher.run()
        pitcher.end()
    else:
        catch(Path(place), int(which), int(reader_count))
