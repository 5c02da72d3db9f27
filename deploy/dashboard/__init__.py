"""The live dashboard: a viewer on the bus, what it draws, windows that show it (docs/dashboard.md)."""
