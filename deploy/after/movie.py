"""`murmur movie`: film a run step by step, or two runs side by side."""

from __future__ import annotations

import contextlib
import errno
import os
import shlex
import subprocess
import tempfile
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import numpy as np
from PIL import Image

from deploy.after.archive import read
from deploy.after.frames import WIDTH, Frames, side_by_side
from protocol.packages import require
from protocol.temporary import temporary_folder
from worldsim.atomic_files import naming

SMALL = 0.75
"""Width of each run's picture / `frames.WIDTH`, for two runs side by side or a GIF."""
HOLD_S = 2.0
"""Seconds for which the last picture stays."""
MOST_GIF_FRAMES = 400
"""Longer GIFs leave out steps: they would be large, and many programs load them whole."""


class MovieError(ValueError):
    """The arguments do not fit a film, or ffmpeg fails."""


MP4, GIF = ".mp4", ".gif"
"""The formats of films, by their suffix."""

AS_MP4 = shlex.split("-c:v libx264 -preset veryfast -crf 20 -pix_fmt yuv420p -movflags +faststart")
AS_GIF = shlex.split("-lavfi paletteuse=dither=none:diff_mode=rectangle -loop 0")
"""Output options of ffmpeg; for a GIF they follow a picture of its palette."""


def write_movie(
    directories: Sequence[Path],
    suffix: str,
    out: Path | None = None,
    *,
    rate: float = 10.0,
    progress: Callable[[int, int], object] = lambda _, __: None,
) -> Path:
    """Film runs side by side, from left to right, at `rate` steps per second; return the file.

    `suffix` is `MP4` or `GIF`. By default, `out` is ``movie.mp4`` in the first directory, with the names of the other
    directories. `progress` is called with the number of frames written, and that of all frames.

    Raises MissingPackageError if the package that writes films is not installed; MovieError if an argument is wrong, or
    ffmpeg fails; OSError if the disk is full; ScenarioError if a directory is not a run directory.
    """
    _check(suffix, out, rate)
    path = out or directories[0] / "-".join(["movie", *(each.resolve().name for each in directories[1:])])
    path = path if path.suffix == suffix else path.with_name(path.name + suffix)
    archives = [read(each) for each in directories]
    width = round((SMALL if len(archives) > 1 or suffix == GIF else 1.0) * WIDTH)
    runs = [Frames(archive, width) for archive in archives]
    last = max(run.last_step for run in runs)
    every = 1 if suffix == MP4 else -(-last // MOST_GIF_FRAMES)
    steps = sorted({*range(1, last + 1, every), last})
    hold = round(HOLD_S * rate / every)

    def pictures() -> Iterator[Image.Image]:
        for number, step in enumerate(steps, 1):
            yield side_by_side(runs, step)
            progress(number, len(steps))
        closing = side_by_side(runs, last)
        for _ in range(hold):
            yield closing

    first = side_by_side(runs, 1)
    with temporary_folder() as folder:
        options = AS_MP4
        if suffix == GIF:
            palette = folder / "palette.png"
            _common_palette(runs, last).save(palette)
            options = ["-i", str(palette), *AS_GIF]
        _encode(path, pictures(), first.size, rate / every, options)
    return path


def _check(suffix: str, out: Path | None, rate: float) -> None:
    """Raise MovieError if no film can be made of these arguments, MissingPackageError without a package."""
    require("imageio_ffmpeg", "film", "films need")
    if not 0.1 <= rate <= 120:
        raise MovieError(f"rate = {rate:g}: must be 0.1 to 120 steps per second")
    if out is not None and out.suffix not in ("", suffix):
        raise MovieError(f"out = {out}: must end in {suffix}; --mp4 and --gif choose the format")
    if out is not None and not out.parent.is_dir():
        raise MovieError(f"out = {out}: no such folder: {out.parent}")


def _encode(
    path: Path, pictures: Iterator[Image.Image], size: tuple[int, int], rate: float, options: list[str]
) -> None:
    """Write pictures as a film, under a temporary name until it is complete."""
    from imageio_ffmpeg import get_ffmpeg_exe  # noqa: PLC0415  the package may be missing

    beside = path.with_name(f".{path.stem}.part{path.suffix}")
    with naming(path):
        beside.touch()  # raises OSError if the folder is not writable
    source = shlex.split(f"-f rawvideo -pix_fmt rgb24 -s {size[0]}x{size[1]} -r {rate:g} -i -")
    command = [get_ffmpeg_exe(), "-y", "-v", "error", *source, *options, str(beside)]
    try:
        with tempfile.TemporaryFile() as output:
            process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=output, stderr=output)
            try:
                assert process.stdin is not None
                with contextlib.suppress(BrokenPipeError), process.stdin:
                    for picture in pictures:
                        process.stdin.write(picture.tobytes())
                failed = process.wait() != 0
            finally:
                process.kill()
                process.wait()
            if failed:
                output.seek(0)
                lines = output.read().decode(errors="replace").strip().splitlines() or ["no output"]
                full = os.strerror(errno.ENOSPC)
                if any(line.endswith(full) for line in lines):
                    raise OSError(errno.ENOSPC, full, str(path))
                raise MovieError(f"{path}: ffmpeg failed: {lines[-1]}")
        beside.replace(path)
    finally:
        beside.unlink(missing_ok=True)


def _common_palette(runs: list[Frames], last: int) -> Image.Image:
    """The palette of a GIF, from four of its pictures, as 16 x 16 pixels."""
    shown = [side_by_side(runs, max(1, round(last * part / 3))) for part in range(4)]
    together = Image.new("RGB", (shown[0].width, 4 * shown[0].height))
    for number, picture in enumerate(shown):
        together.paste(picture, (0, number * picture.height))
    colors = together.quantize(256, Image.Quantize.FASTOCTREE).getpalette() or []
    palette = np.zeros((256, 3), np.uint8)
    palette[: len(colors) // 3] = np.array(colors, np.uint8).reshape(-1, 3)
    return Image.fromarray(palette.reshape(16, 16, 3))
