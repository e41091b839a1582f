"""The title picture: the same arm in the same sea under each controller, still and moving."""

from __future__ import annotations

import subprocess
import tempfile
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import imageio_ffmpeg
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from numpy.typing import NDArray

from softwave_min.arm import Arm
from softwave_min.figures.marks import look
from softwave_min.figures.style import BLUE, GREY, INK, Drawing
from softwave_min.simulation import ClosedLoop, root_mean_square_error
from softwave_min.waves import Sea

Floats = NDArray[np.float64]

WINDOW = (27.0, 49.0)
WIDTH, HEIGHT = 800, 496
"""In pixels."""
FRAMES_PER_SECOND = 20
VIEW = (-0.45, 1.15, -4.6, -3.2)
ENCODERS: Mapping[str, str] = {
    "webm": "-c:v libvpx-vp9 -b:v 0 -crf 40 -deadline realtime -cpu-used 8",
    "mp4": "-c:v libx264 -preset veryfast -crf 25 -movflags +faststart",
}
REPRODUCIBLE = "-pix_fmt yuv420p -threads 1 -fflags +bitexact -flags:v +bitexact"
"""One thread and no encoder's signature: the same frames give the same file."""


def headline(arm: Arm, sea: Sea, loops: Mapping[str, ClosedLoop]) -> Drawing:
    """Draw the still and encode the film of these controllers' loops."""
    still, film = _Stage(arm, sea, loops), _Stage(arm, sea, loops)
    shown = slice(still.first, still.last)
    # Of all instants at once, which costs hardly more than of one.
    bodies = [arm.axis(loop.q[shown]) for loop in loops.values()]
    still.show_postures(bodies)
    media = _encode(map(film.frame, range(film.first, film.last), zip(*bodies, strict=True)))
    plt.close(film.figure)
    names = " and ".join(look(name).label for name in loops)
    errors = ", ".join(
        f"{100 * root_mean_square_error(loop.error[shown]):.1f} cm ({look(name).label})"
        for name, loop in loops.items()
    )
    return Drawing(
        still.figure,
        caption=(
            "The same arm in the same sea, its tip to be held at the cross, from left to right by "
            f"{names}. The NMPC previews the waves. Above, the elevation over the base. Over the "
            f"{len(bodies[0])} control periods shown the tip is off (root mean square) by {errors}."
        ),
        alt=(
            f"{len(loops)} side views of the arm under waves, postures laid over each other, with "
            f"the path of the tip about the target's cross. Off by: {errors}."
        ),
        media=media,
    )


class _Stage:
    """The axes of the picture, and how the arms are put on them."""

    def __init__(self, arm: Arm, sea: Sea, loops: Mapping[str, ClosedLoop]) -> None:
        self._sea, self._loops = sea, list(loops.values())
        self._faces = [look(name).face for name in loops]
        self.period = float(self._loops[0].time[1])
        self.first, self.last = (round(instant / self.period) for instant in WINDOW)
        self.figure = plt.figure(figsize=(WIDTH / 100, HEIGHT / 100), dpi=100)
        grid = self.figure.add_gridspec(2, len(loops), height_ratios=(1.0, 3.2))
        wave = self.figure.add_subplot(grid[0, :])
        self._views = [self.figure.add_subplot(grid[1, column]) for column in range(len(loops))]
        times = np.linspace(*WINDOW, 600)
        wave.plot(times, sea.elevation(0.0, times), color=BLUE, linestyle="-")
        wave.set(xlim=WINDOW, xlabel="time, s", ylabel="elevation, m")
        for view, (name, loop) in zip(self._views, loops.items(), strict=True):
            view.set_aspect("equal")
            view.set(xlim=VIEW[:2], ylim=VIEW[2:], xlabel="x, m", ylabel="z, m")
            view.set_title(look(name).label)
            view.plot(*arm.parameters.base_position, marker="s", color=INK, markersize=7)
            view.plot(*loop.target[-1], marker="x", color=INK, markersize=11, zorder=5)
        self._moving = [_movable(*pair) for pair in zip(self._views, self._faces, strict=True)]
        self._cursor = wave.axvline(WINDOW[0], color=INK, linewidth=1.0, linestyle="-")
        self._artists = [self._cursor, *(artist for moving in self._moving for artist in moving)]
        for artist in self._artists:
            artist.set_visible(False)
        self._canvas: Any = FigureCanvasAgg(self.figure)
        self._backdrop: Any = None

    def show_postures(self, bodies: list[Floats]) -> None:
        """Lay the postures of every second over each other, with the path of the tip."""
        for view, face, loop, every in zip(
            self._views, self._faces, self._loops, bodies, strict=True
        ):
            for body in every[:: round(1.0 / self.period)]:
                view.plot(*body.T, color=face, linestyle="-", linewidth=2.2, alpha=0.22)
            tips = loop.tips[self.first : self.last, -1]
            view.plot(*tips.T, color=INK, linestyle="-", linewidth=0.7)

    def frame(self, index: int, bodies: tuple[Floats, ...]) -> NDArray[np.uint8]:
        """The picture at one recorded instant, (height, width, 4), until the next is asked for."""
        instant = index * self.period
        self._cursor.set_xdata([instant, instant])
        past = slice(max(self.first, index - 30), index + 1)
        flow = self._sea.velocity(self._moving[0][0].X, self._moving[0][0].Y, instant)
        for loop, posture, (arrows, body, trail) in zip(
            self._loops, bodies, self._moving, strict=True
        ):
            arrows.set_UVC(*flow)
            body.set_data(*posture.T)
            trail.set_data(*loop.tips[past, -1].T)
        # Axes and labels are drawn once: that is nearly all of the work.
        if self._backdrop is None:
            self._canvas.draw()
            self._backdrop = self._canvas.copy_from_bbox(self.figure.bbox)
        self._canvas.restore_region(self._backdrop)
        for artist in self._artists:
            artist.set_visible(True)
            artist.axes.draw_artist(artist)
            artist.set_visible(False)
        return np.asarray(self._canvas.buffer_rgba())


def _movable(view: Axes, face: str) -> tuple[Any, Any, Any]:
    """Arrows of the flow, the arm's body and the trail of its tip, none with data as yet."""
    (body,) = view.plot([], [], color=face, linestyle="-", linewidth=7, solid_capstyle="round")
    (trail,) = view.plot([], [], color=INK, linestyle="-", linewidth=0.9)
    x, z = np.meshgrid(np.linspace(-0.3, 1.0, 5), np.linspace(-4.5, -3.3, 5))
    still = np.zeros_like(x)
    arrows = view.quiver(x, z, still, still, color=GREY, scale=12, width=0.005, alpha=0.7, zorder=0)
    return arrows, body, trail


def _encode(frames: Iterable[NDArray[np.uint8]]) -> dict[str, bytes]:
    """Encode the frames once in each format.

    Raises
    ------
    OSError
        If the encoder fails.
    """
    source = f"-v error -f rawvideo -pix_fmt rgba -s {WIDTH}x{HEIGHT} -r {FRAMES_PER_SECOND} -i -"
    command = [imageio_ffmpeg.get_ffmpeg_exe(), *source.split()]
    with tempfile.TemporaryDirectory() as folder:
        paths = {suffix: Path(folder) / f"film.{suffix}" for suffix in ENCODERS}
        for suffix, path in paths.items():
            command += [*f"{ENCODERS[suffix]} {REPRODUCIBLE}".split(), str(path)]
        with subprocess.Popen(command, stdin=subprocess.PIPE) as encoder:
            assert encoder.stdin is not None
            for frame in frames:
                encoder.stdin.write(frame.data)
        if encoder.returncode:
            raise OSError(f"{command[0]}: exit status {encoder.returncode}")
        return {suffix: path.read_bytes() for suffix, path in paths.items()}
