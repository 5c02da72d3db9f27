"""Recorded laser scans as a source of worlds."""
