"""The pictures of the README are drawn from planned episodes."""

import sys

import numpy as np
import pytest
from PIL import Image

from benchmarks import filmed, pictures
from napsp.errors import UserError


@pytest.fixture
def short_episodes(monkeypatch):
    monkeypatch.setattr("napsp.envs.episode_length", lambda name: 3)


def test_an_animation_keeps_frames_size_and_colours(tmp_path):
    red, blue = (Image.new("RGB", (40, 30), colour) for colour in ("red", "blue"))
    pages = filmed.beside([red, blue, red], [blue, blue, blue], gap=10)
    filmed.write_gif(tmp_path / "a.gif", pages)
    with Image.open(tmp_path / "a.gif") as made:
        assert made.n_frames == 3 and made.size == (90, 30)
        assert made.info["duration"] == filmed.FRAME_MS
        first = np.array(made.convert("RGB"))
        assert first[15, 10].tolist() == [255, 0, 0] and first[15, 80].tolist() == [0, 0, 255]
        made.seek(2)
        assert made.info["duration"] == filmed.LAST_MS


def test_the_maze_is_drawn_with_both_costs(short_episodes, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(sys, "argv", ["pictures", "--only", "point_maze", "--out", str(tmp_path)])
    assert pictures.main() == 0
    assert capsys.readouterr().out == f"picture: {tmp_path / 'point_maze.png'}\n"
    with Image.open(tmp_path / "point_maze.png") as made:
        assert made.width > 600 and len(np.unique(np.array(made.convert("L")))) > 50


def test_a_frame_shows_the_scene_under_its_words(short_episodes):
    shot = filmed.Shot(
        "MPPI, cost: straight line", "mppi", {"env": "fetch_wall", "cost": "euclidean", "search.samples": 4}
    )
    try:
        pages = filmed.filmed(shot, 0, 18, pictures.ALONG_THE_WALL, 200)
    except UserError as error:
        pytest.skip(str(error))
    assert len(pages) == 3 and all(page.size == (200, 190) for page in pages)
    scene = np.array(pages[-1])[20:170]
    assert scene.std() > 20, "something is drawn"
    assert (np.array(pages[0])[:20] < 100).any(), "a title stands above"
