"""The verbs of ``palp session``; each lives in a file of its own."""

from palp_core.cli.lazy import Verb, lazy_app

_HERE = "palp_core.cli.session"

app = lazy_app(
    "Sessions: with people, by operators, and what was decided about their trials.",
    {
        "plan": Verb(f"{_HERE}.plan:plan", "Show what a session with a person will ask, without any rig."),
        "operate": Verb(
            f"{_HERE}.operate:operate",
            "Answer what the running graph asks of its operator, in this terminal.",
        ),
        "people": Verb(
            f"{_HERE}.people:people",
            "Analyse sessions with people: accuracy, confusion, ANOVA, times, power.",
        ),
    },
)
