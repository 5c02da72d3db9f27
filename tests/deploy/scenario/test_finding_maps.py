"""Where map files are searched."""

from __future__ import annotations

from pathlib import Path

import pytest

from deploy.scenario.finding_maps import find_map
from worldsim import generators, maps
from worldsim.maps import MapError


def test_a_map_file_is_searched_in_the_working_directory_and_then_in_the_map_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    here, folder = tmp_path / "here", tmp_path / "folder"
    here.mkdir()
    folder.mkdir()
    monkeypatch.chdir(here)
    monkeypatch.setenv("MURMUR_MAPS", str(folder))
    maps.save(generators.make("em"), folder / "house.yaml")
    assert find_map("house.yaml", 0, {}).cells.shape == generators.make("em").cells.shape
    picture = find_map("house.png", 0, {"resolution": 0.2})
    assert picture.resolution == 0.2
    maps.save(generators.make("office"), here / "house.yaml")
    assert find_map("house.yaml", 0, {}).cells.shape == generators.make("office").cells.shape
    with pytest.raises(MapError, match=r"^other\.yaml: no such file, neither here nor in"):
        find_map("other.yaml", 0, {})
