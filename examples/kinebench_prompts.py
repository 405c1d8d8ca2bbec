"""Write the prompts of a clone of KineBench as a file for `--prompts`; its Python files are parsed, never run.

python kinebench_prompts.py KineBench > prompts.json
"""

import ast
import json
import sys
from pathlib import Path

from kinebench_drake.suites.families.registry import TASKS


def constants(file):
    """Return the constants that a Python file assigns by name."""
    values = {}
    for statement in ast.parse(file.read_text()).body:
        targets = statement.targets if isinstance(statement, ast.Assign) else [getattr(statement, "target", None)]
        if isinstance(targets[0], ast.Name):
            try:
                values[targets[0].id] = ast.literal_eval(statement.value)
            except (TypeError, ValueError):
                continue
    return values


folder = Path(sys.argv[1]) / "kinebench"
texts = constants(folder / "tasks.py") | constants(folder / "eval" / "evaluator.py")
own = {task: text for task, text in texts["TASK_PROMPTS"].items() if task in TASKS}
lock = texts["VISUAL_LOCK_PREFIX"].strip()
prompts = {task: f"{lock} {text}".strip() for task, text in {"*": "{prompt}", **own}.items()}
print(json.dumps({**prompts, "negative_prompt": texts["NEGATIVE_PROMPT"]}, indent=1))
