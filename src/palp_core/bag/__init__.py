"""Bags: a recording as a folder of MCAP files that loses nothing, survives a crash and opens anywhere."""
