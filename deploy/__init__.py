"""The laboratory: scenarios, launching, recording and the command line."""
