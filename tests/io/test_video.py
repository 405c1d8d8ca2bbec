import mmap
import struct
from fractions import Fraction
from pathlib import Path

import av
import h5py
import numpy as np
import pytest
from PIL import Image

from kinebench_drake.errors import InputError, UnmeasurableError
from kinebench_drake.io import frames as module
from kinebench_drake.io.container import write_video
from kinebench_drake.io.frames import map_frames
from kinebench_drake.io.images import read_image, side_files
from kinebench_drake.io.npz import open_npz
from kinebench_drake.io.reader import read_video
from kinebench_drake.io.video import Video
from tests.films import encode

T = 20
H = 96
W = 130


@pytest.fixture(scope="module")
def frames():
    """A red square that moves over a gradient."""
    images = np.zeros((T, H, W, 3), dtype=np.uint8)
    images[..., 1] = np.linspace(40, 120, W).astype(np.uint8)
    for k, image in enumerate(images):
        image[10 + k : 50 + k, 20 + 2 * k : 60 + 2 * k] = [200, 30, 60]
    return images


QUARTERS = np.zeros((H, W, 3), dtype=np.uint8)
QUARTERS[: H // 2, : W // 2], QUARTERS[: H // 2, W // 2 :], QUARTERS[H // 2 :, : W // 2] = np.eye(3) * 255


def with_display_matrix(path, a, b, c, d):
    """Write a video whose file says that pixel (x, y) is shown at (a x + c y, b x + d y)."""
    write_video(path, [QUARTERS] * 2, 17)
    data = bytearray(path.read_bytes())
    at = data.index(b"tkhd") + 44
    identity = struct.pack(">9i", 1 << 16, 0, 0, 0, 1 << 16, 0, 0, 0, 1 << 30)
    assert data[at : at + 36] == identity
    data[at : at + 36] = struct.pack(">9i", a << 16, b << 16, 0, c << 16, d << 16, 0, 0, 0, 1 << 30)
    path.write_bytes(data)


@pytest.mark.parametrize(
    ("matrix", "shown"),
    [
        ((1, 0, 0, 1), lambda image: image),
        ((-1, 0, 0, 1), lambda image: image[:, ::-1]),
        ((1, 0, 0, -1), lambda image: image[::-1]),
        ((-1, 0, 0, -1), lambda image: image[::-1, ::-1]),
        ((0, 1, -1, 0), lambda image: np.rot90(image, -1)),
        ((0, -1, 1, 0), lambda image: np.rot90(image, 1)),
        ((0, 1, 1, 0), lambda image: image.transpose(1, 0, 2)),
        ((0, -1, -1, 0), lambda image: image.transpose(1, 0, 2)[::-1, ::-1]),
    ],
)
def test_a_display_matrix_turns_and_mirrors_the_picture_as_players_do(tmp_path, matrix, shown):
    with_display_matrix(tmp_path / "a.mp4", *matrix)
    frame = read_video(tmp_path / "a.mp4").frames[0]
    expected = shown(QUARTERS)
    assert frame.shape == expected.shape
    assert np.abs(frame.astype(int) - expected).mean() < 6.0


def squeezed(path, frames, aspect):
    with av.open(path, "w") as container:
        stream = container.add_stream("libx264", rate=17)
        stream.height, stream.width = frames.shape[1:3]
        stream.pix_fmt = "yuv420p"
        stream.codec_context.sample_aspect_ratio = aspect
        for image in frames:
            container.mux(stream.encode(av.VideoFrame.from_ndarray(image, format="rgb24")))
        container.mux(stream.encode())


@pytest.mark.parametrize(("aspect", "width"), [(Fraction(4, 3), 173), (Fraction(1, 2), 65), (Fraction(1216, 1215), W)])
def test_non_square_pixels_are_resampled_to_square_ones(tmp_path, frames, aspect, width):
    squeezed(tmp_path / "a.mp4", frames, aspect)
    assert read_video(tmp_path / "a.mp4").frames.shape == (T, H, width, 3)


def test_pixels_far_from_square_are_refused(tmp_path, frames):
    squeezed(tmp_path / "a.mp4", frames, Fraction(10))
    with pytest.raises(InputError, match=r"a\.mp4: its pixels are 10 times as wide as high, expected 0\.25 to 4"):
        read_video(tmp_path / "a.mp4")


@pytest.mark.parametrize(
    ("name", "codec", "pixel_format", "tolerance"),
    [
        ("a.mp4", "libx264", "yuv420p", 2.0),
        ("a.mov", "libx264", "yuv420p", 2.0),
        ("a.avi", "mpeg4", "yuv420p", 4.0),
        ("a.webm", "libvpx-vp9", "yuv420p", 2.0),
        ("a.mkv", "libx264", "yuv420p", 2.0),
        ("a.gif", "gif", "rgb8", 20.0),
    ],
)
def test_every_container_gives_back_its_frames(tmp_path, frames, name, codec, pixel_format, tolerance):
    encode(tmp_path / name, frames, codec, pixel_format)
    video = read_video(tmp_path / name)
    assert video.frames.shape == frames.shape
    assert np.abs(video.frames.astype(int) - frames).mean() < tolerance
    if video.stamps_s is None:
        assert video.fps == pytest.approx(17.0)
    else:  # a gif counts hundredths of a second
        assert video.stamps_s == pytest.approx(np.arange(T) / 17.0, abs=0.03)


def test_a_written_video_reads_back_and_equal_frames_have_equal_bytes(tmp_path, frames):
    write_video(tmp_path / "a.mp4", frames, 12.5)
    write_video(tmp_path / "b.mp4", iter(frames), 12.5)
    assert (tmp_path / "a.mp4").read_bytes() == (tmp_path / "b.mp4").read_bytes()
    video = read_video(tmp_path / "a.mp4")
    assert video.fps == pytest.approx(12.5)
    assert np.abs(video.frames.astype(int) - frames).mean() < 1.5
    assert sorted(p.name for p in tmp_path.iterdir()) == ["a.mp4", "b.mp4"]


def test_odd_sizes_are_padded_by_one_pixel(tmp_path, frames):
    write_video(tmp_path / "a.mp4", frames[:, :95, :129], 17)
    assert read_video(tmp_path / "a.mp4").frames.shape[1:3] == (96, 130)


def test_a_failed_write_leaves_no_file(tmp_path, frames):
    def broken():
        yield frames[0]
        raise RuntimeError("no more")

    with pytest.raises(RuntimeError):
        write_video(tmp_path / "a.mp4", broken(), 17)
    assert list(tmp_path.iterdir()) == []


def test_videos_with_variable_frame_rate_keep_their_time_stamps(tmp_path, frames):
    stamps = [0, 50, 100, 400, 450, 500, 900, 950, 1000, 1050]
    encode(tmp_path / "a.mkv", frames[:10], "libx264", "yuv420p", stamps=stamps)
    video = read_video(tmp_path / "a.mkv")
    assert video.stamps_s == pytest.approx(np.array(stamps) / 1000.0, abs=2e-3)


def test_frame_folders_are_sorted_by_number(tmp_path, frames):
    for k in range(11):
        Image.fromarray(frames[k]).save(tmp_path / f"frame_{k}.png")
    (tmp_path / "notes.txt").write_text("not a frame")
    video = read_video(tmp_path)
    assert (video.frames == frames[:11]).all()
    assert video.fps is None


@pytest.mark.parametrize("name", ["frame_{}_depth.png", "d{}.png"])
def test_depth_pictures_beside_the_frames_are_no_frames(tmp_path, frames, name):
    for k in range(4):
        Image.fromarray(frames[k]).save(tmp_path / f"frame_{k}.png")
        Image.fromarray(np.full((H, W), 700, np.uint16)).save(tmp_path / name.format(k))
    assert (read_video(tmp_path).frames == frames[:4]).all()
    assert len(side_files(tmp_path)) == 4


def test_a_folder_of_16_bit_pictures_alone_is_a_video(tmp_path):
    for k in range(3):
        Image.fromarray(np.full((H, W), 700, np.uint16)).save(tmp_path / f"depth_{k}.png")
    assert len(read_video(tmp_path).frames) == 3
    assert not side_files(tmp_path)


def test_of_a_file_with_a_cover_picture_the_film_is_read(tmp_path, frames):
    with av.open(tmp_path / "a.mkv", "w") as container:
        cover = container.add_stream("mjpeg", rate=17)
        film = container.add_stream("libx264", rate=17)
        for stream, pixel_format in ((cover, "yuvj420p"), (film, "yuv420p")):
            stream.height, stream.width = frames.shape[1:3]
            stream.pix_fmt = pixel_format
        container.mux(cover.encode(av.VideoFrame.from_ndarray(frames[0], format="rgb24")))
        for image in frames:
            container.mux(film.encode(av.VideoFrame.from_ndarray(image, format="rgb24")))
        container.mux(cover.encode())
        container.mux(film.encode())
    video = read_video(tmp_path / "a.mkv")
    assert np.abs(video.frames.astype(int) - frames).mean() < 2.0


@pytest.mark.parametrize(("delays_ms", "fps"), [(100, 10.0), (0, None), ([100, 0, 100, 100], None)])
def test_a_gif_with_delays_of_zero_has_no_clock(tmp_path, frames, delays_ms, fps):
    first, *others = (Image.fromarray(image) for image in frames[:4])
    first.save(tmp_path / "a.gif", save_all=True, append_images=others, duration=delays_ms)
    video = read_video(tmp_path / "a.gif")
    assert (len(video.frames), video.fps, video.stamps_s) == (4, fps, None)


@pytest.mark.parametrize("key", ["frames", "video", "anything"])
def test_arrays_of_npy_and_npz_files_are_read_unchanged(tmp_path, frames, key):
    np.save(tmp_path / "a.npy", frames)
    np.savez(tmp_path / "b.npz", **{key: frames})
    assert (read_video(tmp_path / "a.npy").frames == frames).all()
    assert (read_video(tmp_path / "b.npz").frames == frames).all()


@pytest.mark.parametrize("part", [0.3, 0.6, 0.9])
@pytest.mark.parametrize(
    ("name", "codec", "pixel_format", "options"),
    [
        ("a.mp4", "libx264", "yuv420p", {}),
        ("a.mp4", "libx264", "yuv420p", {"movflags": "faststart"}),
        ("a.avi", "mpeg4", "yuv420p", {}),
        ("a.mkv", "libx264", "yuv420p", {}),
        ("a.gif", "gif", "rgb8", {}),
    ],
)
def test_truncated_videos_are_refused(tmp_path, frames, name, codec, pixel_format, options, part):
    path = tmp_path / name
    encode(path, frames, codec, pixel_format, options=options)
    data = path.read_bytes()
    path.write_bytes(data[: int(len(data) * part)])
    with pytest.raises(InputError, match=rf"^{name}: ") as caught:
        read_video(path)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(("written", "named"), [("a.mp4", "b.gif"), ("a.gif", "b.mp4")])
def test_the_container_is_detected_by_content_and_not_by_file_name(tmp_path, frames, written, named):
    codec, pixel_format = ("gif", "rgb8") if written.endswith("gif") else ("libx264", "yuv420p")
    encode(tmp_path / written, frames, codec, pixel_format, options={})
    data = (tmp_path / written).read_bytes()
    (tmp_path / named).write_bytes(data)
    assert len(read_video(tmp_path / named).frames) == len(frames)
    (tmp_path / named).write_bytes(data[: int(len(data) * 0.8)])
    with pytest.raises(InputError, match=rf"^{named}: "):
        read_video(tmp_path / named)


def test_a_stream_of_an_unknown_codec_is_refused_by_name(tmp_path, frames):
    path = tmp_path / "a.mp4"
    write_video(path, frames, 10)
    path.write_bytes(path.read_bytes().replace(b"avc1", b"zzzz"))
    with pytest.raises(InputError, match=r"^a\.mp4: holds no video stream of a known codec$"):
        read_video(path)


def test_files_that_are_no_video_are_refused_by_name(tmp_path, frames):
    (tmp_path / "empty.mp4").touch()
    (tmp_path / "text.mp4").write_text("this is no film\n" * 50)
    np.save(tmp_path / "float.npy", frames.astype(np.float32))
    np.save(tmp_path / "flat.npy", frames[..., 0])
    np.save(tmp_path / "none.npy", frames[:0])
    np.savez(tmp_path / "two.npz", a=frames, b=frames)
    np.save(tmp_path / "pickle.npy", np.array([{"a": 1}], dtype=object), allow_pickle=True)
    (tmp_path / "folder").mkdir()
    (tmp_path / "bad").mkdir()
    (tmp_path / "bad" / "0.png").write_bytes(b"\x89PNG\r\n\x1a\n broken")
    for name, told in {
        "absent.mp4": "no such file",
        "empty.mp4": "empty",
        "text.mp4": "not a readable video",
        "float.npy": "float32",
        "flat.npy": "shape",
        "none.npy": "no frame",
        "two.npz": "expected one array",
        "pickle.npy": "pickle",
        "folder": "no png or jpg",
        "bad": "0.png",
    }.items():
        with pytest.raises(InputError, match=told) as caught:
            read_video(tmp_path / name)
        assert name in str(caught.value)
        assert "\n" not in str(caught.value)


def test_frames_of_different_sizes_are_refused(tmp_path, frames):
    Image.fromarray(frames[0]).save(tmp_path / "0.png")
    Image.fromarray(frames[1, :50]).save(tmp_path / "1.png")
    with pytest.raises(InputError, match=r"1\.png: size 130 x 50"):
        read_video(tmp_path)


KINDS = ("a.mp4", "a.npy", "a.npz", "a.h5", "folder")


@pytest.fixture
def stored(tmp_path, frames):
    """The same video in every kind of storage."""
    write_video(tmp_path / "a.mp4", frames, 17)
    np.save(tmp_path / "a.npy", frames)
    np.savez_compressed(tmp_path / "a.npz", frames)
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file.create_dataset("frames", data=frames, chunks=(7, H, 10, 3), compression="gzip")
    (tmp_path / "folder").mkdir()
    for k, image in enumerate(frames):
        Image.fromarray(image).save(tmp_path / "folder" / f"{k}.png")
    return tmp_path


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize(
    ("limit", "value", "told"),
    [("MAX_BYTES", 3 * H * W * 3, "shorter clips"), ("MAX_FRAMES", 3, "more than 3 frames"), ("MAX_PIXELS", 99, "")],
)
def test_videos_with_more_bytes_frames_or_pixels_than_allowed_are_refused(
    stored, monkeypatch, kind, limit, value, told
):
    monkeypatch.setattr(module, limit, value)
    with pytest.raises(InputError, match=rf"^{kind}\b.*{told}"):
        read_video(stored / kind)


@pytest.mark.parametrize("kind", KINDS)
def test_frames_beyond_the_memory_limit_are_kept_in_a_file_with_equal_selections(stored, monkeypatch, kind):
    few = np.asarray(read_video(stored / kind).frames)
    monkeypatch.setattr(module, "MEMORY_BYTES", 3 * few[0].nbytes)
    many = read_video(stored / kind).frames
    base = many
    while isinstance(base, np.ndarray):
        base = base.base
    assert isinstance(base, mmap.mmap)
    assert (many.shape, len(many)) == (few.shape, T)
    for index in (3, slice(2, 9, 3), np.array([5, 0, 5]), (slice(None), slice(9, 50), slice(None, None, -1))):
        np.testing.assert_array_equal(np.asarray(many[index]), few[index])
    cropped = many[4:, 10:60, ::-1][::2, :, 5:70]
    assert cropped.shape == few[4:, 10:60, ::-1][::2, :, 5:70].shape
    np.testing.assert_array_equal(np.asarray(cropped), few[4:, 10:60, ::-1][::2, :, 5:70])
    changed = map_frames(many, lambda k, image: image + k)
    np.testing.assert_array_equal(np.asarray(changed), few + np.arange(T, dtype=np.uint8)[:, None, None, None])


def test_a_full_disk_of_temporary_files_is_an_error_of_the_video(stored, monkeypatch):
    monkeypatch.setattr(module, "MEMORY_BYTES", 1)
    with Path("/dev/full").open("wb", buffering=0) as full:
        monkeypatch.setattr(module.tempfile, "TemporaryFile", lambda **_: full)
        with pytest.raises(InputError, match=r"a\.mp4: no temporary space for its frames \(No space left on device\)"):
            read_video(stored / "a.mp4")


@pytest.mark.parametrize(("shape", "told"), [((1, 96, 96, 3), "at least 2"), ((8, 8, 8, 3), "at least 64 px")])
def test_too_few_frames_or_too_small_frames_are_unmeasurable(shape, told):
    video = Video(frames=np.zeros(shape, dtype=np.uint8), fps=17.0, stamps_s=None)
    with pytest.raises(UnmeasurableError, match=told):
        video.require_measurable()


def test_sixteen_bit_grey_images_are_scaled_to_8_bit(tmp_path):
    ramp = np.linspace(0, 65535, 96 * 96).reshape(96, 96).astype(np.uint16)
    Image.fromarray(ramp).save(tmp_path / "0.png")
    image = read_image(tmp_path / "0.png")
    np.testing.assert_array_equal(image, np.repeat((ramp >> 8)[..., None], 3, axis=-1))


def test_channel_first_arrays_are_refused_with_the_transpose_to_use():
    with pytest.raises(InputError, match=r"looks channel-first: transpose\(0, 2, 3, 1\)"):
        Video(frames=np.zeros((2, 3, 64, 64), np.uint8), fps=None, stamps_s=None)
    with pytest.raises(InputError, match=r"\(T, H, W, 3\) in RGB$"):
        Video(frames=np.zeros((2, 64, 64, 4), np.uint8), fps=None, stamps_s=None)


def test_array_headers_that_exceed_the_file_or_the_size_limit_are_refused(tmp_path):
    np.save(tmp_path / "a.npy", np.zeros((2, 64, 64, 3), np.uint8))
    whole = (tmp_path / "a.npy").read_bytes()
    (tmp_path / "a.npy").write_bytes(whole[:1000])
    with pytest.raises(InputError, match=r"an array of shape \(2, 64, 64, 3\), 24576 bytes, the file holds 1000"):
        read_video(tmp_path / "a.npy")
    np.savez_compressed(tmp_path / "big.npz", q=np.zeros(2**18))
    message = "unpacks to 2 MiB; the limit is 1 MiB"
    with pytest.raises(InputError, match=message), open_npz(tmp_path / "big.npz", 2**20) as archive:
        archive["q"]


def test_messages_about_a_damaged_header_hold_no_memory_address(tmp_path):
    np.save(tmp_path / "a.npy", np.zeros((2, 64, 64, 3), np.uint8))
    whole = (tmp_path / "a.npy").read_bytes()
    (tmp_path / "a.npy").write_bytes(whole.replace(b"'|u1'", b"f('')"))
    with pytest.raises(InputError, match="malformed") as caught:
        read_video(tmp_path / "a.npy")
    assert " at 0x" not in str(caught.value)
