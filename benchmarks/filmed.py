"""Planned episodes as animated pictures: the scene with the way so far, a line of words above, small files."""

from __future__ import annotations

import io
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from mpc.controller import Plan
from napsp.errors import UserError
from napsp.storage.files import write_atomically
from planners.app.config import PlanConfig
from planners.app.options import RunOptions
from planners.app.session import Session
from planners.app.video import Video

WAY_COLOR = (0.05, 0.05, 0.05, 1.0)
WORDS, PAPER = (30, 30, 30), (255, 255, 255)
FRAME_MS, LAST_MS = 180, 2500  # the end stays long enough to be read
N_COLORS = 96


@dataclass(frozen=True)
class Shot:
    """One planned episode to be drawn.

    Attributes:
        title: what stands above it.
        planner: search.
        changes: options of the plan, by dotted names.
        checkpoint: of the distance; None is the one that ships for the task.
    """

    title: str
    planner: str
    changes: dict[str, Any]
    checkpoint: Path | None = None

    def open(self) -> Session:
        """What plans it."""
        return Session.open(PlanConfig.of(self.planner, self.changes), RunOptions(checkpoint=self.checkpoint))


@dataclass(frozen=True)
class View:
    """Where a scene is seen from: degrees, metres."""

    azimuth: float
    elevation: float
    distance: float
    lookat: tuple[float, float, float]


class Frames(Video):
    """Keeps its frames, with the executed way in black, in place of writing a video."""

    def __init__(self, world: Any, view: View | None) -> None:
        super().__init__(Path("unused.mp4"), world)
        self.images: list[np.ndarray] = []
        self._way: list[np.ndarray] = []
        if view is not None:
            self._camera = world.camera
            self._camera.azimuth, self._camera.elevation = view.azimuth, view.elevation
            self._camera.distance, self._camera.lookat[:] = view.distance, view.lookat

    def frame(self, observation: dict[str, np.ndarray], plan: Plan) -> None:
        """Keep a frame.

        Raises:
            UserError: nothing can be drawn here.
        """
        self._way.append(self._world.goal_positions(observation["achieved_goal"]))
        image = self.image(observation, plan)
        if image is None:
            raise UserError(f"these pictures need a renderer; {self._problem}")
        self.images.append(image)

    def _draw_plans(self, plan: Plan) -> None:
        super()._draw_plans(plan)
        for start, end in pairwise(self._way):
            self._segment(start, end, 0.005, WAY_COLOR)


def filmed(shot: Shot, seed: int, n_frames: int, view: View | None, width: int) -> list[Image.Image]:
    """Frames of an episode before its steps 0, 1, ..., each with the shot's title and the outcome up to there."""
    session = shot.open()
    frames = Frames(session.env.unwrapped, view)
    try:
        result = session.run_episode(seed, [frames])
    finally:
        session.close()
        frames.close()
    world = session.env.unwrapped
    gaps = np.linalg.norm(
        world.goal_positions(result.achieved_goals) - world.goal_positions(result.desired_goal), axis=-1
    )
    found = []
    for step, image in enumerate(frames.images[: n_frames + 1]):
        there = result.first_hit is not None and step >= result.first_hit
        outcome = f"at the goal since step {result.first_hit}" if there else f"{100 * gaps[step]:.0f} cm to the goal"
        found.append(_captioned(Image.fromarray(image), shot.title, f"step {step}, {outcome}", width))
    return found


def _captioned(image: Image.Image, title: str, below: str, width: int) -> Image.Image:
    height, line = round(image.height * width / image.width), 20
    page = Image.new("RGB", (width, height + 2 * line), PAPER)
    page.paste(image.resize((width, height), Image.Resampling.LANCZOS), (0, line))
    write = ImageDraw.Draw(page)
    write.text((4, 2), title, WORDS, ImageFont.load_default(14))
    write.text((4, height + line + 2), below, WORDS, ImageFont.load_default(14))
    return page


def beside(left: list[Image.Image], right: list[Image.Image], gap: int = 8) -> list[Image.Image]:
    """Two animations as one."""
    pages = []
    for a, b in zip(left, right, strict=True):
        page = Image.new("RGB", (a.width + gap + b.width, a.height), PAPER)
        page.paste(a, (0, 0))
        page.paste(b, (a.width + gap, 0))
        pages.append(page)
    return pages


def write_gif(path: Path, pages: list[Image.Image]) -> None:
    """Write an animation that loops; all frames share one set of colours, undithered: what stays costs nothing."""
    whole = Image.new("RGB", (pages[0].width, sum(page.height for page in pages)))
    for k, page in enumerate(pages):
        whole.paste(page, (0, k * page.height))
    palette = whole.quantize(N_COLORS, dither=Image.Dither.NONE)
    first, *rest = (page.quantize(palette=palette, dither=Image.Dither.NONE) for page in pages)
    file = io.BytesIO()
    durations = [FRAME_MS] * len(rest) + [LAST_MS]
    first.save(file, "GIF", save_all=True, append_images=rest, duration=durations, loop=0, optimize=True)
    write_atomically(path, file.getvalue())
