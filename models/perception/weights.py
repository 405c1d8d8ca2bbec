"""The shipped weights of the perception network."""

from copy import deepcopy
from itertools import pairwise
from pathlib import Path

from torch import nn
from torch.nn.utils import fuse_conv_bn_eval

from kinebench_drake.errors import SetupError
from kinebench_drake.models.perception.network import GripperNetwork

WEIGHTS = Path(__file__).with_name("gripper.safetensors")
"""Weights shipped with the package, in half precision."""
_HOW = "install kinebench-drake again, which brings its own, or train others with `kinebench-drake perception train`"


def load_network(path: Path = WEIGHTS) -> GripperNetwork:
    """The network with the weights of a safetensors file, in single precision, ready to infer.

    Raises:
        SetupError: the file is missing or holds other weights.
    """
    from safetensors import SafetensorError
    from safetensors.torch import load_file

    if not path.is_file():
        raise SetupError(f"{path.name}: no such weights; {_HOW}")
    network = GripperNetwork()
    try:
        state = load_file(path)
        network.load_state_dict({k: v.float() if v.dtype.is_floating_point else v for k, v in state.items()})
    except (SafetensorError, RuntimeError) as error:
        first = str(error).splitlines()[0]
        raise SetupError(f"{path.name}: not weights of this network ({first}); {_HOW}") from None
    return network.eval()


def folded(network: GripperNetwork) -> GripperNetwork:
    """A copy for inference alone: each batch normalisation is part of the convolution that its module has before it."""
    network = deepcopy(network).eval()
    for module in list(network.modules()):
        for (before, convolution), (after, normalisation) in pairwise(list(module.named_children())):
            if isinstance(convolution, nn.Conv2d) and isinstance(normalisation, nn.BatchNorm2d):
                setattr(module, before, fuse_conv_bn_eval(convolution, normalisation))
                setattr(module, after, nn.Identity())
    return network
