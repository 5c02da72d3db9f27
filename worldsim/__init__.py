"""The physical world: maps, laser, motion and the clock."""
