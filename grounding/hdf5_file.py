"""Videos in HDF5 files: data sets of frames (T, H, W, 3) uint8 RGB, or of one coded picture (jpg, png) a frame.

Pictures as arrays are what robomimic (`data/demo_K/obs/NAME_image`), ManiSkill (`traj_K/obs/sensor_data/NAME/rgb`) and
ALOHA's recordings (`observations/images/NAME`) hold; coded ones, padded with zeros to one length or not, are what
ALOHA's compressed recordings and RoboTwin (`observation/NAME/rgb`) hold.
"""

import io
from pathlib import Path

import h5py
import numpy as np
from numpy.typing import NDArray

from kinebench_drake.errors import InputError, cause
from kinebench_drake.grounding.decoded import Video, VideoPart, check_size
from kinebench_drake.grounding.frame_folder import decode_picture, natural
from kinebench_drake.hdf5 import DAMAGED, is_own, open_hdf5

HDF5_SUFFIXES = frozenset({".h5", ".hdf5"})

_CODED = (b"\xff\xd8\xff", b"\x89PNG")


def list_films(path: Path) -> list[str]:
    """Names of the data sets that hold a video, in natural order; links to other places are not followed.

    Raises:
        InputError: the file is damaged.
    """
    names: list[str] = []

    def visit(name: str, item: object) -> None:
        readable = isinstance(name, str)  # names in no encoding come as bytes
        if readable and isinstance(item, h5py.Dataset) and is_own(item) and (_is_frames(item) or _is_coded(item)):
            names.append(name)

    try:
        with open_hdf5(path) as file:
            file.visititems(visit)
    except DAMAGED as error:
        raise InputError(f"{path.name}: {cause(error)}") from None
    return sorted(names, key=natural)


def read_hdf5(path: Path, part: VideoPart) -> Video:
    """Read the data set that `part` names, else the only one.

    Raises:
        InputError: the file is damaged, holds no such data set, or several and none is named.
    """
    key = part.key
    if key is None:
        names = list_films(path)
        if len(names) != 1:
            told = ", ".join(names[:8]) or "none"
            raise InputError(f"{path.name}: holds {len(names)} videos ({told}), expected one where none is named")
        (key,) = names
    try:
        with open_hdf5(path) as file:
            data = file.get(key)
            if not isinstance(data, h5py.Dataset) or not is_own(data):
                raise InputError(f"{path.name}: holds no data set {key!r} of its own")
            frames = _decoded(path, data) if _is_coded(data) else _plain(path, data)
    except DAMAGED as error:
        raise InputError(f"{path.name}: {key} cannot be read ({cause(error)})") from None
    try:
        return Video(frames=frames, fps=None, stamps_s=None)
    except InputError as error:
        raise InputError(f"{path.name}: {key} {error}") from None


def _is_frames(data: h5py.Dataset) -> bool:
    return bool(data.dtype == np.uint8 and data.ndim == 4 and data.shape[3] == 3 and data.shape[0])


def _is_coded(data: h5py.Dataset) -> bool:
    """Whether each row begins like a coded picture."""
    rows = data.ndim == 2 and data.dtype == np.uint8
    texts = data.ndim == 1 and (data.dtype.kind == "S" or h5py.check_vlen_dtype(data.dtype) == np.uint8)
    return bool((rows or texts) and data.shape[0]) and _bytes(data[0]).startswith(_CODED)


def _bytes(row: object) -> bytes:
    return row if isinstance(row, bytes) else np.asarray(row).tobytes()


def _plain(path: Path, data: h5py.Dataset) -> NDArray[np.uint8]:
    check_size(path.name, data.size * data.dtype.itemsize)
    return np.ascontiguousarray(data[()])


def _decoded(path: Path, data: h5py.Dataset) -> NDArray[np.uint8]:
    images: list[NDArray[np.uint8]] = []
    for k in range(data.shape[0]):
        image = decode_picture(io.BytesIO(_bytes(data[k])))
        if images and image.shape != images[0].shape:
            raise InputError(f"{path.name}: frame {k} of {data.name} has shape {image.shape}, not {images[0].shape}")
        check_size(path.name, image.nbytes * (k + 1))
        images.append(image)
    return np.stack(images)
