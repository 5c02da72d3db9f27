"""Names of the map encodings that work with exact lasers."""

from agent.encodings.catalog import ENCODINGS

EXACT = [name for name, kind in ENCODINGS.items() if not kind.needs_range_scans]
