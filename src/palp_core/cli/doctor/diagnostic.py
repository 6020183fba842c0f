"""What ``palp doctor`` finds."""

from typing import Literal

import msgspec

from palp_core.graph.discovery.choice import addressed

Level = Literal["ok", "note", "warning", "error"]


class Diagnostic(msgspec.Struct, frozen=True):
    """One thing that was looked at.

    Attributes:
        level: ``error``: it harms a run or did; ``warning``: it may; ``note``: good to know; ``ok``.
        what: What was found.
        where: The host's part, the file, the node or edge.
        advice: What to do; empty if nothing.
    """

    level: Level
    what: str
    where: str
    advice: str = ""

    def placed(self, where: str, run: str) -> "Diagnostic":
        """Return it with more of its place before what there is; its advice is about the run of that id."""
        advice = addressed(self.advice, run)
        return msgspec.structs.replace(self, where=where + self.where, advice=advice)


def error(where: str, what: str, advice: str) -> Diagnostic:
    """Return a finding that harms."""
    return Diagnostic("error", what, where, advice)


def warning(where: str, what: str, advice: str) -> Diagnostic:
    """Return a finding that may harm."""
    return Diagnostic("warning", what, where, advice)


def remark(where: str, what: str, advice: str = "") -> Diagnostic:
    """Return what is good to know."""
    return Diagnostic("note", what, where, advice)


def fine(where: str, what: str) -> Diagnostic:
    """Return that something is as it should be."""
    return Diagnostic("ok", what, where)
