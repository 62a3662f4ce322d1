"""Videos, animated WebPs and GIFs by ffmpeg, from a stream of pictures that are not kept in memory."""

import contextlib
import subprocess
import tempfile
from collections.abc import Iterable, Iterator
from fractions import Fraction
from pathlib import Path
from typing import IO

from trajopt.errors import InputError, TrajoptError

INSTALL_EXTRA = "pip install imageio-ffmpeg"
# Constant quality of H.264: visually lossless.
QUALITY = 18
# H.264 that phones, browsers and slides play: 4:2:0, HD colours that are tagged as such, index first.
TO_YUV = (
    "scale=out_color_matrix=bt709:out_range=tv:flags=accurate_rnd+full_chroma_int,format=yuv420p,"
    "setparams=range=tv:colorspace=bt709:color_primaries=bt709:color_trc=bt709"
)
ENCODER = ["-c:v", "libx264", "-preset", "medium", "-crf", str(QUALITY), "-movflags", "+faststart"]
H264 = ["-vf", TO_YUV, *ENCODER]
REPEATED = ["-loop", "0"]
# WebP that is visually lossless, by the slowest search, which makes the smallest file.
SEARCH = ["-preset", "drawing", "-quality", "82", "-compression_level", "6"]
WEBP = ["-c:v", "libwebp_anim", *SEARCH, *REPEATED]
# Intermediate format of GIF pictures until the palette is known: small and lossless.
LOSSLESS = ["-c:v", "libx264rgb", "-preset", "ultrafast", "-qp", "0"]
# One palette for the whole motion, with one colour for unchanged pixels. Ordered dither does not flicker.
PALETTE = "palettegen=max_colors=255:stats_mode=full"
WITH_PALETTE = "[0][1]paletteuse=dither=bayer:bayer_scale=4:diff_mode=rectangle"


def find_ffmpeg() -> str:
    """Return the ffmpeg of imageio-ffmpeg; raises `InputError`, one line, if it is missing."""
    try:
        import imageio_ffmpeg
    except ImportError:
        raise InputError("videos need imageio-ffmpeg", INSTALL_EXTRA) from None
    try:
        return str(imageio_ffmpeg.get_ffmpeg_exe())
    except RuntimeError:
        raise InputError("imageio-ffmpeg finds no ffmpeg", "set IMAGEIO_FFMPEG_EXE to one") from None


def write_video(target: Path, ending: str, pictures: Iterable[bytes], fps: Fraction) -> None:
    """Write PNG ``pictures`` of one size, ``fps`` a second, to ``target`` as a .mp4, .webp or .gif.

    H.264 in a .mp4 needs an even size. The others repeat; times in a .gif are whole hundredths of a second.
    Raises `TrajoptError`, one line, if ffmpeg fails; ``target`` is then unusable.
    """
    if ending != ".gif":
        _encode(pictures, fps, [*(H264 if ending == ".mp4" else WEBP), str(target)])
        return
    with tempfile.TemporaryDirectory(prefix="trajopt-") as folder:
        kept, palette = str(Path(folder, "kept.mkv")), str(Path(folder, "palette.png"))
        _encode(pictures, fps, [*LOSSLESS, kept])
        with _started(["-i", kept, "-vf", PALETTE, "-update", "1", palette]):
            pass
        with _started(["-i", kept, "-i", palette, "-lavfi", WITH_PALETTE, *REPEATED, str(target)]):
            pass


def _encode(pictures: Iterable[bytes], fps: Fraction, output: list[str]) -> None:
    rate = f"{fps.numerator}/{fps.denominator}"
    with _started(["-f", "image2pipe", "-framerate", rate, "-c:v", "png", "-i", "-", *output]) as pipe:
        for picture in pictures:
            pipe.write(picture)


@contextlib.contextmanager
def _started(arguments: list[str]) -> Iterator[IO[bytes]]:
    """Run ffmpeg, fed through a pipe, to its end; an error of the feeder also ends it."""
    command = [find_ffmpeg(), "-y", "-loglevel", "error", *arguments]
    with tempfile.TemporaryFile() as said:
        # A separate session: Ctrl-C is handled here.
        process = subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=subprocess.DEVNULL, stderr=said, start_new_session=True
        )
        assert process.stdin is not None
        try:
            with contextlib.suppress(BrokenPipeError):  # it has failed, with a message
                try:
                    yield process.stdin
                finally:
                    process.stdin.close()
            status = process.wait()
        except BaseException:
            process.kill()
            process.wait()
            raise
        said.seek(0)
        lines = said.read().decode(errors="replace").strip().splitlines()
    if status:
        raise TrajoptError(f"ffmpeg cannot write the file: {lines[-1] if lines else f'status {status}'}")
