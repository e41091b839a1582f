"""The title picture: the same arm in the same sea under both controllers, still and moving."""

from __future__ import annotations

import tempfile
from collections.abc import Generator, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import imageio_ffmpeg
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.quiver import Quiver
from numpy.typing import NDArray

from softwave_min.arm import Arm
from softwave_min.figures.style import BLUE, GREY, INK, Drawing
from softwave_min.simulation import ClosedLoop, root_mean_square_error
from softwave_min.waves import Sea

__all__ = ["Side", "headline"]

Floats = NDArray[np.float64]

WINDOW = (27.0, 49.0)
FRAMES_PER_SECOND = 20
VIEW = (-0.45, 1.15, -4.6, -3.2)
ENCODERS: Mapping[str, tuple[str, list[str]]] = {
    # One thread and no encoder's signature: the same frames give the same file.
    "webm": ("libvpx-vp9", ["-b:v", "0", "-crf", "40", "-deadline", "realtime", "-cpu-used", "8"]),
    "mp4": ("libx264", ["-crf", "27", "-movflags", "+faststart"]),
}
REPRODUCIBLE = ["-threads", "1", "-fflags", "+bitexact", "-flags:v", "+bitexact"]


@dataclass(frozen=True)
class Side:
    """One half of the picture."""

    name: str
    colour: str
    loop: ClosedLoop


def headline(arm: Arm, sea: Sea, sides: tuple[Side, Side]) -> Drawing:
    """Draw the still and encode the film."""
    still = _Stage(arm, sea, sides)
    still.show_postures()
    film = _Stage(arm, sea, sides)
    first, last = (round(instant / film.period) for instant in WINDOW)
    media = _encode(film.frame(index) for index in range(first, last))
    plt.close(film.figure)
    errors = [100 * root_mean_square_error(side.loop.error[first:last]) for side in sides]
    return Drawing(
        still.figure,
        caption=(
            "The same arm in the same sea, its tip to be held at the cross: by feed-forward + PD "
            "(left) and by NMPC that previews the waves (right). Above, the elevation over the "
            f"base. Over the {last - first} control periods shown the tip is off by "
            f"{errors[0]:.1f} cm (root mean square) on the left, and {errors[1]:.1f} cm on the "
            "right."
        ),
        alt=(
            "Two side views of a three-segment arm under waves. On the left the postures fan "
            "out and the tip wanders over decimetres around the target cross; on the right the "
            "tip stays on the cross while the body bends."
        ),
        media=media,
    )


class _Stage:
    """The axes of the picture, and how the arms are put on them."""

    def __init__(self, arm: Arm, sea: Sea, sides: tuple[Side, Side]) -> None:
        self._base, self._sea, self._sides = arm.parameters.base_position, sea, sides
        # Of all instants at once, which costs hardly more than of one.
        self._bodies = [arm.axis(side.loop.q) for side in sides]
        self.figure: Figure = plt.figure(figsize=(8.0, 4.96), dpi=100)
        grid = self.figure.add_gridspec(2, 2, height_ratios=(1.0, 3.2))
        self._wave = self.figure.add_subplot(grid[0, :])
        self._views = [self.figure.add_subplot(grid[1, column]) for column in (0, 1)]
        times = np.linspace(*WINDOW, 600)
        self._wave.plot(times, sea.elevation(0.0, times), color=BLUE, linestyle="-")
        self._wave.set(xlim=WINDOW, xlabel="time, s", ylabel="elevation, m")
        for view, side in zip(self._views, sides, strict=True):
            self._furnish(view, side)
        self._moving = [self._movable(*pair) for pair in zip(self._views, sides, strict=True)]
        self._cursor = self._wave.axvline(WINDOW[0], color=INK, linewidth=1.0, linestyle="-")
        for artist in self._artists():
            artist.set_visible(False)
        self._canvas: Any = FigureCanvasAgg(self.figure)
        self._backdrop: Any = None

    @property
    def period(self) -> float:
        """Time between two recorded instants, in s."""
        return float(self._sides[0].loop.time[1])

    def show_postures(self) -> None:
        """Lay the postures of every second over each other, with the path of the tip."""
        every = round(1.0 / self.period)
        first, last = (round(instant / self.period) for instant in WINDOW)
        for view, side, bodies in zip(self._views, self._sides, self._bodies, strict=True):
            for body in bodies[first:last:every]:
                view.plot(*body.T, color=side.colour, linestyle="-", linewidth=2.2, alpha=0.22)
            tips = side.loop.tips[first:last, -1]
            view.plot(*tips.T, color=INK, linestyle="-", linewidth=0.7)

    def frame(self, index: int) -> NDArray[np.uint8]:
        """The picture at one recorded instant, (height, width, 3)."""
        instant = index * self.period
        self._cursor.set_xdata([instant, instant])
        first = round(WINDOW[0] / self.period)
        for side, bodies, (arrows, body, trail) in zip(
            self._sides, self._bodies, self._moving, strict=True
        ):
            arrows.set_UVC(*self._sea.velocity(arrows.X, arrows.Y, instant))
            body.set_data(*bodies[index].T)
            trail.set_data(*side.loop.tips[max(first, index - 30) : index + 1, -1].T)
        # Axes and labels are drawn once: that is nearly all of the work.
        if self._backdrop is None:
            self._canvas.draw()
            self._backdrop = self._canvas.copy_from_bbox(self.figure.bbox)
        self._canvas.restore_region(self._backdrop)
        for artist in self._artists():
            artist.set_visible(True)
            artist.axes.draw_artist(artist)
            artist.set_visible(False)
        return np.asarray(self._canvas.buffer_rgba())[..., :3].copy()

    def _artists(self) -> list[Any]:
        return [self._cursor, *(artist for moving in self._moving for artist in moving)]

    def _furnish(self, view: Axes, side: Side) -> None:
        view.set_aspect("equal")
        view.set(xlim=VIEW[:2], ylim=VIEW[2:], xlabel="x, m", ylabel="z, m", title=side.name)
        view.plot(*self._base, marker="s", color=INK, markersize=7)
        view.plot(*side.loop.target[-1], marker="x", color=INK, markersize=11, zorder=5)

    def _movable(self, view: Axes, side: Side) -> tuple[Quiver, Line2D, Line2D]:
        (body,) = view.plot(
            [], [], color=side.colour, linestyle="-", linewidth=7, solid_capstyle="round"
        )
        (trail,) = view.plot([], [], color=INK, linestyle="-", linewidth=0.9)
        x, z = np.meshgrid(np.linspace(-0.3, 1.0, 5), np.linspace(-4.5, -3.3, 5))
        still = np.zeros_like(x)
        arrows = view.quiver(
            x, z, still, still, color=GREY, scale=12, width=0.005, alpha=0.7, zorder=0
        )
        return arrows, body, trail


def _encode(frames: Iterator[NDArray[np.uint8]]) -> dict[str, bytes]:
    """Encode the frames once in each format."""
    with tempfile.TemporaryDirectory() as folder:
        paths = {suffix: Path(folder) / f"film.{suffix}" for suffix in ENCODERS}
        writers = {}
        for frame in frames:
            for suffix, path in paths.items():
                if suffix not in writers:
                    writers[suffix] = _writer(path, frame, *ENCODERS[suffix])
                writers[suffix].send(np.ascontiguousarray(frame))
        for writer in writers.values():
            writer.close()
        return {suffix: path.read_bytes() for suffix, path in paths.items()}


def _writer(
    path: Path, frame: NDArray[np.uint8], codec: str, options: Sequence[str]
) -> Generator[None, Any, None]:
    height, width, _ = frame.shape
    writer: Generator[None, Any, None] = imageio_ffmpeg.write_frames(
        str(path),
        (width, height),
        fps=FRAMES_PER_SECOND,
        codec=codec,
        output_params=[*options, *REPRODUCIBLE],
    )
    writer.send(None)
    return writer
