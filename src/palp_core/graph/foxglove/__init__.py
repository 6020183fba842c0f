"""A running graph for Foxglove's viewers, by their own protocol; needs the extra ``foxglove``."""
