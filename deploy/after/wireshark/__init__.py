"""The dissector for Wireshark and tshark, in Lua, and how it gets to where they look for it (`install.py`)."""
