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
from protocol import packet_codec, packets
from protocol.errors import ProtocolError, shown
from protocol.plugins import PluginError, Plugins

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

    ValueError: the name is unknown (the message lists similar names), or the class cannot be imported.
    """
    return PLUGINS.find(name)


def check_entries(encoding: MapEncoding, entries: object) -> None:
    """Raise PluginError if what `MapEncoding.encode_changes` of a plug-in returned is no list of packets of maps."""
    name = type(encoding).name
    if ENCODINGS.get(name) is type(encoding):
        return
    where = f"map encoding {name!r}: encode_changes must return a list of packets of maps"
    hint = "protocol.scans.fragments(data, most) splits bytes of any format into such packets"
    if not isinstance(entries, list) or not all(isinstance(entry, bytes) for entry in entries):
        raise PluginError(f"{where}, list[bytes]; it returned {shown(entries)}; {hint}")
    for entry in entries:
        try:
            kinds = [packet.name for packet in packet_codec.decode(entry)]
        except ProtocolError as error:
            raise PluginError(f"{where}; {shown(entry)} is none: {error}; {hint}") from None
        if len(kinds) != 1 or kinds[0] not in packets.MAP_KINDS:
            raise PluginError(f"{where}; {shown(entry)} is {' + '.join(kinds) or 'empty'}; {hint}")


def make_encoding(settings: Settings) -> MapEncoding:
    """Make the encoding that the settings name; ValueError lists the known names."""
    return encoding_class(settings.encoding.name)(settings)
