"""What is said: packets, messages, keys, the two buses; and what all must mean alike: cells, beams, draws.

It imports nothing else of ours. Begin with `packets.py`, the radio bit for bit, and `messages.py`, all else.
"""
