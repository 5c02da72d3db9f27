"""From a planning grid to a path: frontiers and candidates, costs, utility, assignment, routes.

It imports `protocol` and nothing else of ours. Begin with `path_planner.py`, which brings costs, paths and
frontiers of one grid together; the strategies are made of the other files.
"""
