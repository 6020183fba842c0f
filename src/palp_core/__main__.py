"""``python -m palp_core`` is ``palp``."""

from palp_core.cli.main import main

main()
