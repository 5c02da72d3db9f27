"""Runs: describing them, starting their processes, recording, viewing and evaluating them.

Packages, each of which imports only those before it:

    scenario                               settings of a run
    record                                 its results
    dashboard                              the live view
    run, field                             execution: of a simulated team, or of one robot in the field
    after, study, bench, chaos, serve      all that builds on runs; these do not import each other
    commands                               the command line

Start with `run/exploration.py`, which takes one run from its scenario to its directory. The Python API is the package
`murmur`.
"""
