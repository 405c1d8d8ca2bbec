"""The Franka Panda: URDF, CAD meshes and frame constants."""
