"""What each task is planned with unless the user says otherwise."""

HORIZONS = {
    **dict.fromkeys(("point_maze", "point_maze_long"), 16),
    **dict.fromkeys(("fetch_reach", "fetch_wall", "fetch_wall_high"), 5),
    **dict.fromkeys(("fetch_pick_place", "fetch_pick_place_wall"), 8),
    **dict.fromkeys(("fetch_pick_place_plain", "fetch_pick_place_wall_plain"), 15),
    "claw": 10,
}
DEFAULT_HORIZON = 8  # of tasks without an entry
MULTIPLES: dict[str, tuple[float, ...]] = dict.fromkeys(("point_maze", "point_maze_long"), (1.0,))
DEFAULT_MULTIPLES = (0.3, 1.0, 3.0, 10.0)
PLANNING_SUBSTEPS = {  # of the coarse model; other tasks: a quarter of their own
    **dict.fromkeys(("point_maze", "point_maze_long"), 5),
    **dict.fromkeys((name for name in HORIZONS if name.startswith("fetch")), 5),
    "claw": 20,
}
