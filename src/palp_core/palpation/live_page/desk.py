"""What is asked of the operator, and what goes on meanwhile, kept from messages: of a graph, or of a bag."""

from __future__ import annotations

from typing import Any

import msgspec

from palp_core.view.source.protocol import Sample, ViewSource, open_watches

PROMPT, COUNTDOWN, BARS, DONE = "Prompt", "Countdown", "EffortBars", "HumanTrialDone"
ANSWER = "answer"
"""The service of the node that asks."""


class Question(msgspec.Struct, frozen=True):
    """What is asked, or only shown where ``kind`` is ``none``; an answer names its node and number."""

    node: str
    number: int
    kind: str
    text: str
    choices: list[str]
    stamp_ns: int


class DeskMonitor:
    """The operator's desk as one page sees it."""

    def __init__(self, source: ViewSource, *, recorded: bool = False) -> None:
        self._source, self._recorded = source, recorded
        self._topics = {
            topic.name: topic for topic in source.topics() if topic.type in (PROMPT, COUNTDOWN, BARS, DONE)
        }
        self._watches = open_watches(source, self._topics)
        self._prompts: dict[str, Question] = {}
        self._done: dict[tuple[int, int], tuple[int, dict[str, Any]]] = {}

    @property
    def asks(self) -> bool:
        """Whether anything in this graph may ask its operator."""
        return any(topic.type == PROMPT for topic in self._topics.values())

    def close(self) -> None:
        for watch in self._watches.values():
            watch.close()

    def load(self) -> None:
        """Take what was before the first look. It asks and reads: call it once, on a thread."""
        kept = [topic.name for topic in self._topics.values() if topic.type in (PROMPT, DONE)]
        if self._recorded:
            kept = [name for name in kept if self._topics[name].type == DONE]
        for name, sample in self._source.history(kept):
            self._take(name, sample)

    def look(self) -> None:
        for name, watch in self._watches.items():
            kind = self._topics[name].type
            if kind == DONE and not self._recorded:
                for sample in watch.read_new():
                    self._take(name, sample)
            elif kind == PROMPT:
                last = watch.latest()
                if last is not None:
                    self._take(name, last)
                elif self._recorded:
                    self._prompts.pop(name, None)

    def _take(self, name: str, sample: Sample) -> None:
        topic, message = self._topics[name], sample.message
        try:
            if topic.type == DONE:
                self._done[message["trial"], message["attempt"]] = sample.stamp_ns, message
                return
            asked = Question(
                topic.node, message["number"], message["kind"], message["text"],
                [str(choice) for choice in message["choices"]], sample.stamp_ns,
            )  # fmt: skip
        except KeyError:  # too large to be shown, or of another graph's type of that name
            return
        before = self._prompts.get(name)
        if self._recorded or before is None or asked.stamp_ns >= before.stamp_ns:
            self._prompts[name] = asked

    @property
    def question(self) -> Question | None:
        """What was asked last, else shown last; None before the first."""
        found = sorted(self._prompts.values(), key=lambda one: (one.kind != "none", one.stamp_ns))
        return found[-1] if found else None

    @property
    def countdown(self) -> dict[str, Any] | None:
        return self._since_asked(COUNTDOWN)

    @property
    def bars(self) -> dict[str, Any] | None:
        return self._since_asked(BARS)

    def _since_asked(self, kind: str) -> dict[str, Any] | None:
        asked = max((one.stamp_ns for one in self._prompts.values()), default=0)
        for name, watch in self._watches.items():
            sample = watch.latest() if self._topics[name].type == kind else None
            if sample is not None and sample.stamp_ns >= asked and "stamp_ns" in sample.message:
                return sample.message
        return None

    @property
    def rows(self) -> list[dict[str, Any]]:
        """The ``HumanTrialDone`` of each trial, the first one first; of a bag, by the chosen time."""
        now_s = self._source.overview().now_s if self._recorded else None
        until_ns = None if now_s is None else round(now_s * 1e9)
        return [
            message
            for _, (stamp_ns, message) in sorted(self._done.items())
            if until_ns is None or stamp_ns <= until_ns
        ]


def buttons_of(question: Question) -> list[tuple[str, str]]:
    """Return what may be pressed as an answer: what is on the button, and what is sent.

    >>> buttons_of(Question("session", 3, "enter", "Palpating.", ["", "again"], 0))
    [('go on (Enter)', ''), ('again', 'again')]
    >>> buttons_of(Question("session", 4, "choice", "How deep?", ["2", "4"], 0))
    [('2', '2'), ('4', '4')]
    """
    if question.kind == "choice":
        return [(choice, choice) for choice in question.choices]
    if question.kind == "enter":
        others = [(choice, choice) for choice in question.choices if choice]
        return [("go on (Enter)", ""), *others]
    return []
