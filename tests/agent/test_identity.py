from io import BytesIO

import pytest
from hypothesis import given
from hypothesis import strategies as st
from msgspec.structs import replace

from agent.identity import Identity
from agent.journal import Journal, JournalError
from agent.settings import EncodingSettings, ReplicationSettings, Settings
from protocol.body import Body

SETTINGS = Settings(
    robot=1, bodies=(Body(5.0, 360.0, 5.0),) * 3, width=20, height=10, beams=36, seed=0, strategy="meier",
    encoding=EncodingSettings("polygons"), replication=ReplicationSettings("backoff"), incarnations=3,
)  # fmt: skip


def test_each_incarnation_has_its_own_map_id_and_the_home_of_the_first() -> None:
    file = BytesIO()
    incarnations = []
    for place in ((4, 5), (9, 9), (0, 1)):
        identity = Identity(Journal(file))
        incarnations.append(identity.begin(SETTINGS))
        identity.settle(*place)
    assert [incarnation.own_map for incarnation in incarnations] == [1, 4, 7]
    assert [incarnation.home for incarnation in incarnations] == [None, (4, 5), (4, 5)]
    with pytest.raises(JournalError, match="robot 1 has used up its 3 incarnations"):
        Identity(Journal(file)).begin(SETTINGS)


def test_a_torn_record_does_not_count_as_an_incarnation() -> None:
    file = BytesIO()
    Identity(Journal(file)).begin(SETTINGS)
    before = len(file.getvalue())
    Identity(Journal(file)).begin(SETTINGS)
    torn = BytesIO(file.getvalue()[: before + 9])
    assert Identity(Journal(torn)).begin(SETTINGS).incarnation == 1


def test_the_journal_of_another_robot_is_rejected() -> None:
    file = BytesIO()
    Identity(Journal(file)).begin(replace(SETTINGS, robot=2))
    with pytest.raises(
        JournalError, match="incarnation 0 of robot 2 of 3, expected incarnation 0 of robot 1 of 3"
    ):
        Identity(Journal(file)).begin(SETTINGS)


def test_a_home_outside_the_map_is_rejected() -> None:
    file = BytesIO()
    identity = Identity(Journal(file))
    identity.begin(SETTINGS)
    identity.settle(20, 0)
    with pytest.raises(JournalError, match=r"home is at \(20, 0\), outside the map"):
        Identity(Journal(file)).begin(SETTINGS)


@given(st.lists(st.binary(max_size=30), max_size=4))
def test_any_records_are_read_or_rejected_as_a_journal_error(records: list[bytes]) -> None:
    journal = Journal(BytesIO())
    for record in records:
        journal.append(record)
    try:
        assert Identity(journal).begin(SETTINGS).incarnation < SETTINGS.incarnations
    except JournalError as error:
        assert "record" in str(error) or "incarnations" in str(error)
