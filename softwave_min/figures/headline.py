"""The title picture: the same arm in the same sea under each controller, still and moving."""

from __future__ import annotations

import itertools
import subprocess
import tempfile
from collections.abc import Iterable, Mapping
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
from softwave_min.figures.marks import Look, look
from softwave_min.figures.style import BLUE, GREY, INK, Drawing
from softwave_min.simulation import ClosedLoop, root_mean_square_error
from softwave_min.waves import Sea

Floats = NDArray[np.float64]

WINDOW = (27.0, 49.0)
FRAMES_PER_SECOND = 20
VIEW = (-0.45, 1.15, -4.6, -3.2)
ENCODERS: Mapping[str, str] = {
    "webm": "-c:v libvpx-vp9 -b:v 0 -crf 40 -deadline realtime -cpu-used 8",
    "mp4": "-c:v libx264 -preset veryfast -crf 25 -movflags +faststart",
}
REPRODUCIBLE = "-pix_fmt yuv420p -threads 1 -fflags +bitexact -flags:v +bitexact"
"""One thread and no encoder's signature: the same frames give the same file."""


@dataclass(frozen=True)
class Side:
    """What the picture shows of one controller."""

    controller: str
    loop: ClosedLoop

    @property
    def look(self) -> Look:
        """How the controller is drawn and called."""
        return look(self.controller)

    @property
    def period(self) -> float:
        """Time between two recorded instants, in s."""
        return float(self.loop.time[1])


def headline(arm: Arm, sea: Sea, sides: tuple[Side, ...]) -> Drawing:
    """Draw the still and encode the film."""
    first, last = (round(instant / sides[0].period) for instant in WINDOW)
    # Of all instants at once, which costs hardly more than of one.
    bodies = [arm.axis(side.loop.q[first:last]) for side in sides]
    still = _Stage(arm, sea, sides)
    still.show_postures(bodies, first)
    film = _Stage(arm, sea, sides)
    media = _encode(
        film.frame(first + step, pair) for step, pair in enumerate(zip(*bodies, strict=True))
    )
    plt.close(film.figure)
    names = " and ".join(side.look.label for side in sides)
    errors = ", ".join(
        f"{100 * root_mean_square_error(side.loop.error[first:last]):.1f} cm ({side.look.label})"
        for side in sides
    )
    return Drawing(
        still.figure,
        caption=(
            "The same arm in the same sea, its tip to be held at the cross, from left to right by "
            f"{names}. The NMPC previews the waves. Above, the elevation over the base. Over the "
            f"{last - first} control periods shown the tip is off (root mean square) by {errors}."
        ),
        alt=(
            f"{len(sides)} side views of the arm under waves, postures laid over each other, with "
            f"the path of the tip about the target's cross. Off by: {errors}."
        ),
        media=media,
    )


class _Stage:
    """The axes of the picture, and how the arms are put on them."""

    def __init__(self, arm: Arm, sea: Sea, sides: tuple[Side, ...]) -> None:
        self._base, self._sea, self._sides = arm.parameters.base_position, sea, sides
        self.figure: Figure = plt.figure(figsize=(8.0, 4.96), dpi=100)
        grid = self.figure.add_gridspec(2, len(sides), height_ratios=(1.0, 3.2))
        self._wave = self.figure.add_subplot(grid[0, :])
        self._views = [self.figure.add_subplot(grid[1, column]) for column in range(len(sides))]
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

    def show_postures(self, bodies: list[Floats], first: int) -> None:
        """Lay the postures of every second over each other, with the path of the tip."""
        for view, side, every in zip(self._views, self._sides, bodies, strict=True):
            for body in every[:: round(1.0 / side.period)]:
                view.plot(*body.T, color=side.look.face, linestyle="-", linewidth=2.2, alpha=0.22)
            tips = side.loop.tips[first : first + len(every), -1]
            view.plot(*tips.T, color=INK, linestyle="-", linewidth=0.7)

    def frame(self, index: int, bodies: tuple[Floats, ...]) -> NDArray[np.uint8]:
        """The picture at one recorded instant, (height, width, 4), until the next is asked for."""
        instant = index * self._sides[0].period
        self._cursor.set_xdata([instant, instant])
        first = round(WINDOW[0] / self._sides[0].period)
        arrows = self._moving[0][0]
        flow = self._sea.velocity(arrows.X, arrows.Y, instant)
        for side, posture, (arrows, body, trail) in zip(
            self._sides, bodies, self._moving, strict=True
        ):
            arrows.set_UVC(*flow)
            body.set_data(*posture.T)
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
        return np.asarray(self._canvas.buffer_rgba())

    def _artists(self) -> list[Any]:
        return [self._cursor, *(artist for moving in self._moving for artist in moving)]

    def _furnish(self, view: Axes, side: Side) -> None:
        view.set_aspect("equal")
        view.set(xlim=VIEW[:2], ylim=VIEW[2:], xlabel="x, m", ylabel="z, m", title=side.look.label)
        view.plot(*self._base, marker="s", color=INK, markersize=7)
        view.plot(*side.loop.target[-1], marker="x", color=INK, markersize=11, zorder=5)

    def _movable(self, view: Axes, side: Side) -> tuple[Quiver, Line2D, Line2D]:
        (body,) = view.plot(
            [], [], color=side.look.face, linestyle="-", linewidth=7, solid_capstyle="round"
        )
        (trail,) = view.plot([], [], color=INK, linestyle="-", linewidth=0.9)
        x, z = np.meshgrid(np.linspace(-0.3, 1.0, 5), np.linspace(-4.5, -3.3, 5))
        still = np.zeros_like(x)
        arrows = view.quiver(
            x, z, still, still, color=GREY, scale=12, width=0.005, alpha=0.7, zorder=0
        )
        return arrows, body, trail


def _encode(frames: Iterable[NDArray[np.uint8]]) -> dict[str, bytes]:
    """Encode the frames once in each format.

    Raises
    ------
    OSError
        If the encoder fails.
    """
    frames = iter(frames)
    first = next(frames)
    height, width, _ = first.shape
    command = [
        imageio_ffmpeg.get_ffmpeg_exe(),
        *["-v", "error", "-f", "rawvideo", "-pix_fmt", "rgba"],
        *f"-s {width}x{height} -r {FRAMES_PER_SECOND} -i -".split(),
    ]
    with tempfile.TemporaryDirectory() as folder:
        paths = {suffix: Path(folder) / f"film.{suffix}" for suffix in ENCODERS}
        for suffix, path in paths.items():
            command += [*f"{ENCODERS[suffix]} {REPRODUCIBLE}".split(), str(path)]
        with subprocess.Popen(command, stdin=subprocess.PIPE) as encoder:
            assert encoder.stdin is not None
            for frame in itertools.chain([first], frames):
                encoder.stdin.write(frame.data)
        if encoder.returncode:
            raise OSError(f"{command[0]}: exit status {encoder.returncode}")
        return {suffix: path.read_bytes() for suffix, path in paths.items()}
