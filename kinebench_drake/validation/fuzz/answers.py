"""What world models answer, as trees: a file a question, named after the part of the address that tells it."""

import base64

from kinebench_drake.validation.fuzz.films import coded, film, lines, pictures, text
from kinebench_drake.validation.fuzz.replies import reply
from kinebench_drake.validation.fuzz.tree import Tree

HOST = "http://127.0.0.1:0"
"""Address in answers, in place of the one that the server comes to have; of no other meaning."""
EPISODE, TASK = "StackCube-v1_s0003", "StackCube-v1"


def simple_trees() -> list[Tree]:
    """Answers with the video itself, or with where it is."""
    whole, video = film(".gif"), reply(film(".gif"), "image/gif")
    coded_video = {"video_base64": base64.b64encode(whole).decode()}
    return [
        {"root.http": reply(text(coded_video))},
        {"root.http": reply(text({"video_url": f"{HOST}/clip"})), "clip.http": video},
        {"root.http": reply(text({"video_path": "clip.gif"})), "clip.gif": whole},
    ]


def predict_trees() -> list[Tree]:
    """Answers of the stateless contract."""
    frames = [base64.b64encode(coded(frame)).decode() for frame in pictures()]
    return [
        {
            "health.http": reply(text({"status": "ok"})),
            "capabilities.http": reply(text({"max_num_frames": 4, "size": [96, 96]})),
            "predict.http": reply(text({"frames": frames})),
        }
    ]


def dashscope_trees() -> list[Tree]:
    """Answers of DashScope."""
    done = {"task_id": "t1", "task_status": "SUCCEEDED", "video_url": f"{HOST}/clip"}
    return [
        {
            "video-synthesis.http": reply(text({"output": {"task_id": "t1", "task_status": "PENDING"}})),
            "t1.http": reply(text({"output": done})),
            "clip.http": reply(film(".gif"), "image/gif"),
        }
    ]


def minimax_trees() -> list[Tree]:
    """Answers of MiniMax."""
    well = {"base_resp": {"status_code": 0, "status_msg": "success"}}
    return [
        {
            "video_generation.http": reply(text({"task_id": "t1", "status": "Success", "file_id": "f1", **well})),
            "retrieve.http": reply(text({"file": {"download_url": f"{HOST}/clip"}, **well})),
            "clip.http": reply(film(".gif"), "image/gif"),
        }
    ]


def folder_trees() -> list[Tree]:
    """Folders of finished videos."""
    row = {"id": EPISODE, "task": TASK, "seed": 3, "video": "clip.gif"}
    frames = {f"{EPISODE}/{k}.png": coded(frame) for k, frame in enumerate(pictures())}
    return [
        {"manifest.jsonl": lines([row]), "clip.gif": film(".gif")},
        {f"{EPISODE}.mp4": film()},
        frames,
    ]
