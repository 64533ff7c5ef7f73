"""Frames of a video: their file, and those of an environment that draws itself."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import imageio_ffmpeg
import numpy as np
from PIL import Image, ImageDraw, ImageFont

from mpc.controller import Plan
from napsp.envs.gap import goal_gap

FRAMES_PER_SECOND = 12
MODE = "rgb_array"


def caption(env: Any, observation: dict[str, np.ndarray], plan: Plan) -> str:
    """What a frame shows, in numbers: the gap to the goal and what the cheapest plan costs."""
    gap = np.linalg.norm([observation["achieved_goal"] - observation["desired_goal"]], axis=1)
    shown, unit = goal_gap(env.unwrapped, gap)
    if unit == "m":
        shown, unit = 100.0 * shown, "cm"  # as tables have it
    finite = plan.costs[np.isfinite(plan.costs)]
    return f"gap {shown[0]:.3g} {unit}".rstrip() + (f"   cheapest plan {finite.min():.3g}" if len(finite) else "")


def captioned(image: np.ndarray, text: str) -> np.ndarray:
    """Pixels ``(height, width, 3)`` with a line of text in the upper left corner, legible on any ground."""
    page = Image.fromarray(image)
    font = ImageFont.load_default(14)
    ImageDraw.Draw(page).text((8, 6), text, (255, 255, 255), font, stroke_width=1, stroke_fill=(0, 0, 0))
    return np.asarray(page)


class Film:
    """Writes frames to an MP4, which is there once it is whole."""

    def __init__(self, path: Path) -> None:
        self._path, self._writer = path, None
        self._partial = path.with_name(f".{path.stem}.partial{path.suffix}")

    def add(self, image: np.ndarray) -> None:
        """Add pixels ``(height, width, 3)``, of one size all along."""
        if self._writer is None:
            size = image.shape[1], image.shape[0]
            self._writer: Any = imageio_ffmpeg.write_frames(
                str(self._partial), size, fps=FRAMES_PER_SECOND, macro_block_size=16, ffmpeg_log_level="error"
            )
            self._writer.send(None)
        self._writer.send(np.ascontiguousarray(image))

    def close(self) -> str | None:
        """Finish the file; return the line to show the user, None without frames."""
        if self._writer is None:
            return None
        self._writer.close()
        self._partial.replace(self._path)
        return f"video: {self._path}"

    def abandon(self) -> None:
        """Leave no file."""
        if self._writer is not None:
            self._writer.close()
            self._partial.unlink(missing_ok=True)


def draws_itself(env: Any) -> bool:
    """Whether an environment without a MuJoCo model makes pictures of its own."""
    return env.unwrapped.model is None and MODE in env.metadata.get("render_modes", ())


class OwnFrames:
    """A video of what an environment without a MuJoCo model draws, without goal and plans where it draws none."""

    def __init__(self, path: Path, env: Any) -> None:
        self._env, self._film = env, Film(path)

    def frame(self, observation: dict[str, np.ndarray], plan: Plan) -> None:
        """Add a frame of the world as it is before the plan's action is executed."""
        image = self._env.render() if draws_itself(self._env) else None
        if isinstance(image, np.ndarray) and image.ndim == 3 and image.shape[2] == 3:
            self._film.add(captioned(image.astype(np.uint8), caption(self._env, observation, plan)))

    def close(self) -> str:
        """Finish the file; return the line to show the user."""
        return self._film.close() or f"no video: the environment does not draw itself (render mode {MODE})"

    def abandon(self) -> None:
        """Leave no file: the episode will not be finished."""
        self._film.abandon()
