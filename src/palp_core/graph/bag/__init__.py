"""Recordings: written, read, mended, compared and converted."""
