"""The verbs of ``palp session``; each lives in a file of its own."""

from palp_core.cli.lazy import Verb, lazy_app

_HERE = "palp_core.cli.session"

app = lazy_app(
    "Sessions: their sheets, with people, by operators, and what was decided about their trials.",
    {
        "plan": Verb(
            f"{_HERE}.plan:plan",
            "Show what a session with a person will ask, in which order, and how long it takes.",
        ),
        "operate": Verb(
            f"{_HERE}.operate:operate",
            "Show what the graph asks of its operator, and send what is typed.",
        ),
        "redo": Verb(f"{_HERE}.decide:redo", "Mark a trial that is to be done again: it does not count."),
        "exclude": Verb(f"{_HERE}.decide:exclude", "Exclude a trial: it does not count."),
        "seal": Verb(f"{_HERE}.seal:seal", "Give phantoms new codes, and seal which is which."),
        "unseal": Verb(f"{_HERE}.seal:unseal", "Open a blinded session: depths take the place of codes."),
        "people": Verb(
            f"{_HERE}.people:people",
            "Analyse sessions with people together: accuracy by depth, confusion, ANOVA, times to answer.",
        ),
        "new": Verb(f"{_HERE}.sheet:new", "Write a session's sheet to fill in."),
        "show": Verb(f"{_HERE}.sheet:show", "Show the sheet of a session, a bag or a file, and check it."),
        "redact": Verb(f"{_HERE}.sheet:redact", "Copy a session without what tells who it was."),
    },
)
