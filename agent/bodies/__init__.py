"""Bodies: where a robot's `Sense` comes from, and where its `Move` goes."""
