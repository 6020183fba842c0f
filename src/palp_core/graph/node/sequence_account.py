"""What a reader knows of an edge: nothing arrives twice, nothing goes missing without being counted."""

import msgspec

from palp_core.graph.messages.frame import LAST_SEQUENCE


class SequenceAccount(msgspec.Struct):
    """Sequence account of one input. The first message of an epoch may have any sequence (a late joiner)."""

    epoch: int = -1
    sequence: int = 0
    received: int = 0
    lost: int = 0  # published, as the sequence shows, but never arrived
    repeated: int = 0  # arrived again, or after its place in the order had passed
    late: int = 0  # older than its deadline or lifespan when it was taken up
    # arrived, but not handed over: past its lifespan, or beyond a best-effort reader's depth
    dropped: int = 0

    def accept(self, epoch: int, sequence: int) -> bool:
        """Account for a message; return False for a repeat or one of an epoch that is over."""
        if epoch == self.epoch and sequence > self.sequence:
            if sequence > self.sequence + 1:
                self._lose(sequence - self.sequence - 1)
        elif epoch <= self.epoch:
            self.repeated += 1
            return False
        else:
            if self.epoch >= 0:
                self._lose(sequence - 1)  # what a restarted publisher sent before this reader was back
            self.epoch = epoch
        self.sequence = sequence
        self.received += 1
        return True

    def _lose(self, count: int) -> None:
        self.lost = min(self.lost + count, LAST_SEQUENCE)  # another host may claim any number

    def drop(self, epoch: int, sequence: int) -> None:
        if self.accept(epoch, sequence):
            self.received -= 1
            self.dropped += 1

    def heartbeat(self, epoch: int, sequence: int) -> None:
        """Take a publisher's word for its last sequence: it starts the account and reveals a lost tail."""
        if epoch > self.epoch:
            if self.epoch >= 0:
                self._lose(sequence)
            self.epoch, self.sequence = epoch, sequence
        elif epoch == self.epoch and sequence > self.sequence:
            self._lose(sequence - self.sequence)
            self.sequence = sequence
