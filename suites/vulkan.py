"""Check of the Vulkan device that renders scenes."""

from kinebench_drake.environment.doctor import FIX, Check, check, probe


def check_vulkan() -> Check:
    """Check whether SAPIEN can render on this machine."""
    return check("Vulkan device", _render, f"{FIX}; beside a broken NVIDIA driver with KINEBENCH_DRAKE_RENDER=cpu set")


def _render() -> str:
    """Render one image: a device may be listed and yet fail when it is used."""
    return probe(
        "from kinebench_drake.environment import native\n"
        "backend = native.prepare_vulkan()\n"
        "import sapien\n"
        "device = sapien.Device('cuda' if backend == 'gpu' else 'cpu')\n"
        "scene = sapien.Scene([sapien.physx.PhysxCpuSystem(), sapien.render.RenderSystem(device)])\n"
        "camera = scene.add_camera('camera', 16, 16, 1.0, 0.1, 10.0)\n"
        "scene.update_render()\n"
        "camera.take_picture()\n"
        "assert camera.get_picture('Color').shape == (16, 16, 4)\n"
        "name = next(x for x in sapien.render.get_device_summary().splitlines() if x.startswith('GPU:'))\n"
        "print(f'{name[4:].strip()} (render backend {backend})')"
    )
