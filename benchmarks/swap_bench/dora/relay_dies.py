"""A dora node: a relay that dies before it is up."""

raise RuntimeError("this relay dies at its start, as the bench wants it")
