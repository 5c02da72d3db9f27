"""The dissector for Wireshark and tshark, in Lua, and its installation (`install.py`)."""
