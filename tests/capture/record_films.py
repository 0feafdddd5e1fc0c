"""Write the small films of data/films/ again; needs ffmpeg with libx265 and libvpx, which the project does without.

PYTHONPATH=tests python tests/capture/record_films.py
"""

import subprocess
from pathlib import Path

import cv2
import numpy as np

FOLDER = Path(__file__).parent / "data/films"
WIDTH, HEIGHT, FRAMES = 160, 120, 24
HEVC = ["-c:v", "libx265", "-crf", "22", "-tag:v", "hvc1", "-x265-params"]
VARYING = ["-vf", "setpts=(N+3*gt(N\\,11)*(N-11))/30/TB", "-vsync", "vfr", "-pix_fmt", "yuv420p"]
"""The second half of the frames is shown for four times as long as the first."""
WHITE_NITS = 203.0
"""Of diffuse white in HDR: ITU-R BT.2408, table 1."""
BT2020_FROM_BT709 = np.array([[0.6274, 0.3293, 0.0433], [0.0691, 0.9195, 0.0114], [0.0164, 0.0880, 0.8956]])
LUMINANCE = np.array([0.2627, 0.6780, 0.0593])


def draw_frames() -> list[np.ndarray]:
    """(24, 120, 160, 3) uint8 sRGB: a camera's way along a random picture."""
    coarse = np.random.default_rng(0).integers(0, 255, (12, 90, 3), dtype=np.uint8)
    whole = cv2.resize(coarse, (900, HEIGHT), interpolation=cv2.INTER_CUBIC)
    return [np.ascontiguousarray(whole[:, start : start + WIDTH]) for start in np.linspace(0, 700, FRAMES).astype(int)]


def to_nits(frame: np.ndarray) -> np.ndarray:
    """Light of a screen that shows an sRGB picture, in the primaries of BT.2020."""
    values = frame / 255.0
    return WHITE_NITS * np.where(values <= 0.04045, values / 12.92, ((values + 0.055) / 1.055) ** 2.4) @ BT2020_FROM_BT709.T


def encode_pq(nits: np.ndarray) -> np.ndarray:
    """ITU-R BT.2100, table 4."""
    power = (np.maximum(nits, 0.0) / 10_000.0) ** 0.1593017578125
    return ((0.8359375 + 18.8515625 * power) / (1.0 + 18.6875 * power)) ** 78.84375


def encode_hlg(nits: np.ndarray) -> np.ndarray:
    """ITU-R BT.2100, table 5, for a screen of 1000 nits."""
    screen = np.maximum(nits, 0.0) / 1000.0
    scene = screen * np.maximum(screen @ LUMINANCE, 1e-6)[..., None] ** (1.0 / 1.2 - 1.0)
    return np.where(scene <= 1 / 12, np.sqrt(3.0 * scene), 0.17883277 * np.log(np.maximum(12.0 * scene - 0.28466892, 1e-9)) + 0.55991073)


def write_film(name: str, frames: list[np.ndarray], *options: str) -> None:
    """Encode RGB frames of 8 or 16 bits."""
    pixels = "rgb24" if frames[0].dtype == np.uint8 else "rgb48le"
    command = ["ffmpeg", "-y", "-v", "error", "-f", "rawvideo", "-pix_fmt", pixels, "-s", f"{WIDTH}x{HEIGHT}", "-r", "30", "-i", "-"]
    subprocess.run([*command, *options, str(FOLDER / name)], input=b"".join(frame.tobytes() for frame in frames), check=True)


def write_hdr(name: str, frames: list[np.ndarray], transfer: str) -> None:
    """Encode values from 0 to 1 with ten bits, as colours of ITU-R BT.2100."""
    values = [np.rint(np.clip(frame, 0.0, 1.0) * 65535).astype(np.uint16) for frame in frames]
    colors = f"log-level=error:colorprim=bt2020:transfer={transfer}:colormatrix=bt2020nc"
    tags = ["-color_primaries", "bt2020", "-color_trc", transfer, "-colorspace", "bt2020nc"]
    write_film(name, values, "-vf", "scale=out_color_matrix=bt2020:out_range=tv,format=yuv420p10le", *HEVC, colors, *tags)


if __name__ == "__main__":
    FOLDER.mkdir(parents=True, exist_ok=True)
    drawn = draw_frames()
    write_film("hevc.mov", drawn, "-pix_fmt", "yuv420p", *HEVC, "log-level=error")
    write_film("varying.mp4", drawn, *VARYING, "-c:v", "libx264", "-crf", "34")
    write_film("varying.webm", drawn, *VARYING, "-c:v", "libvpx-vp9", "-crf", "45", "-b:v", "0")
    write_hdr("hdr_pq.mp4", [encode_pq(to_nits(frame)) for frame in drawn], "smpte2084")
    write_hdr("hdr_hlg.mkv", [encode_hlg(to_nits(frame)) for frame in drawn], "arib-std-b67")
