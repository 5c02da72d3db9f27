"""Chaos: swarms of real code under faults that are drawn from a seed, and what must hold of them all the same.

Begin with `deploy.chaos.case` (what is drawn), then `invariants` (what must hold), then `runs` (running, shrinking).
Imports the rooms up to `deploy.run`.
"""
