"""Chaos testing: swarms of the real code under random faults, with invariants that must hold in every run.

`case.py` draws a run from a seed, `byzantine.py` adds robots that send hostile frames, and `false_maps.py` robots whose
maps are false. `invariants.py` lists the invariants, and `runs.py` runs cases and shrinks failing ones. This package
builds on `deploy.run`.
"""
