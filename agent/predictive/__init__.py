"""Say where you looked from: who holds the same map casts the scan again, and only surprises need telling.

`coder` writes decisions in as few bits as they are surprising, `contexts` says what is expected, `looks` walks along
the beams, and `stream` is the sequence of units that one robot tells of its map. Begin with `looks`.
"""
