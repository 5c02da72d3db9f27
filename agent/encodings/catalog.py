"""All map encodings by name, those of installed packages included."""

from __future__ import annotations

from agent.encodings.base import MapEncoding
from agent.encodings.cells import CellEncoding
from agent.encodings.none import NoEncoding
from agent.encodings.polygons import PolygonEncoding
from agent.encodings.predictive import PredictiveEncoding
from agent.encodings.scans import ScanEncoding
from agent.encodings.slam_toolbox import SlamToolboxEncoding
from agent.encodings.zstd_maps import ZstdMapEncoding
from agent.settings import Settings
from protocol.plugins import Plugins

ENCODINGS: dict[str, type[MapEncoding]] = {
    kind.name: kind
    for kind in (
        PolygonEncoding,
        ScanEncoding,
        CellEncoding,
        PredictiveEncoding,
        SlamToolboxEncoding,
        ZstdMapEncoding,
        NoEncoding,
    )
}
"""The encodings of this package."""

PLUGINS: Plugins[type[MapEncoding]] = Plugins(
    "map encoding", "murmur.map_encodings", MapEncoding, ENCODINGS, MapEncoding
)


def encoding_class(name: str) -> type[MapEncoding]:
    """Return the map encoding with this name, of this or an installed package, or given as ``package.module:Class``.

    Raises
    ------
    ValueError
        The name is unknown (the message lists similar names), or the class cannot be imported.
    """
    return PLUGINS.find(name)


def make_encoding(settings: Settings) -> MapEncoding:
    """Make the encoding that the settings name; ValueError lists the known names."""
    return encoding_class(settings.encoding.name)(settings)
