"""Predictive coding of laser scans: a receiver predicts each scan by ray casting, and receives prediction errors alone.

Begin with `scan_updates`, which codes one update: scans along their beams, then corrections. `coder` is the arithmetic
coder, `contexts` its probability model, and `stream` the sequence of updates of one map.
"""
