"""The messages: packets, messages, keys, the two buses; and the shared definitions of cells, beams, draws.

It imports none of the other rooms. Start with `packets.py`, the radio bit by bit, and `messages.py`, everything else.
"""
