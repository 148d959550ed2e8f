"""Frames as files: PNG, NumPy and OpenEXR images, MP4 and GIF films, written by background threads.

Image values are display-referred: a PNG stores the values of the frame, clamped and rounded to bytes.
"""

import io
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from typing import Any, Literal, Self

import numpy as np
from numpy.typing import NDArray

from msb.base.atomic import new_file
from msb.base.extras import need_extra
from msb.errors import UsageError
from msb.scenes import Camera

ImageFormat = Literal["png", "npy", "exr"]
FILM_SUFFIXES = (".mp4", ".gif")
# Maximum number of frames that wait for a file writer. Four frames hide the delays of a slow disk. More
# frames would take more memory.
_QUEUE = 4


def to_bytes(image: NDArray[Any]) -> NDArray[np.uint8]:
    """Return floor(255 clamp(v, 0, 1) + 0.5), the rounding of the official 3DGS evaluations.

    NaN, which a correct renderer never returns, becomes 0.
    """
    # Convert explicitly, because NumPy 1 keeps float16 in products with a float32 scalar.
    wide = image.astype(np.result_type(image.dtype, np.float32), copy=False)
    scaled = np.fmin(np.fmax(wide, 0), 1) * np.float32(255)  # fmax(NaN, 0) is 0
    return np.asarray(scaled + np.float32(0.5)).astype(np.uint8)


def write_image(path: Path, array: NDArray[Any], form: ImageFormat, *, overwrite: bool = True) -> None:
    """Write an image, depth or face-id plane to `path`; a failure leaves no partial file.

    A PNG stores colours with 8 bits per channel and rejects depth and id planes, which need more precision.
    An EXR stores 32-bit floats.
    """
    check_format(form)
    with new_file(path, overwrite=overwrite) as file:
        if form == "npy":
            # The bytes go through memory, because NumPy's own file output does not report why a write
            # failed (for example, a full disk).
            data = io.BytesIO()
            np.save(data, array, allow_pickle=False)
            file.write(data.getbuffer())
        elif form == "png":
            _write_png(file, array)
        else:
            file.write(_encode_exr(array))


def check_format(form: str) -> None:
    """Raise an error if the package that writes `form` is not installed. Call this check before rendering."""
    if form == "exr":
        need_extra("bench", "OpenEXR", what="an EXR image", instead="--format npy is equally exact")


def _write_png(file: Any, array: NDArray[Any]) -> None:
    from PIL import Image

    if array.ndim != 3:
        raise UsageError("USAGE", "a PNG stores colours only; write depth and face ids as npy or exr")
    # Compression level 1 takes a third of the time of the default level, and makes files a few percent
    # larger. At level 1, writing files does not delay the renderer.
    Image.fromarray(to_bytes(array)).save(file, format="PNG", compress_level=1)


def _encode_exr(array: NDArray[Any]) -> bytes:
    """Return `array` as an OpenEXR file with the channels RGB, Z (a depth plane) or "id" (integers)."""
    import tempfile

    import OpenEXR

    if array.dtype.kind in "iu":
        channels = {"id": array.astype(np.uint32)}
    elif array.ndim == 2:
        channels = {"Z": np.ascontiguousarray(array, np.float32)}
    else:
        channels = {"RGB": np.ascontiguousarray(array, np.float32)}
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    with tempfile.TemporaryDirectory() as folder:  # the OpenEXR library writes to file names only
        name = str(Path(folder) / "image.exr")
        try:
            with OpenEXR.File(header, channels) as file:
                file.write(name)
        except RuntimeError as error:  # OpenEXR raises no other error, even for a full disk
            raise OSError(str(error)) from error
        return Path(name).read_bytes()


class Writers:
    """Write files in background threads while the next frame is rendered.

    `submit` waits while too many tasks are queued. The first error is raised by the next call of `submit`, or
    at the end of the ``with`` block.
    """

    def __init__(self, threads: int = 2) -> None:
        self._pool = ThreadPoolExecutor(threads, thread_name_prefix="write")
        self._waiting: list[Future[None]] = []

    def submit(self, task: Callable[..., None], *arguments: Any, **named: Any) -> None:
        """Queue ``task(*arguments, **named)``. If an earlier writing task failed, raise its error."""
        while len(self._waiting) >= _QUEUE:
            self._waiting.pop(0).result()
        self._waiting.append(self._pool.submit(task, *arguments, **named))

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: object, *_: object) -> None:
        self._pool.shutdown(wait=True, cancel_futures=kind is not None)
        if kind is None:
            for future in self._waiting:
                future.result()


def write_film(path: Path, frames: Iterable[NDArray[Any]], fps: int, *, overwrite: bool = True) -> None:
    """Write `frames`, (H, W, 3) float images of one size, as a film; the suffix decides the format.

    MP4 uses H.264 with 4:2:0 subsampling, which every player supports; odd sizes lose their last row or
    column. A GIF has 256 colours per frame.
    """
    check_film(path)
    with new_file(path, overwrite=overwrite) as file:
        (_write_mp4 if path.suffix.lower() == ".mp4" else _write_gif)(file, frames, fps)


def check_film(path: Path) -> None:
    """Raise an error if this machine cannot write films with this suffix. Call this check before
    rendering."""
    if path.suffix.lower() not in FILM_SUFFIXES:
        wanted = " or ".join(FILM_SUFFIXES)
        raise UsageError("USAGE", f'the film is called "{path.name}"; its name must end in {wanted}')
    if path.suffix.lower() == ".mp4":
        need_extra("video", "av", what="an MP4 film", instead="a GIF needs no package")


def read_film(path: Path) -> Iterator[NDArray[np.uint8]]:
    """Yield the frames of an MP4 film, (H, W, 3) uint8."""
    import av

    with av.open(str(path)) as film:
        for frame in film.decode(video=0):
            yield np.asarray(frame.to_ndarray(format="rgb24"), np.uint8)


def _write_mp4(file: Any, frames: Iterable[NDArray[Any]], fps: int) -> None:
    import av

    try:
        _encode_mp4(file, frames, fps)
    except av.FFmpegError as error:
        if isinstance(error.__context__, OSError):  # the operating system could not write the file
            raise error.__context__ from error
        raise


def _encode_mp4(file: Any, frames: Iterable[NDArray[Any]], fps: int) -> None:
    import av

    with av.open(file, "w", format="mp4") as film:
        stream: Any = None
        for image in frames:
            pixels = to_bytes(image)
            pixels = np.ascontiguousarray(pixels[: len(pixels) // 2 * 2, : pixels.shape[1] // 2 * 2])
            if not pixels.size:
                text = "an MP4 film needs images of at least 2 x 2 pixels; use a GIF for smaller images"
                raise UsageError("USAGE", text)
            if stream is None:
                stream = film.add_stream("libx264", rate=fps, options={"crf": "16", "preset": "medium"})
                stream.height, stream.width = pixels.shape[:2]
                stream.pix_fmt = "yuv420p"
            for packet in stream.encode(av.VideoFrame.from_ndarray(pixels, format="rgb24")):
                film.mux(packet)
        if stream is not None:
            for packet in stream.encode():
                film.mux(packet)


def _write_gif(file: Any, frames: Iterable[NDArray[Any]], fps: int) -> None:
    from PIL import Image

    images = (Image.fromarray(to_bytes(image)).quantize(256) for image in frames)
    first = next(images, None)
    if first is not None:
        rest = {"save_all": True, "append_images": images, "loop": 0, "duration": round(1000 / fps)}
        first.save(file, format="GIF", **rest)


def image_names(views: Sequence[Camera]) -> list[str]:
    """Return a unique file name for each view, normally the name of its camera.

    The suffix of a name is removed unless two names would then be equal. If two names are still equal, each
    name gets the index of its view.
    """
    whole = [view.name or f"{index:05d}" for index, view in enumerate(views)]
    short = [_without_suffix(name) for name in whole]
    of_whole, of_short = Counter(whole), Counter(short)
    names = [
        brief if of_short[brief] == 1 else name if of_whole[name] == 1 else f"{brief}_{index:05d}"
        for index, (name, brief) in enumerate(zip(whole, short, strict=True))
    ]
    while len(counts := Counter(names)) < len(names):
        names = [name if counts[name] == 1 else f"{name}_{index:05d}" for index, name in enumerate(names)]
    return names


def _without_suffix(name: str) -> str:
    folder, slash, last = name.rpartition("/")
    stem, dot, _ = last.rpartition(".")
    return f"{folder}{slash}{stem if dot and stem else last}"
