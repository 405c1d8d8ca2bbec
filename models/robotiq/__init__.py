"""The Robotiq 2F-85: CAD meshes."""
