"""``python -m palp_core`` is ``palp``."""

import signal


def main() -> None:
    """Run the command line; Ctrl-C while it is still being imported ends it without a traceback."""
    waits = signal.getsignal(signal.SIGINT) is signal.default_int_handler  # not in a background shell job
    if waits:
        signal.signal(signal.SIGINT, signal.SIG_DFL)
    from palp_core.cli.main import main as run

    if waits:
        signal.signal(signal.SIGINT, signal.default_int_handler)
    run()


if __name__ == "__main__":
    main()
