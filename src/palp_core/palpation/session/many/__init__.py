"""Many sessions: what lies in a folder of them, and what they say together."""
