"""Liveliness tokens, and the gids that follow from them."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from protocol.errors import ProtocolError
from protocol.ros2.names import DataKey
from protocol.ros2.qos import DEFAULT, LATCHED, Qos
from protocol.ros2.tokens import EndpointToken, Kind, NodeToken, gid, parse_token
from tests.protocol.ros2.test_names import HASH, data_keys, names, parts
from tests.protocol.ros2.test_qos import profiles

SESSION = "aac3178e146ba6f1fc6e6a4085e77f21"
LISTENER = NodeToken(2, SESSION, 0, "/", "listener")
SERVICE_HASH = "RIHS01_e118de6bf5eeb66a2491b5bda11202e7b68f198d6f67922cf30364858239c81a"

sessions = st.from_regex(r"[0-9a-f]{1,32}", fullmatch=True)
ids = st.integers(0, 1000)
nodes = st.builds(
    NodeToken, st.integers(0, 232), sessions, ids, names | st.just("/"), parts, names | st.just("/")
)


@st.composite
def endpoints(draw: st.DrawFn) -> EndpointToken:
    node, key = draw(nodes), draw(data_keys)
    kind = draw(st.sampled_from([each for each in Kind if each is not Kind.NODE]))
    key = DataKey(node.domain, key.name, key.type, key.type_hash)
    return EndpointToken(node, draw(ids), kind, key, draw(profiles))


@pytest.mark.parametrize(
    ("token", "text"),
    [
        (LISTENER, f"@ros2_lv/2/{SESSION}/0/0/NN/%/%/listener"),
        (
            EndpointToken(
                LISTENER,
                10,
                Kind.SUBSCRIPTION,
                DataKey(2, "/chatter", "std_msgs/msg/String", HASH),
                DEFAULT,
            ),
            f"@ros2_lv/2/{SESSION}/0/10/MS/%/%/listener/%chatter/std_msgs::msg::dds_::String_/{HASH}/::,10:,:,:,,",
        ),
        (
            EndpointToken(
                NodeToken(2, SESSION, 0, "/", "talker"),
                10,
                Kind.PUBLISHER,
                DataKey(2, "/chatter", "std_msgs/msg/String", HASH),
                Qos(depth=7),
            ),
            f"@ros2_lv/2/{SESSION}/0/10/MP/%/%/talker/%chatter/std_msgs::msg::dds_::String_/{HASH}/::,7:,:,:,,",
        ),
        (
            EndpointToken(
                NodeToken(2, SESSION, 0, "/", "add_two_ints_server"),
                10,
                Kind.SERVER,
                DataKey(2, "/add_two_ints", "example_interfaces/srv/AddTwoInts", SERVICE_HASH),
                DEFAULT,
            ),
            f"@ros2_lv/2/{SESSION}/0/10/SS/%/%/add_two_ints_server/%add_two_ints/"
            f"example_interfaces::srv::dds_::AddTwoInts_/{SERVICE_HASH}/::,10:,:,:,,",
        ),
        (
            EndpointToken(
                NodeToken(0, SESSION, 3, "/team/r1", "murmur"),
                4,
                Kind.PUBLISHER,
                DataKey(0, "/team/r1/map", "nav_msgs/msg/OccupancyGrid", HASH),
                LATCHED,
            ),
            f"@ros2_lv/0/{SESSION}/3/4/MP/%/%team%r1/murmur/%team%r1%map/"
            f"nav_msgs::msg::dds_::OccupancyGrid_/{HASH}/:1:,1:,:,:,,",
        ),
    ],
)
def test_tokens_have_the_text_of_rmw_zenoh(token: NodeToken | EndpointToken, text: str) -> None:
    assert str(token) == text
    assert parse_token(text) == token


@given(nodes | endpoints())
def test_tokens_are_parsed_to_what_they_were(token: NodeToken | EndpointToken) -> None:
    assert parse_token(str(token)) == token


def test_parts_that_later_versions_add_are_ignored() -> None:
    token = EndpointToken(LISTENER, 10, Kind.CLIENT, DataKey(2, "/a", "p/srv/T", HASH), DEFAULT)
    assert parse_token(f"{token}/cpu") == token


def test_a_gid_is_the_hash_of_the_token_with_its_low_half_first() -> None:
    # XXH3-128 of the empty input is 99aa06d3014798d8 6001c324468d497f (specification of XXH3)
    assert gid("").hex() == "7f498d4624c30160d8984701d306aa99"


def test_a_node_has_the_name_that_ros2_node_list_prints() -> None:
    assert LISTENER.full_name == "/listener"
    assert NodeToken(0, SESSION, 0, "/team/r1", "murmur").full_name == "/team/r1/murmur"


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("0/scan/a/b", "not @ros2_lv and at least 9 parts"),
        ("@ros2_lv/2/aa/0/0/NN/%/%", "at least 9 parts"),
        ("@ros2_lv/x/aa/0/0/NN/%/%/listener", "'x' is not a domain"),
        ("@ros2_lv/2/zz/0/0/NN/%/%/listener", "'zz' is not the id of a Zenoh session"),
        ("@ros2_lv/2/aa/-1/0/NN/%/%/listener", "'-1' is not an id"),
        ("@ros2_lv/2/aa/0/0/XX/%/%/listener", "'XX' is not a valid Kind"),
        ("@ros2_lv/2/aa/0/0/NN/%/%/my-node", "'my-node' is not the name of a node"),
        ("@ros2_lv/2/aa/0/0/MP/%/%/talker", "9 parts instead of 13"),
        (f"@ros2_lv/2/aa/0/1/MP/%/%/talker/%a/String/{HASH}/::,10:,:,:,,", "'String' is not a DDS type"),
        (f"@ros2_lv/2/aa/0/1/MP/%/%/talker/%a/p::msg::dds_::T_/{HASH}/::,10", "3 fields between colons"),
    ],
)
def test_a_malformed_token_gets_an_error_that_names_the_part(text: str, reason: str) -> None:
    with pytest.raises(ProtocolError, match=reason):
        parse_token(text)
