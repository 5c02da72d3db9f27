"""Chapters 4 and 5 of the thesis: a map told as polygons, and polygons made into maps again.

It imports `protocol` and nothing else of ours. Begin with `contour.py`; then `approximation.py` (repair),
`simplify.py` (refinement) and `edits.py` on the sender's side, `receiver.py`, `raster.py` and `merge.py` on the
other.
"""
