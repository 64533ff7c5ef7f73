"""Distances over a maze: the truth is the shortest path, walls are left out, and all that ships is asked."""

import numpy as np
import pytest

from benchmarks import distance_maps
from napsp import envs
from napsp.errors import UserError
from planners.app.maze_map import at_rest, in_walls, wall_boxes


def test_walls_are_where_the_simulation_has_them():
    world = envs.make("point_maze").unwrapped
    boxes = [i for i in range(world.model.ngeom) if world.model.geom_type[i] == 6]
    found = {tuple(np.round([*world.model.geom_pos[i][:2], *world.model.geom_size[i][:2]], 6)) for i in boxes}
    assert {tuple(np.round(box, 6)) for box in wall_boxes(world.scale)} <= found
    assert list(in_walls(np.array([[0.0, 0.0], [0.5, 0.5], [0.0, 0.4]]) * world.scale, world.scale)) == [
        True,
        False,
        True,
    ]


def test_the_first_field_is_the_truth_and_plus_is_nearer_to_it_than_ours():
    world, goal = envs.make("point_maze").unwrapped, (0.5, 0.5)
    found = distance_maps.fields("point_maze", goal, 25)
    truth, line, ours, plus = found.values()
    places = at_rest(world.scale, 25)[:, :2]
    free = ~in_walls(places, world.scale).reshape(25, 25)
    expected = world.shortest_steps(places, world.scale * np.array(goal)).reshape(25, 25)
    np.testing.assert_array_equal(truth[free], expected[free])
    assert np.isnan(truth[~free]).all() and 0 < (~free).sum() < 200
    off = [np.abs(field - truth)[free].mean() for field in (line, ours, plus)]
    assert off[2] < 1.0 < off[0] < off[1]


def test_a_picture_is_made_of_mazes_alone(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("sys.argv", ["command", "--bins", "12"])
    assert distance_maps.main() == 0 and (tmp_path / "results" / "distance_maps_point_maze.png").stat().st_size > 10_000
    monkeypatch.setattr("sys.argv", ["command", "--env", "fetch_wall"])
    with pytest.raises(UserError, match="not for fetch_wall"):
        distance_maps.main()
