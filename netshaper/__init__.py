"""The relay of the radio: it decides which robots receive which frames, and accounts for every byte.

It imports `protocol` only. Read `process.py`, the relay on the bus; `radio.py`, the rounds of a step; `admission.py`;
`medium.py`, which carries frames; `channel.py`; `frame_log.py` and `ledger_rows.py`. `access.py` has the access control
of the hub.
"""
