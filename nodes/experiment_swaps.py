"""Which policy takes over at which trial of the estimation: the part of a plan that swaps nodes."""

from __future__ import annotations


def planned(text: str) -> dict[int, str]:
    """Return the class by the number of the trial in which it takes over, counted from 1.

    >>> planned("30=nodes.policy_markov:Markov, 60=nodes.policy_uniform:Uniform")
    {30: 'nodes.policy_markov:Markov', 60: 'nodes.policy_uniform:Uniform'}

    Raises:
        ValueError: Not of that form.
    """
    found = {}
    for entry in filter(None, map(str.strip, text.split(","))):
        number, sign, run = entry.partition("=")
        if not sign or not number.strip().isdigit() or ":" not in run:
            raise ValueError(
                f"swaps: '{entry}' is not TRIAL=MODULE:CLASS, as in 30=nodes.policy_markov:Markov"
            )
        found[int(number)] = run.strip()
    return found


def name_of(run: str) -> str:
    """Return the name under which a policy stands in the record.

    >>> name_of("nodes.policy_markov:Markov")
    'markov'
    """
    return run.rpartition(":")[2].lower()
