"""Drake: plant, inverse kinematics, manipulability, limits."""
