"""Grids as polygons, and polygons as grids again (thesis, chapters 4 and 5).

It imports no other package of the agent, and of the project only `protocol`. Read first `polygons.py` and `contour.py`;
then the sender's side, `approximation.py` (repair), `simplify.py` (refinement) and `edits.py`; then the receiver's,
`receiver.py`, `raster.py` and `merge.py`.
"""
