"""Planning algorithms on a grid: frontiers, goal candidates, path costs, utilities, assignments, tours and routes.

Begin with `path_planner.py`, which offers costs, paths and frontiers of one grid. The strategies combine the other
files.
"""
