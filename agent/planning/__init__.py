"""From a planning grid to a way: frontier, cost, utility, sight."""
