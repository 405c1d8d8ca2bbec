"""Videos in parquet files: a coded picture (png, jpg) a row, as LeRobot keeps features of dtype image."""

import io
from pathlib import Path

import numpy as np
import pyarrow
import pyarrow.parquet as parquet
from numpy.typing import NDArray

from kinebench_drake.errors import InputError, cause
from kinebench_drake.grounding.decoded import Video, VideoPart, check_size
from kinebench_drake.grounding.frame_folder import decode_picture

PARQUET_SUFFIXES = frozenset({".parquet"})


def read_parquet(path: Path, part: VideoPart) -> Video:
    """Read the pictures of a column, of one episode: structs with a field bytes.

    Raises:
        InputError: the file is damaged, or holds no such pictures.
    """
    if part.key is None or part.episode is None:
        raise InputError(f"{path.name}: a parquet file is a video only as part of a LeRobot dataset; name its folder")
    images: list[NDArray[np.uint8]] = []
    try:
        only = [("episode_index", "==", part.episode)]
        for row in parquet.read_table(path, columns=[part.key], filters=only).column(part.key).to_pylist():
            data = row.get("bytes") if isinstance(row, dict) else None
            if not isinstance(data, bytes):
                raise InputError(f"{path.name}: {part.key} holds no picture in frame {len(images)}")
            image = decode_picture(io.BytesIO(data))
            if images and image.shape != images[0].shape:
                raise InputError(f"{path.name}: frame {len(images)} has shape {image.shape}, not {images[0].shape}")
            check_size(path.name, image.nbytes * (len(images) + 1))
            images.append(image)
    except (OSError, ValueError, TypeError, MemoryError, pyarrow.ArrowException) as error:
        told = cause(error).replace(str(path), path.name)
        raise InputError(f"{path.name}: the pictures of {part.key} cannot be read ({told})") from None
    if not images or (part.frames is not None and len(images) != part.frames):
        told = "" if part.frames is None else f", its description tells {part.frames}"
        raise InputError(f"{path.name}: has {len(images)} frames of episode {part.episode}{told}")
    return Video(frames=np.stack(images), fps=None, stamps_s=None)
