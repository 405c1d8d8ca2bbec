"""ManiSkill trajectories: TASK.h5 with a group per demonstration, TASK.json with their description.

The layout is that of mani_skill's `RecordEpisode` with `obs_mode="none"`: actions, env_states, terminated, truncated,
success.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from kinebench_drake.io.atomic import atomic_path
from kinebench_drake.io.jsonl import write_json
from kinebench_drake.io.npz import write_arrays
from kinebench_drake.suites.clock import CONTROL_PERIOD_S
from kinebench_drake.suites.families.registry import TASKS
from kinebench_drake.suites.formats.demo import CLIP_STEPS, PARTS, Content, Demo, Record, RenderOptions
from kinebench_drake.suites.simulator import Simulator

CONTROL_MODE = "pd_joint_pos"
_STATES = "env_states"


class ManiSkill:
    """Format of ManiSkill trajectories."""

    content = Content.STATES

    def part_files(self, folder: Path, record: Record) -> list[Path]:
        """Return the file of the demonstration's arrays."""
        return [_part(folder, record.id)]

    def write_part(self, folder: Path, demo: Demo) -> None:
        """Write the arrays of a demonstration, named as in its group."""
        controls, episode = demo.rollout.controls, demo.rollout.episode
        success = np.array(demo.successes, dtype=bool)
        truncated = np.zeros(len(controls), dtype=bool)
        truncated[-1] = len(controls) == CLIP_STEPS * TASKS[episode.task].card.clips
        arrays = {
            "actions": np.stack([Simulator.action(row[:7], row[7]) for row in controls]),
            "terminated": success,
            "truncated": truncated,
            "success": success,
        }
        for kind, objects in demo.states[0].items():
            for name in objects:
                arrays[f"{_STATES}/{kind}/{name}"] = np.stack([state[kind][name] for state in demo.states])
        write_arrays(_part(folder, demo.id), arrays)

    def finish(
        self, folder: Path, records: Sequence[Record], options: RenderOptions, about: dict[str, Any]
    ) -> list[Path]:
        """Join the parts into one file per task."""
        files = []
        for task in dict.fromkeys(record.task for record in records):
            own = [record for record in records if record.task == task]
            files.append(folder / f"{task}.h5")
            lengths = []
            with atomic_path(files[-1]) as path, h5py.File(path, "w", libver="earliest") as file:
                for k, record in enumerate(own):
                    with np.load(_part(folder, record.id)) as arrays:
                        lengths.append(len(arrays["actions"]))
                        for name in arrays.files:
                            file.create_dataset(f"traj_{k}/{name}", data=arrays[name])
            write_json(folder / f"{task}.json", _description(task, own, lengths, about))
        return files

    def index_files(self, folder: Path, tasks: Sequence[str]) -> list[Path]:
        """Return the descriptions of the tasks."""
        return [folder / f"{task}.json" for task in tasks]


def _part(folder: Path, id: str) -> Path:
    return folder / PARTS / f"{id}.npz"


def _description(task: str, records: Sequence[Record], lengths: Sequence[int], about: dict[str, Any]) -> dict[str, Any]:
    """Return the description of a file: arguments of the environment, seed and length of each trajectory."""
    from kinebench_drake.suites.scene.environment import environment_id

    return {
        "env_info": {
            "env_id": environment_id(task),
            "env_kwargs": {
                "obs_mode": "none",
                "reward_mode": "none",
                "control_mode": CONTROL_MODE,
                "robot_uids": "panda",
                "sim_backend": "physx_cpu",
                "pool": about["pool"],
                "variant": about["variant"],
            },
            "max_episode_steps": CLIP_STEPS * TASKS[task].card.clips,
            "control_freq": round(1.0 / CONTROL_PERIOD_S),
        },
        "episodes": [
            {
                "episode_id": k,
                "episode_seed": record.seed,
                "control_mode": CONTROL_MODE,
                "elapsed_steps": length,
                "reset_kwargs": {"seed": record.seed, "options": {}},
                "success": True,
                "id": record.id,
                "prompt": record.prompt,
            }
            for k, (record, length) in enumerate(zip(records, lengths, strict=True))
        ],
        "source_type": "motionplanning",
        "source_desc": "scripted expert, planned with Drake",
    }
