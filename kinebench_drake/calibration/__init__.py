"""Where the camera stands and what lens it has, from the robot that it sees."""
