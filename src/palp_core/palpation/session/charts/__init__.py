"""Charts of a session: what was learnt, what came of it, the rig, and one trial step by step."""
