"""The MCAP format alone: records, chunks, files."""
