"""The unit of times by the clock: whole nanoseconds."""

SECOND = 10**9
"""Nanoseconds of a second."""
