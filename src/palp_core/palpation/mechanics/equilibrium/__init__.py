"""Where the probe's joint comes to rest, and its motion."""
