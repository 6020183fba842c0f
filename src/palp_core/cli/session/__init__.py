"""The verbs of ``palp session``."""

from palp_core.cli.lazy import Verb, lazy_app

_HERE = "palp_core.cli.session"

app = lazy_app(
    {
        "new": Verb(f"{_HERE}.sheet:new", "Write a session sheet to fill in."),
        "show": Verb(f"{_HERE}.sheet:show", "Show and check the sheet of a session, a bag or a file."),
        "plan": Verb(f"{_HERE}.sheet:plan", "Show the trials of a session with a person."),
        "operate": Verb(f"{_HERE}.operate:operate", "Show the operator's tasks, and send what is typed."),
        "redo": Verb(f"{_HERE}.decide:redo", "Mark a trial to be done again; it does not count."),
        "exclude": Verb(f"{_HERE}.decide:exclude", "Exclude a trial; it does not count."),
        "seal": Verb(f"{_HERE}.decide:seal", "Give phantoms new codes, and seal the key."),
        "unseal": Verb(f"{_HERE}.decide:unseal", "Open a blinded session: depths replace codes."),
        "list": Verb(f"{_HERE}.results:list_sessions", "List and pool the sessions of a folder."),
        "report": Verb(f"{_HERE}.results:report", "Make the report of a session's folder or bag."),
        "reanalyse": Verb(f"{_HERE}.results:reanalyse", "Decide stored sweeps again with other methods."),
        "people": Verb(f"{_HERE}.results:people", "Analyse sessions with people together."),
        "export": Verb(f"{_HERE}.results:export", "Write a session as tidy tables for other tools."),
    }
)
