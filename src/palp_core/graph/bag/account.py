"""Which sequences of a topic were seen and which are missing, epoch by epoch."""

import msgspec


class Gap(msgspec.Struct, frozen=True):
    """Missing messages ``first`` to ``last`` of an epoch, both missing."""

    epoch: int
    first: int
    last: int

    @property
    def count(self) -> int:
        return self.last - self.first + 1


class EpochAccount:
    """Account of one epoch of a topic; ``first`` must come first, None: whatever comes first is the first."""

    def __init__(self, epoch: int, first: int | None) -> None:
        self.epoch = epoch
        self.next = self._first = first  # the sequence that comes next if nothing is missing
        self.count = self.repeated = 0  # messages seen, each once, and seen again
        self._gaps: list[tuple[int, int]] = []

    @property
    def numbered(self) -> bool:
        """Whether its messages have sequences; other programs repeat one where they assign none."""
        return bool(not self.repeated or self.count > 1 or self._gaps)

    def add(self, sequence: int) -> None:
        if self.next is None:
            self.next = self._first = sequence
        if sequence == self.next:
            self.next = sequence + 1
            self.count += 1
        elif sequence > self.next:
            self._gaps.append((self.next, sequence - 1))
            self.next = sequence + 1
            self.count += 1
        else:
            self._fill(sequence)

    def expect(self, last: int) -> None:
        """Take into account that the publisher has published up to ``last``."""
        if self.next is None:
            self.next = self._first = last + 1
        elif last >= self.next:
            self._gaps.append((self.next, last))
            self.next = last + 1

    def expect_from(self, first: int) -> int | None:
        """Take into account that ``first`` belongs to it; return the last one before those that were seen."""
        if self._first is None:
            self.next = self._first = first
        if first >= self._first:
            return None
        last = self._first - 1
        self._gaps.append((first, last))
        self._first = first
        return last

    def lacks(self, sequence: int) -> bool:
        return any(first <= sequence <= last for first, last in self._gaps)

    @property
    def gaps(self) -> list[Gap]:
        """What is missing, in order, neighbours joined."""
        joined: list[tuple[int, int]] = []
        for first, last in sorted(self._gaps):
            if joined and joined[-1][1] + 1 == first:
                joined[-1] = (joined[-1][0], last)
            else:
                joined.append((first, last))
        return [Gap(self.epoch, first, last) for first, last in joined]

    def _fill(self, sequence: int) -> None:
        """Take a message that comes late: it fills a gap or is a repeat."""
        for place, (first, last) in enumerate(self._gaps):
            if first <= sequence <= last:
                parts = [(first, sequence - 1), (sequence + 1, last)]
                self._gaps[place : place + 1] = [part for part in parts if part[0] <= part[1]]
                self.count += 1
                return
        self.repeated += 1


class TopicAccount:
    """Account of one topic over the restarts of its publisher.

    ``from_start``: the first epoch seen must begin at sequence 1, as later ones always must.
    """

    def __init__(self, *, from_start: bool = False) -> None:
        self._from_start = from_start
        self.epochs: dict[tuple[int, int], EpochAccount] = {}

    def epoch(self, epoch: int, publisher: int = 0, first: int | None = None) -> EpochAccount:
        """Return the account of an epoch of a publisher; a new one begins with ``first`` if given."""
        account = self.epochs.get((epoch, publisher))
        if account is None:
            if first is None and (self._from_start or any(known < epoch for known, _ in self.epochs)):
                first = 1
            account = self.epochs[epoch, publisher] = EpochAccount(epoch, first)
        return account

    @property
    def numbered(self) -> bool:
        """Whether sequences are assigned, in every epoch."""
        return all(account.numbered for account in self.epochs.values())

    @property
    def count(self) -> int:
        """Messages seen, each once; without sequences, all of them."""
        return sum(a.count + (0 if a.numbered else a.repeated) for a in self.epochs.values())

    @property
    def repeated(self) -> int:
        """Messages seen more than once; without sequences, this does not show."""
        return sum(a.repeated for a in self.epochs.values() if a.numbered)

    @property
    def gaps(self) -> list[Gap]:
        """What is missing, epoch by epoch."""
        return [gap for key in sorted(self.epochs) for gap in self.epochs[key].gaps]

    @property
    def lost(self) -> int:
        return sum(gap.count for gap in self.gaps)
