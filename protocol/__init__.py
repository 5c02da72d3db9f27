"""Formats that all processes share: packets, messages, keys, the two buses; cells, scans and random numbers.

It imports no other package of the project. Start with `packets.py`, the radio bit by bit, and `messages.py`, the
messages on the bus.
"""
