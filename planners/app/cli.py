"""The command shared by all planners: ``python -m planners.mppi --env fetch_wall``."""

from __future__ import annotations

import sys
import warnings

from napsp.errors import run_command
from planners.app.gl import choose_gl, require_display


def main(planner: str) -> None:
    """Entry point of ``python -m planners.NAME``."""
    choose_gl()  # before anything imports mujoco
    run_command(lambda: run(planner, sys.argv[1:]))


def run(planner: str, arguments: list[str], prog: str | None = None) -> int:
    """Plan the episodes, print the table, write the output folder; ``prog`` is the command, see :func:`parse`.

    Ctrl-C ends the episodes early; what was done is still reported.
    """
    from planners.app.options import parse

    config, options = parse(planner, arguments, prog=prog)
    if options.render == "human":
        require_display()
    print(f"{config.env}: loading torch, MuJoCo and what was learned", flush=True)

    import torch

    from napsp.envs import episode_length
    from planners.app.distance_field import DistanceField
    from planners.app.folder import claim, release
    from planners.app.record import default_folder, describe_session
    from planners.app.report import Report
    from planners.app.session import Session
    from planners.app.ticker import Ticker
    from planners.app.video import recorder

    torch.set_num_threads(1)  # d is a sliver of the work; its threads would fight the simulator's
    session = Session.open(config, options)
    folder = options.out or default_folder(session.config, options)
    replaces = claim(folder, describe_session(session))
    report = Report(folder, session)
    report.announce(replaces)
    ticker = Ticker(options.episodes, episode_length(session.env_name))
    video = recorder(folder / "video.mp4", session.env) if options.video and options.render == "none" else None
    field = DistanceField(session) if DistanceField.drawable(session) else None
    with warnings.catch_warnings():
        warnings.simplefilter("default")
        try:
            for episode in range(options.episodes):
                watching = (video if episode < options.video_episodes else None, field if episode == 0 else None)
                seen_by = [ticker, *(w for w in watching if w is not None)]
                result = session.run_episode(options.seed + episode, seen_by, hold=options.hold or None)
                ticker.end_episode()
                report.add(result)
                if field is not None and episode == 0:
                    field.draw(folder / "distance_field.png", result)
                    report.note(f"distance field of the first episode: {folder}/distance_field.png")
        except BaseException as error:
            ticker.clear()
            if not isinstance(error, KeyboardInterrupt) or not report.results:
                if video is not None:
                    video.abandon()
                release(folder)
                raise
            report.note(f"interrupted after {len(report.results)} of {options.episodes} episodes")
    if video is not None:
        report.note(video.close())
    elif options.render == "human":
        report.note("no video: the episodes were shown in the viewer")
    report.finish()
    session.close()
    return 0 if len(report.results) == options.episodes else 130
