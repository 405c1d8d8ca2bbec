"""The shipped weights of the perception network."""

from pathlib import Path

from kinebench_drake.errors import SetupError
from kinebench_drake.models.perception.network import GripperNetwork

WEIGHTS = Path(__file__).with_name("gripper.safetensors")
"""Weights shipped with the package, in half precision."""


def load_network(path: Path = WEIGHTS) -> GripperNetwork:
    """The network with the weights of a safetensors file, in single precision, ready to infer.

    Raises:
        SetupError: the file is missing or holds other weights.
    """
    from safetensors import SafetensorError
    from safetensors.torch import load_file

    if not path.is_file():
        raise SetupError(f"{path.name}: no such weights; train them with `kinebench-drake perception train`")
    network = GripperNetwork()
    try:
        state = load_file(path)
        network.load_state_dict({k: v.float() if v.dtype.is_floating_point else v for k, v in state.items()})
    except (SafetensorError, RuntimeError) as error:
        first = str(error).splitlines()[0]
        raise SetupError(f"{path.name}: not weights of this network ({first}); train or fetch them again") from None
    return network.eval()
