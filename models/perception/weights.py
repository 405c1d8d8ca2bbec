"""Loading of the shipped weights of the perception network."""

from copy import deepcopy
from itertools import pairwise
from pathlib import Path

from torch import nn
from torch.nn.utils import fuse_conv_bn_eval

from kinebench_drake.errors import SetupError
from kinebench_drake.models.perception.network import GripperNetwork

WEIGHTS = Path(__file__).with_name("gripper.safetensors")
"""Shipped weights, in half precision."""
_FIX = "reinstall kinebench-drake, which contains them, or train new ones with `kinebench-drake perception train`"


def load_network(path: Path = WEIGHTS) -> GripperNetwork:
    """Load the network with the weights of a safetensors file, in single precision and evaluation mode.

    Raises:
        SetupError: the file is missing or contains weights of another network.
    """
    from safetensors import SafetensorError
    from safetensors.torch import load_file

    if not path.is_file():
        raise SetupError(f"{path.name}: no such weights; {_FIX}")
    network = GripperNetwork()
    try:
        state = load_file(path)
        network.load_state_dict({k: v.float() if v.dtype.is_floating_point else v for k, v in state.items()})
    except (SafetensorError, RuntimeError) as error:
        first = str(error).splitlines()[0]
        raise SetupError(f"{path.name}: not weights of this network ({first}); {_FIX}") from None
    return network.eval()


def fold_batch_normalisation(network: GripperNetwork) -> GripperNetwork:
    """Return a copy for inference with each batch normalisation folded into the convolution before it."""
    network = deepcopy(network).eval()
    for module in list(network.modules()):
        for (before, convolution), (after, normalisation) in pairwise(list(module.named_children())):
            if isinstance(convolution, nn.Conv2d) and isinstance(normalisation, nn.BatchNorm2d):
                setattr(module, before, fuse_conv_bn_eval(convolution, normalisation))
                setattr(module, after, nn.Identity())
    return network
